"""The report as one HTML file, and what a real browser makes of it."""

import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Final

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from plotly.offline import get_plotlyjs

from recorder.review.report.figures import BLUE
from recorder.review.report.findings import Outage, Report
from recorder.review.report.page import MOMENTS_SHOWN, page, safe_json, text
from recorder.review.report.words import SHOWN
from schemas.messages import Message
from tests.support.browser import Opened, browser, open_page, take_picture
from tests.support.report_drive import (
    HOSTILE,
    arbiter,
    drive,
    event,
    gateway,
    refusal,
    report_of,
    restart,
    state,
    write_log,
)

in_browser = pytest.mark.skipif(browser() is None, reason="there is no Chromium")

HOVER: Final = """
setTimeout(function () {
  const field = document.querySelector("#time-1 .nsewdrag[data-subplot='xy']");
  const box = field.getBoundingClientRect();
  const at = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2, bubbles: true };
  for (const kind of ["mouseenter", "mouseover", "mousemove"]) { field.dispatchEvent(new MouseEvent(kind, at)); }
  setTimeout(function () {
    const marks = [0, 1].map((number) => document.getElementById("map-" + number).data.slice(-1)[0].x);
    document.body.dataset.marks = JSON.stringify(marks);
  }, 500);
}, 3000);
"""
"""Points at the middle of the second robot's time, and says where the maps' marks are then."""

POLICY: Final = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')


def hostile_drive() -> list[Message]:
    """A drive in which every text is an attack."""
    return [
        *drive(200),
        *(
            message
            for number in range(200, 240)
            for message in (state(number), arbiter(number, lease_holder=HOSTILE))
        ),
        event(210, text=HOSTILE, operator=HOSTILE),
        refusal(211, request=HOSTILE, operator=HOSTILE, detail=HOSTILE),
    ]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Of two robots, in which every text is an attack."""
    path = tmp_path_factory.mktemp("log") / "<b>a&b.mcap"
    found = report_of(write_log(path, hostile_drive(), robots=["cruiser-1", "cruiser-2"]))
    return msgspec.structs.replace(found, faults=[HOSTILE], fault_count=3)


@pytest.fixture(scope="module")
def opened(report: Report, tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """The page in a browser, without the policy that would stop what escaping has let through."""
    scratch = tmp_path_factory.mktemp("browser")
    file = scratch / "report.html"
    html, count = POLICY.subn("", page(report, get_plotlyjs() + HOVER))
    assert count == 1
    file.write_text(html)
    return open_page(file, scratch)


class Elements(HTMLParser):
    """The elements of a page, in order, and the text of its scripts."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """One more element."""
        self.found.append((tag, dict(attrs)))

    def of(self, tag: str) -> Iterator[dict[str, str | None]]:
        """The attributes of the elements of this name."""
        return (attributes for name, attributes in self.found if name == tag)


@in_browser
def test_charts_are_drawn_and_nothing_is_complained_about(opened: Opened) -> None:
    """Two charts for each robot, with lines, bands and marks in them; the console is empty."""
    assert opened.console == []
    assert 'data-drawn="4"' in opened.dom
    # Each of the four: at least a line, and marks.
    assert opened.dom.count('class="main-svg"') >= 4
    charts = re.split(r'id="(?:map|time)-\d"', opened.dom)[1:]
    assert len(charts) == 4
    for chart in charts:
        assert "js-line" in chart
        assert 'class="point"' in chart
    assert opened.dom.count('class="bars"') + opened.dom.count('class="trace bars"') >= 6


@in_browser
def test_the_page_asks_for_nothing(opened: Opened) -> None:
    """Neither of its own accord nor of the log's."""
    assert [url for url in opened.requests if not url.startswith(("file:", "data:"))] == []


@in_browser
def test_hostile_text_is_shown_as_text(opened: Opened) -> None:
    """In tables, headings and charts: no script of the log's has run, and no element of its has come to be."""
    assert "data-owned" not in opened.dom
    elements = Elements(opened.dom)
    assert not any("evil" in (attributes.get("src") or "") for attributes in elements.of("img"))
    assert opened.dom.count("&lt;/script&gt;&lt;script&gt;") > 10


@in_browser
def test_pointing_at_a_time_marks_the_place_on_that_robots_map(opened: Opened) -> None:
    """In the middle of a drive of 10 m."""
    marks = re.search(r'data-marks="([^"]*)"', opened.dom)
    assert marks is not None
    first, second = json.loads(marks[1].replace("&quot;", '"'))
    assert first == []
    assert len(second) == 1


@in_browser
def test_the_policy_stops_what_escaping_might_let_through(report: Report, tmp_path: Path) -> None:
    """A foreign script and a foreign picture in the page do nothing; its own scripts run."""
    attack = "<script>document.body.dataset.owned = 1</script><img src='http://evil.test/x.png'>"
    file = tmp_path / "report.html"
    file.write_text(page(report, get_plotlyjs()).replace("<main>", f"<main>{attack}"))
    opened = open_page(file, tmp_path)
    assert "data-owned" not in opened.dom
    assert not [url for url in opened.requests if url.startswith("http")]
    assert any("Content Security Policy" in line for line in opened.console)
    assert 'data-drawn="4"' in opened.dom


