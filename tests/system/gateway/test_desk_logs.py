"""The desk's page of logs in a real browser, alone and beside a driven robot."""

from __future__ import annotations

import http.client
import re
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Final, Literal
from urllib.parse import parse_qs, quote, urlparse, urlsplit

import msgspec
import pytest
from playwright.sync_api import Browser, Page

from gateway.cli.desk_logs import QUESTIONS_AT_ONCE
from tests.support.axe import assert_fits_a_small_phone, assert_for_everybody
from tests.support.drives import HOSTILE, drive_messages, write_messages
from tests.support.messages import event
from tests.support.nights import every_value
from tests.support.processes.desk import desk_scene, drive, is_driven, open_robot, profile
from tests.support.processes.gateway import Running, children
from tests.support.rigs.scenarios import front_bumper, recorded
from tests.support.waiting import wait_until
from tests.system.recorder.cli.review.test_memory import bomb, tiny, zeros

LOG: Final = "cruiser-1-20231114T221320Z.mcap"
STRANGE: Final = 'a b#%3C"&<img src=x>\u202epacm.mcap'  # a made-up name that reads from right to left

STOP: Final = "2023-11-14T22:13:22.040Z"

AGES: Final = 50  # looks at the age of the commands, before the questions
ANSWER_MS: Final = 100_000  # an answer is looked for when it is asked for; a busy machine takes its time


QUESTIONS_S: Final = 500.0  # hostile and large logs take their time, beside everything else, which comes first


@contextmanager
def opened(browser: Browser, **options: object) -> Iterator[Page]:
    # Chromium itself logs a response with an error.
    with profile(browser, "status of 400", **options) as context:
        context.set_default_timeout(ANSWER_MS)
        yield context.new_page()


@contextmanager
def served(directory: Path, *words: str) -> Iterator[str]:
    """Serve a desk of these logs alone. Yields its address."""
    words = ("--logs", str(directory), "--logs-only", "--listen", "127.0.0.1:0", *words)
    with Running("desk", *words) as running:
        yield running.wait_says(r"desk: (http://127\.0\.0\.1:\d+/)")[1]
        assert running.stop() == 0
        assert len(running.said) == 1, running.said


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of a drive that a bumper ended, and a hostile one."""
    directory = tmp_path_factory.mktemp("logs")
    (directory / LOG).write_bytes(recorded(front_bumper))
    harmful = msgspec.structs.replace(event(50), text=HOSTILE)
    write_messages(directory / STRANGE, [*drive_messages(), harmful], robots=["cruiser-9"])
    return directory


@pytest.fixture(scope="module")
def address(directory: Path) -> Iterator[str]:
    with served(directory) as address:
        yield address


def ask(address: str, path: str, **headers: str) -> int:
    with closing(http.client.HTTPConnection(urlparse(address).netloc, timeout=QUESTIONS_S)) as connection:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        answer.read()
        return answer.status


def test_a_stop_is_found_explained_and_reported(address: str, running_browser: Browser) -> None:
    with opened(running_browser) as page:
        page.goto(address)
        page.get_by_role("heading", name="Incidents").wait_for()
        page.locator("section[aria-label=Logs] tbody tr", has_text=LOG).wait_for()
        page.get_by_label("Search for").select_option("stops")
        page.get_by_label("Robot").fill("cruiser-1")
        page.get_by_role("button", name="Find").click()
        found = page.locator("section[aria-label=Stops] tbody tr", has_text="the front bumper was hit")
        found.wait_for()
        assert page.url.endswith("#/logs?search=stops&robot=cruiser-1")
        found.get_by_role("button", name="Why").click()
        page.locator(".reason", has_text="the front bumper was hit").locator("dt", has_text="cure").wait_for()
        with page.context.expect_page() as opening:
            found.get_by_role("link", name="Report").click()
        report = opening.value
        report.locator("html[data-drawn]").wait_for(state="attached")
        # It shows that very moment, and reaches neither the desk nor a key of the browser's.
        assert f"#t={STOP}" in report.url
        assert report.evaluate("window.origin") == "null"
        page.goto(f"{address}logs.html#/logs?search=stops&reason=bumper")
        page.get_by_role("alert").filter(has_text="there is no reason 'bumper'").wait_for()


def test_nothing_in_a_log_or_its_name_becomes_html(address: str, running_browser: Browser) -> None:
    with opened(running_browser) as page:
        page.goto(f"{address}logs.html#/logs?search=events&robot=cruiser-9")
        row = page.locator("tbody tr", has_text="</script><script>")
        row.get_by_text(STRANGE.replace("\u202e", "\ufffd")).wait_for()
        assert page.locator("main img").count() == 0
        assert page.evaluate("document.body.dataset.owned") is None
        with page.expect_download() as loading:
            row.get_by_role("link", name="Download").click()
        assert loading.value.path().stat().st_size > 0


class _Elsewhere(BaseHTTPRequestHandler):
    """Another site, with an empty page."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def elsewhere() -> Iterator[str]:
    server = HTTPServer(("127.0.0.1", 0), _Elsewhere)
    serving = threading.Thread(target=server.serve_forever)
    serving.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        serving.join()
        server.server_close()


READ_A_RANGE: Final = """(url) => fetch(url, { headers: { range: "bytes=1-4" } }).then(
    async (answer) => {
        const seen = (name) => answer.headers.get(name);
        return [answer.status, seen("content-range"), seen("etag") !== null, await answer.text()];
    },
    (error) => error.name)"""


