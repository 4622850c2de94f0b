"""The logs of a fleet in a real browser, served by a real process."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Literal
from urllib.parse import parse_qs, urlsplit

import msgspec
import pytest
from playwright.sync_api import Browser, BrowserContext, Page

from recorder.reading.read_log import read_log
from schemas.exit_codes import ExitCode
from tests.support.axe import assert_fits_a_small_phone, assert_for_everybody
from tests.support.drives import HOSTILE, drive_messages, write_messages
from tests.support.messages import event
from tests.support.nights import every_value
from tests.support.processes.desk import chromium
from tests.support.processes.gateway import Running, run
from tests.support.rigs.scenarios import deadman, front_bumper, recorded
from tests.support.waiting import wait_until

LOG = "cruiser-1-20231114T221320Z.mcap"
STRANGE = 'a b#%3C"&<img src=x>\u202epacm.mcap'
"""A name that somebody has made up, which would be read from its other end."""

ANSWER_MS = 60_000
"""A report or a reason is looked for when it is asked for; a busy machine takes its time."""


@pytest.fixture(scope="module")
def running_browser() -> Iterator[Browser]:
    """One Chromium for all tests; each has a context of its own."""
    with chromium() as running:
        yield running


@contextmanager
def opened(browser: Browser, language: str = "en-GB", **options: object) -> Iterator[BrowserContext]:
    """A profile of its own. A page that complains in the console fails the test."""
    complaints: list[str] = []
    context = browser.new_context(locale=language, **options)  # type: ignore[arg-type]
    context.set_default_timeout(ANSWER_MS)
    context.on("weberror", lambda error: complaints.append(str(error.error)))
    context.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
    yield context
    context.close()
    # Of an answer that says what is wrong the browser has a line of its own.
    assert [one for one in complaints if "status of 400" not in one] == []


@pytest.fixture
def context(running_browser: Browser) -> Iterator[BrowserContext]:
    """A profile in English."""
    with opened(running_browser) as context:
        yield context


@contextmanager
def served(directory: Path, *words: str) -> Iterator[str]:
    """The address of a server of these logs, once it has catalogued them. It ends as it should."""
    with Running("serve", str(directory), "--listen", "127.0.0.1:0", *words) as running:
        yield running.wait_says(r"serve: (http://127\.0\.0\.1:\d+/)")[1]
        assert running.stop() == 0
        assert len(running.said) == 1, running.said


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of a drive that a bumper ended, and one of somebody who means harm."""
    directory = tmp_path_factory.mktemp("logs")
    (directory / LOG).write_bytes(recorded(front_bumper))
    harmful = msgspec.structs.replace(event(50), text=HOSTILE)
    write_messages(directory / STRANGE, [*drive_messages(), harmful], robots=["cruiser-9"])
    return directory


@pytest.fixture(scope="module")
def address(directory: Path) -> Iterator[str]:
    """A server where people may write."""
    with served(directory, "--write") as address:
        yield address


def test_a_stop_is_found_explained_and_reported(address: str, context: BrowserContext) -> None:
    """From the calendar to the drive, its stop, the reason, the report at that moment, and a part of the log."""
    page = context.new_page()
    page.goto(address)
    page.locator(".month").get_by_role("link", name="2023-11-14").click()
    page.locator("h1", has_text="2023-11-14").wait_for()
    drive = page.locator("section[aria-label=Drives] tbody tr", has_text="cruiser-1")
    assert "operator-1" in drive.inner_text()
    drive.get_by_text("the front bumper was hit").wait_for()
    drive.locator(".marks a").click()
    page.locator("h1", has_text=LOG).wait_for()
    page.get_by_role("button", name="Why then?").click()
    page.locator(".chain", has_text="the front bumper was hit").locator("dt", has_text="cure").wait_for()
    with context.expect_page() as opening:
        page.get_by_role("link", name="Report").click()
    report = opening.value
    report.locator("html[data-drawn]").wait_for(state="attached")
    # It shows that very moment.
    assert "#t=2023-11-14T22:13:22.040Z" in report.url
    report.get_by_text("22:13:22.040").first.wait_for()
    report.close()
    with page.expect_download() as cutting:
        page.get_by_role("link", name="Cut it out").click()
    assert cutting.value.suggested_filename == "cruiser-1-20231114T221320Z-221317.mcap"
    times = [one.log_time_ns for one in read_log(str(cutting.value.path()))]
    assert len(times) > 100
    page.get_by_label("Format").select_option("csv")
    assert (page.get_by_role("link", name="Cut it out").get_attribute("href") or "").endswith("&as=csv")


