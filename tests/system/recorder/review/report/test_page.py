"""The report as one HTML file, and what a real browser makes of it."""

import json
import re
from io import BytesIO
from pathlib import Path
from typing import Final

import msgspec
import pytest
from PIL import Image

from recorder.review.report.findings import Report
from recorder.review.report.page import page
from tests.support.drives import HOSTILE, write_messages
from tests.support.processes.browser import Opened, open_page, take_picture
from tests.support.reading import report_of
from tests.unit.recorder.review.report.test_page import Elements, hostile_drive

HOVER: Final = """
setTimeout(function () {
  const canvases = Array.from(document.querySelectorAll("#time-0 canvas, #time-1 canvas"));
  document.body.dataset.inked = JSON.stringify(canvases.map((canvas) => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let at = 0; at < data.length; at += 4) { count += BLUE.every((part, of) => data[at + of] === part); }
    return count;
  }));
  const field = document.querySelector("#time-1 .u-over");
  const box = field.getBoundingClientRect();
  const at = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2, bubbles: true };
  for (const kind of ["mouseenter", "mouseover", "mousemove"]) { field.dispatchEvent(new MouseEvent(kind, at)); }
  setTimeout(function () {
    const ghosts = Array.from(document.querySelectorAll(".ghost"), (ghost) => ghost.getAttribute("d") || "");
    document.body.dataset.marks = JSON.stringify(ghosts);
  }, 500);
}, 3000);
"""
"""Counts blue in the charts, then points at the middle of the second robot's time: which outlines are there?"""

PATH_BLUE: Final = (0x39, 0x87, 0xE5)
POLICY: Final = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Of two robots, in which every text is an attack."""
    path = tmp_path_factory.mktemp("log") / "<b>a&b.mcap"
    found = report_of(write_messages(path, hostile_drive(), robots=["cruiser-1", "cruiser-2"]))
    return msgspec.structs.replace(found, faults=[HOSTILE], fault_count=3)


@pytest.fixture(scope="module")
def opened(report: Report, tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """The page in a browser, without the policy that would stop what escaping has let through."""
    scratch = tmp_path_factory.mktemp("browser")
    file = scratch / "report.html"
    html, count = POLICY.subn("", page(report))
    assert count == 1
    file.write_text(
        html.replace("</body>", f"<script>const BLUE = {json.dumps(PATH_BLUE)};{HOVER}</script></body>")
    )
    return open_page(file, scratch)


def test_charts_are_drawn_and_nothing_is_complained_about(opened: Opened) -> None:
    """Two charts for each robot, with lines, bands and marks in them; the console is empty."""
    assert opened.console == []
    assert 'data-drawn="4"' in opened.dom
    charts = re.split(r'id="(?:map|time)-\d"', opened.dom)[1:]
    assert len(charts) == 4
    for chart in charts:
        assert 'class="mark"' in chart
    assert len(re.findall(r'class="way"[^>]* d="M|d="M[^"]*" class="way"', opened.dom)) == 2
    assert opened.dom.count('class="bar"') >= 6
    inked = re.search(r'data-inked="([^"]*)"', opened.dom)
    assert inked is not None
    assert len(json.loads(inked[1])) == 4
    assert min(json.loads(inked[1])) > 100


def test_the_page_asks_for_nothing(opened: Opened) -> None:
    """Neither of its own accord nor of the log's."""
    assert [url for url in opened.requests if not url.startswith(("file:", "data:"))] == []


def test_hostile_text_is_shown_as_text(opened: Opened) -> None:
    """In tables, headings and charts: no script of the log's has run, and no element of its has come to be."""
    assert "data-owned" not in opened.dom
    elements = Elements(opened.dom)
    assert not any("evil" in (attributes.get("src") or "") for attributes in elements.of("img"))
    assert opened.dom.count("&lt;/script&gt;&lt;script&gt;") > 10


def test_pointing_at_a_time_marks_the_place_on_that_robots_map(opened: Opened) -> None:
    """In the middle of a drive of 10 m."""
    marks = re.search(r'data-marks="([^"]*)"', opened.dom)
    assert marks is not None
    first, second = json.loads(marks[1].replace("&quot;", '"'))
    assert first == ""
    assert second.startswith("M")


def test_the_policy_stops_what_escaping_might_let_through(report: Report, tmp_path: Path) -> None:
    """A foreign script and a foreign picture in the page do nothing; its own scripts run."""
    attack = "<script>document.body.dataset.owned = 1</script><img src='http://evil.test/x.png'>"
    file = tmp_path / "report.html"
    file.write_text(page(report).replace("<main>", f"<main>{attack}"))
    opened = open_page(file, tmp_path)
    assert "data-owned" not in opened.dom
    assert not [url for url in opened.requests if url.startswith("http")]
    assert any("Content Security Policy" in line for line in opened.console)
    assert 'data-drawn="4"' in opened.dom


def test_a_phone_in_the_dark_shows_the_path(report: Report, tmp_path: Path) -> None:
    """The page is dark, and the path's blue is on it."""
    file = tmp_path / "report.html"
    file.write_text(page(report))
    with Image.open(BytesIO(take_picture(file, tmp_path, 500, 2600, dark=True))) as shot:
        pixels = shot.convert("RGB")
        assert pixels.width == 500
        colours = {colour: count for count, colour in pixels.getcolors(1 << 20) or () if isinstance(colour, tuple)}
    assert colours.get(PATH_BLUE, 0) > 200
    assert max(colours, key=lambda colour: colours[colour]) < (60, 60, 60)