@in_browser
def test_a_phone_in_the_dark_shows_the_path(report: Report, tmp_path: Path) -> None:
    """The page is dark, and the path's blue is on it."""
    file = tmp_path / "report.html"
    file.write_text(page(report, get_plotlyjs()))
    with Image.open(BytesIO(take_picture(file, tmp_path, 500, 2600, dark=True))) as shot:
        pixels = shot.convert("RGB")
        assert pixels.width == 500
        colours = {colour: count for count, colour in pixels.getcolors(1 << 20) or () if isinstance(colour, tuple)}
    blue = tuple(int(BLUE[at : at + 2], 16) for at in (1, 3, 5))
    assert colours.get(blue, 0) > 200
    assert max(colours, key=lambda colour: colours[colour]) < (60, 60, 60)


def test_the_page_names_nothing_outside_itself(report: Report) -> None:
    """No address in an attribute; the policy lets the browser fetch nothing."""
    elements = Elements(page(report, ""))
    for tag, attributes in elements.found:
        for name in ("src", "href", "action", "srcset"):
            assert (attributes.get(name) or "#").startswith(("#", "data:")), tag
    (policy,) = (one["content"] or "" for one in elements.of("meta") if "http-equiv" in one)
    assert policy.startswith("default-src 'none'")
    assert "unsafe-inline" not in policy.partition("script-src")[2]


def test_the_page_can_be_read_without_seeing_it(report: Report) -> None:
    """Language, headings in order, charts that are named, tables with captions and heads."""
    html = page(report, "")
    elements = Elements(html)
    assert next(elements.of("html"))["lang"] == "en"
    levels = [int(tag[1]) for tag, _ in elements.found if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    charts = [one for one in elements.of("div") if one.get("role") == "img"]
    assert len(charts) == 4
    assert all(one["aria-label"] for one in charts)
    assert html.count("<table>") == html.count("<caption>") > 4
    assert all(one.get("scope") == "col" for one in elements.of("th"))


def test_what_the_summary_says_is_on_the_page(report: Report) -> None:
    """Stops, refusals, completeness, versions, faults, files."""
    html = page(report, "")
    for said in (
        "the front bumper was hit",
        "operator-2",
        "samples on the way",
        "cruiser-gateway 0.1.0",
        "3 faults",
    ):
        assert said in html
    assert "&lt;b&gt;a&amp;b.mcap" in html
    assert "<b>a&b" not in html


def test_a_gateway_that_died_stands_before_all_else(tmp_path: Path) -> None:
    """As a note, a figure, and among the events; each configuration is in a table, with since when."""
    log = [gateway(0, "a = 1\n"), *restart(100, 60), gateway(160, "a = 2\n")]
    html = page(report_of(write_log(tmp_path / "a.mcap", sorted(log, key=lambda one: one.time_ns))), "")
    before, _, after = html.partition(">Summary<")
    assert '<p class="note">Gateway: it fell silent at 2027-01-15 08:00:04.950 UTC while it commanded' in before
    assert "Gateway: since 2027-01-15 08:00:08.000 UTC it has another configuration: a 2, 1 before.</p>" in before
    assert "<strong>1</strong><span>gateway outage</span>" in before
    assert '<tr class="error"><td>08:00:08.000</td><td>gateway</td>' in after
    for text_of_one in ("a = 1\n", "a = 2\n"):
        assert f"<td>{gateway(0, text_of_one).configuration_sha256[:12]}</td>" in after


def test_errors_are_shown_however_many_events_there_are(report: Report) -> None:
    """The table has room for so many; those that matter least are left out."""
    robot = report.robots[0]
    lease = msgspec.structs.replace(robot.charts.moments[0], severity="info", kind="lease")
    death = msgspec.structs.replace(lease, severity="error", kind="gateway", time_ns=lease.time_ns + 1)
    moments = [lease] * (MOMENTS_SHOWN + 50) + [death]
    charts = msgspec.structs.replace(robot.charts, moments=moments, more_moments=2)
    html = page(msgspec.structs.replace(report, robots=[msgspec.structs.replace(robot, charts=charts)]), "")
    assert html.count("<td>lease</td>") == MOMENTS_SHOWN - 1
    assert html.count("<td>gateway</td>") == 1
    assert "53 of less weight, or later, are left out" in html


def test_a_gateway_that_dies_without_end_fills_no_page(report: Report) -> None:
    """A few notes, and how many more."""
    robot = report.robots[0]
    outages = [Outage(number, number, is_commanding=True) for number in range(100)]
    summary = msgspec.structs.replace(robot.summary, outages=outages)
    html = page(msgspec.structs.replace(report, robots=[msgspec.structs.replace(robot, summary=summary)]), "")
    assert html.count('<p class="note">Gateway: it began anew') == SHOWN
    assert "more such; see the events" in html


@settings(max_examples=40)
@given(st.recursive(st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)))
def test_json_in_a_script_stays_json_and_ends_no_script(value: object) -> None:
    """Whatever is in it."""
    encoded = safe_json(value)
    assert json.loads(encoded) == value
    assert not set(encoded) & set("<>&\u2028\u2029")


@given(st.text())
def test_text_is_never_markup(value: str) -> None:
    """Nor does it hold a character that rules the line."""
    shown = text(value)
    assert not set(shown) & set("<>\"'")
    assert shown.isprintable()