def test_words_are_searched_for_and_mistakes_explained(address: str, context: BrowserContext) -> None:
    """The address of a search can be passed on; what cannot be understood is said in a line."""
    page = context.new_page()
    page.goto(address)
    box = page.get_by_role("searchbox")
    box.fill("stop robot=cruiser-1")
    box.press("Enter")
    # What was found before, of all robots, stands there until then.
    found = page.locator(".found tbody").filter(has_not_text="cruiser-9")
    found.locator("tr", has_text="the front bumper was hit").wait_for()
    other = context.new_page()
    other.goto(page.url)
    other.locator(".found tbody tr", has_text="the front bumper was hit").wait_for()
    assert other.get_by_role("searchbox").input_value() == "stop robot=cruiser-1"
    box = page.get_by_role("searchbox")
    box.fill("drive distance>3")
    box.press("Enter")
    page.get_by_role("alert").filter(has_text="is no field of drive").wait_for()


def test_two_people_write_and_read_what_the_other_wrote(
    address: str, directory: Path, running_browser: Browser
) -> None:
    """Comments are shown as they were written; a tag is a word to search for. Names are remembered."""
    with opened(running_browser) as first, opened(running_browser) as second:
        pages = []
        for context, who in ((first, "ann"), (second, "bob")):
            page = context.new_page()
            page.goto(f"{address}#/log/{LOG}?t=2023-11-14T22:13:22.040Z&robot=cruiser-1")
            page.get_by_label("Your name").fill(who)
            pages.append(page)
        for page, text in zip(pages, ("<b>look</b>\nhere", "seen"), strict=True):
            page.get_by_label("Comment", exact=True).fill(text)
            page.get_by_role("button", name="Comment").click()
            page.locator(".notes .comment", has_text=text.partition("\n")[0]).wait_for()
        assert pages[1].locator(".notes .comment").all_text_contents() == ["seen", "<b>look</b>\nhere"]
        pages[1].get_by_label("Tag", exact=True).fill("gate-3")
        pages[1].get_by_role("button", name="Put on").click()
        pages[1].locator(".tags").get_by_role("link", name="gate-3").wait_for()
        page = pages[0]
        wait_until(lambda: _finds(page, address, "log tag=gate-*"))
        page.locator(".found .when a").click()
        assert page.get_by_label("Your name").input_value() == "ann"
        page.get_by_role("button", name="Take off gate-3").click()
        page.get_by_text("no tags").wait_for()
    assert (directory / LOG.replace(".mcap", ".notes.jsonl")).read_text().count("\n") == 4


def _finds(page: Page, address: str, words: str) -> bool:
    page.goto(f"{address}#/")
    page.goto(f"{address}#/find/{words}")
    page.locator(
        "section[aria-label=Found] table, section[aria-label=Found] p.soft:not(:has-text('…'))"
    ).first.wait_for()
    return page.locator(".found tbody tr").count() == 1


def test_nothing_in_a_log_or_its_name_becomes_html(address: str, context: BrowserContext) -> None:
    """Neither in what is found nor on the page of the log; both are read as they are."""
    page = context.new_page()
    page.goto(f"{address}#/find/event robot=cruiser-9 text=*script*")
    page.locator(".found tbody tr", has_text="</script><script>").locator(".when a").click()
    page.locator("h1", has_text=STRANGE.replace("\u202e", "\ufffd")).wait_for()
    page.locator(".events", has_text="</script><script>").wait_for()
    assert page.locator("main img").count() == 0
    assert page.evaluate("document.body.dataset.owned") is None
    with page.expect_download() as loading:
        page.get_by_role("link", name="download the log").click()
    assert loading.value.path().stat().st_size > 0


def test_a_page_that_is_open_shows_a_log_that_comes(tmp_path: Path, context: BrowserContext) -> None:
    """And one that goes; nobody reloads it. Without --write nothing can be written."""
    with served(tmp_path) as address:
        page = context.new_page()
        # The directory is looked at anew every few seconds, and a busy machine takes its time with the log.
        page.set_default_timeout(60_000)
        page.goto(address)
        page.locator("#state", has_text="0 logs").wait_for()
        (tmp_path / "arriving").write_bytes(recorded(deadman))
        (tmp_path / "arriving").rename(tmp_path / LOG)
        page.locator(".found tbody tr", has_text="no acceptable drive command came in time").wait_for()
        page.locator(".found .when a").click()
        page.get_by_text("no comments").wait_for()
        assert page.locator("main input:not([name=from]):not([name=to]), main textarea").count() == 0
        page.goto(address)
        page.locator(".found tbody tr").wait_for()
        (tmp_path / LOG).unlink()
        page.locator(".found tbody tr").wait_for(state="detached")


