"""The report as one HTML file, and what a real browser makes of it."""

import re
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, Request

from recorder.review.report.findings import Report
from recorder.review.report.page import page
from tests.support.drives import HOSTILE, write_messages
from tests.support.reading import report_of
from tests.support.waiting import wait_until
from tests.unit.recorder.review.report.test_page import Elements, hostile_drive

INKED: Final = """(blue) => Array.from(document.querySelectorAll("#time-0 canvas, #time-1 canvas"), (canvas) => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let at = 0; at < data.length; at += 4) { count += blue.every((part, of) => data[at + of] === part); }
  return count;
})"""
"""Counts blue in the charts."""

POINT: Final = """() => {
  const field = document.querySelector("#time-1 .u-over");
  const box = field.getBoundingClientRect();
  const at = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2, bubbles: true };
  for (const kind of ["mouseenter", "mouseover", "mousemove"]) { field.dispatchEvent(new MouseEvent(kind, at)); }
}"""
"""Points at the middle of the second robot's time."""

GHOSTS: Final = (
    """() => Array.from(document.querySelectorAll(".ghost"), (ghost) => ghost.getAttribute("d") || "")"""
)
"""The outlines that are there."""

PATH_BLUE: Final = (0x39, 0x87, 0xE5)
POLICY: Final = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    path = tmp_path_factory.mktemp("log") / "<b>a&b.mcap"
    found = report_of(write_messages(path, hostile_drive(), robots=["cruiser-1", "cruiser-2"]))
    return msgspec.structs.replace(found, faults=[HOSTILE], fault_count=3)


class Opened(NamedTuple):
    """A page in the browser, what was written to its console, and the addresses that it asked for."""

    page: Page
    console: list[str]
    requests: list[str]

    @property
    def dom(self) -> str:
        return self.page.content()


def _forget_refused(requests: list[str], failed: Request) -> None:
    """What the page's policy has refused was not asked for."""
    if "csp" in (failed.failure or ""):
        requests.remove(failed.url)


def open_page(context: BrowserContext, directory: Path, html: str) -> Opened:
    file = directory / "report.html"
    file.write_text(html)
    opened = Opened(context.new_page(), [], [])
    opened.page.on("console", lambda message: opened.console.append(message.text))
    opened.page.on("request", lambda request: opened.requests.append(request.url))
    opened.page.on("requestfailed", partial(_forget_refused, opened.requests))
    opened.page.goto(file.as_uri())
    opened.page.locator('[data-drawn="4"]').wait_for(state="attached")
    return opened


@pytest.fixture(scope="module")
def opened(report: Report, running_browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """The page in a browser, without the policy that would stop what escaping has let through."""
    html, count = POLICY.subn("", page(report))
    assert count == 1
    return open_page(running_browser.new_context(), tmp_path_factory.mktemp("browser"), html)


def test_charts_are_drawn_and_nothing_is_complained_about(opened: Opened) -> None:
    assert opened.console == []
    charts = re.split(r'id="(?:map|time)-\d"', opened.dom)[1:]
    assert len(charts) == 4
    for chart in charts:
        assert 'class="mark"' in chart
    assert len(re.findall(r'class="way"[^>]* d="M|d="M[^"]*" class="way"', opened.dom)) == 2
    assert opened.dom.count('class="bar"') >= 6
    inked = opened.page.evaluate(INKED, PATH_BLUE)
    assert len(inked) == 4
    assert min(inked) > 100


def test_the_page_asks_for_nothing(opened: Opened) -> None:
    assert [url for url in opened.requests if not url.startswith(("file:", "data:"))] == []


def test_hostile_text_is_shown_as_text(opened: Opened) -> None:
    assert "data-owned" not in opened.dom
    elements = Elements(opened.dom)
    assert not any("evil" in (attributes.get("src") or "") for attributes in elements.of("img"))
    assert opened.dom.count("&lt;/script&gt;&lt;script&gt;") > 10


def test_pointing_at_a_time_marks_the_place_on_that_robots_map(opened: Opened) -> None:
    opened.page.evaluate(POINT)
    wait_until(lambda: opened.page.evaluate(GHOSTS)[1])
    first, second = opened.page.evaluate(GHOSTS)
    assert first == ""
    assert second.startswith("M")


def test_the_policy_stops_what_escaping_might_let_through(
    report: Report, running_browser: Browser, tmp_path: Path
) -> None:
    """A foreign script and a foreign picture in the page do nothing; its own scripts run."""
    attack = "<script>document.body.dataset.owned = 1</script><img src='http://evil.test/x.png'>"
    html = page(report).replace("<main>", f"<main>{attack}")
    opened = open_page(running_browser.new_context(), tmp_path, html)
    assert "data-owned" not in opened.dom
    assert not [url for url in opened.requests if url.startswith("http")]
    assert any("Content Security Policy" in line for line in opened.console)