def test_a_viewer_opens_a_log_by_its_address_and_no_other_site_does(
    tmp_path: Path, running_browser: Browser
) -> None:
    (tmp_path / LOG).write_bytes(recorded(front_bumper))
    viewing = (elsewhere(), elsewhere())
    with viewing[0] as viewer, viewing[1] as other, served(tmp_path, "--viewer", f"{viewer}/view") as address:
        with opened(running_browser) as page:
            page.goto(f"{address}logs.html#/logs?search=stops")
            link = page.get_by_role("link", name="Open in 127.0.0.1").first
            asked = {
                name: one[0] for name, one in parse_qs(urlsplit(link.get_attribute("href") or "").query).items()
            }
            assert asked == {"ds": "remote-file", "ds.url": f"{address}logs/{LOG}", "time": STOP}
        with opened(running_browser) as page:
            page.goto(f"{viewer}/view")
            size = (tmp_path / LOG).stat().st_size
            assert page.evaluate(READ_A_RANGE, asked["ds.url"]) == [206, f"bytes 1-4/{size}", True, "MCAP"]
        # Of what it is refused the browser complains in the console.
        with running_browser.new_context() as context:
            strange = context.new_page()
            strange.goto(other)
            assert strange.evaluate(READ_A_RANGE, asked["ds.url"]) == "TypeError"


def home(page: Page, address: str) -> None:
    page.goto(address)
    page.locator("section[aria-label] tbody tr").first.wait_for()


def stops(page: Page, address: str) -> None:
    page.goto(f"{address}logs.html#/logs?search=stops")
    page.locator(".links button").first.click()
    page.locator(".reason dl").first.wait_for()


@pytest.mark.night
@pytest.mark.parametrize(
    ("look", "theme", "language"),
    every_value((home, stops), ("light", "dark"), ("en-GB", "zh-CN")),
    ids=lambda value: getattr(value, "__name__", value),
)
def test_every_page_is_for_everybody(
    look: object, theme: Literal["light", "dark"], language: str, address: str, running_browser: Browser
) -> None:
    with opened(running_browser, locale=language, color_scheme=theme) as page:
        look(page, address)  # type: ignore[operator]
        assert_for_everybody(page)
        assert_fits_a_small_phone(page)


def test_a_robot_leads_to_its_logs_also_to_the_one_that_is_being_written(
    tmp_path: Path, running_browser: Browser
) -> None:
    log, growing = recorded(front_bumper), "cruiser-1-20260102T040506Z.mcap.part"
    (tmp_path / LOG).write_bytes(log)
    (tmp_path / growing).write_bytes(log)
    with desk_scene(desk_words=("--logs", str(tmp_path))) as scene, opened(running_browser) as page:
        page.goto(f"{scene.address}#/robot/cruiser-1")
        page.get_by_role("link", name="Logs of cruiser-1").click()
        with page.expect_download() as download:
            page.locator(f"tr:has-text('{LOG}')").get_by_role("link", name="Download").click()
        assert Path(download.value.path()).read_bytes() == log
        page.get_by_label("Not in the catalog").get_by_text(growing).wait_for()
        assert page.get_by_role("button", name="STOP ALL").is_visible()
        assert [ask(scene.address, f"/{kind}/{growing}") for kind in ("logs", "reports")] == [404, 200]
        (tmp_path / growing).rename(tmp_path / growing.removesuffix(".part"))
        assert ask(scene.address, f"/reports/{growing}") == 200
        # No page of another site has a report made behind somebody's back. A link that is followed is none.
        for kind, status in (("image", 404), ("iframe", 404), ("document", 200)):
            fetch = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": kind}
            assert ask(scene.address, f"/reports/{LOG}", **fetch) == status


def age_ms(page: Page) -> list[int]:
    """Return the age of the commands as the page shows it; nothing without commands."""
    return [int(age) for age in re.findall(r"(\d+) ms", page.locator(".link").inner_text())[:1]]


@pytest.mark.night
@pytest.mark.timeout(600)
def test_a_driven_robot_notices_no_question_about_logs(tmp_path: Path, running_browser: Browser) -> None:
    """It drives on, and at most two processes read logs."""
    write_messages(tmp_path / "large.mcap", drive_messages(20_000))
    (tmp_path / "tiny.mcap").write_bytes(bomb(tiny, 3))
    (tmp_path / "zeros.mcap").write_bytes(bomb(zeros, 16))
    (tmp_path / LOG).write_bytes(recorded(front_bumper))
    paths = ["/find?search=logs", *(f"/reports/{name}" for name in ("large.mcap", "tiny.mcap", "zeros.mcap"))]
    paths += [f"/whys/{name}?at={quote(STOP)}" for name in ("large.mcap", "zeros.mcap")]
    with desk_scene(desk_words=("--logs", str(tmp_path))) as scene, opened(running_browser) as first:
        page = open_robot(first.context, scene)
        drive(scene, page)
        before = [age for _ in range(AGES) for age in age_ms(page)]
        told, most = len(scene.told_mps()), 0
        during: list[int] = []
        with ThreadPoolExecutor(len(paths)) as pool:
            asking = [pool.submit(ask, scene.address, path) for path in paths]

            def is_answered() -> bool:
                nonlocal most
                most = max(most, len(children(scene.desk.process.pid)))
                during.extend(age_ms(page))
                return all(one.done() for one in asking)

            wait_until(is_answered, deadline_s=QUESTIONS_S)
        print(f"age of commands, ms: {_figures(before)}; with {len(paths)} questions: {_figures(during)}")  # noqa: T201 - whoever reads the figures wants it
        assert is_driven(page), page.locator(".band").inner_text()
        assert min(map(abs, scene.told_mps()[told:])) > 0
        assert 1 <= most <= QUESTIONS_AT_ONCE
        assert {one.result() for one in asking} <= {200, 500, 503}


def _figures(ages: list[int]) -> str:
    return f"p50 {sorted(ages)[len(ages) // 2]}, worst {max(ages)}, of {len(ages)}"