class _Elsewhere(BaseHTTPRequestHandler):
    """A site of somebody else, with an empty page."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def elsewhere() -> Iterator[str]:
    """The origin of another site."""
    server = HTTPServer(("127.0.0.1", 0), _Elsewhere)
    serving = threading.Thread(target=server.serve_forever)
    serving.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        serving.join()
        server.server_close()


READ_A_RANGE = """(url) => fetch(url, { headers: { range: "bytes=1-4" } }).then(
    async (answer) => {
        const seen = (name) => answer.headers.get(name);
        return [answer.status, seen("content-range"), seen("etag") !== null, await answer.text()];
    },
    (error) => error.name)"""


def test_a_viewer_opens_a_log_by_its_address_and_no_other_site_does(
    tmp_path: Path, running_browser: Browser
) -> None:
    """By ranges, as a browser lets it; the link says the log and the moment."""
    shutil.copy(Path(__file__), tmp_path / "a.mcap")
    (tmp_path / LOG).write_bytes(recorded(front_bumper))
    context = running_browser.new_context(locale="en-GB")
    with elsewhere() as viewer, elsewhere() as other, served(tmp_path, "--viewer", f"{viewer}/view") as address:
        page = context.new_page()
        page.goto(f"{address}#/log/{LOG}?t=2023-11-14T22:13:22.040Z&robot=cruiser-1")
        link = page.get_by_role("link", name="Open in 127.0.0.1")
        parts = urlsplit(link.get_attribute("href") or "")
        asked = {name: values[0] for name, values in parse_qs(parts.query).items()}
        assert asked == {"ds": "remote-file", "ds.url": f"{address}logs/{LOG}", "time": "2023-11-14T22:13:22.040Z"}
        page.goto(f"{viewer}/view")
        size = (tmp_path / LOG).stat().st_size
        assert page.evaluate(READ_A_RANGE, asked["ds.url"]) == [206, f"bytes 1-4/{size}", True, "MCAP"]
        manifest = page.evaluate(
            "(url) => fetch(url).then((answer) => answer.json())", f"{address}manifest?log={LOG}"
        )
        assert manifest["sources"] == [{"url": f"/logs/{LOG}", "supportsRangeRequests": True}]
        page.goto(other)
        assert page.evaluate(READ_A_RANGE, asked["ds.url"]) == "TypeError"
    context.close()


def home(page: Page, address: str) -> None:
    """The calendar, and the newest drives."""
    page.goto(address)
    page.locator(".month a").first.wait_for()
    page.locator(".found tbody tr").first.wait_for()


def day(page: Page, address: str) -> None:
    """What happened on a day."""
    page.goto(f"{address}#/day/2023-11-14")
    page.locator(".found tbody tr").nth(1).wait_for()


def log(page: Page, address: str) -> None:
    """A moment of a log, explained."""
    page.goto(f"{address}#/log/{LOG}?t=2023-11-14T22:13:22.040Z&robot=cruiser-1")
    page.locator("#moment button").click()
    page.locator(".chain").wait_for()


@pytest.mark.parametrize(
    ("look", "theme", "language"),
    every_value((home, day, log), ("light", "dark"), ("en-GB", "zh-CN")),
    ids=lambda value: getattr(value, "__name__", value),
)
def test_every_page_is_for_everybody(
    look: object, theme: Literal["light", "dark"], language: str, address: str, running_browser: Browser
) -> None:
    """Names for whoever hears the page, contrast for whoever sees badly; 320 pixels are wide enough."""
    with opened(running_browser, language, color_scheme=theme) as context:
        page = context.new_page()
        look(page, address)  # type: ignore[operator]
        assert_for_everybody(page)
        assert_fits_a_small_phone(page)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["missing"], "missing is no directory"),
        ([".", "--listen", "0.0.0.0:0"], "browsers need TLS"),
        ([".", "--viewer", "javascript:alert(1)"], "no address of a viewer"),
    ],
)
def test_what_cannot_be_served_is_one_clear_line(words: list[str], said: str) -> None:
    """Before anything is listened on."""
    done = run(["serve", *words])
    assert done.returncode == ExitCode.USAGE
    assert said in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(("library", "extra"), [("pyarrow", "review"), ("starlette", "desk")])
def test_a_missing_package_is_one_line_that_says_how_to_get_it(tmp_path: Path, library: str, extra: str) -> None:
    """As where only the product itself is installed."""
    program = f"import sys; sys.modules[{library!r}] = None; from gateway.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "serve", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == ExitCode.FAILURE
    assert re.fullmatch(rf"cruiser serve: this needs .*{library}.*'\.\[{extra}\]'.*\n", done.stderr)
