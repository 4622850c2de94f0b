"""The page of a report, as text."""

import hashlib
import json
import re
from base64 import b64encode
from collections.abc import Iterator
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.review.report.findings import Report
from recorder.review.report.page import MOMENTS_SHOWN, page, safe_json, text
from schemas.messages import Message
from tests.support.drives import HOSTILE, drive_messages, drives_over, restart, write_messages
from tests.support.messages import arbiter, event, gateway_info, refusal, state
from tests.support.reading import report_of


def hostile_drive() -> list[Message]:
    """A drive in which every text is an attack."""
    return [
        *drive_messages(200),
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
    found = report_of(write_messages(path, hostile_drive(), robots=["cruiser-1", "cruiser-2"]))
    return msgspec.structs.replace(found, faults=[HOSTILE], fault_count=3)


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


def test_the_page_names_nothing_outside_itself(report: Report) -> None:
    """No address in an attribute; the policy lets the browser fetch nothing."""
    elements = Elements(page(report))
    for tag, attributes in elements.found:
        for name in ("src", "href", "action", "srcset"):
            assert (attributes.get(name) or "#").startswith(("#", "data:")), tag
    (policy,) = (one["content"] or "" for one in elements.of("meta") if "http-equiv" in one)
    assert policy.startswith("default-src 'none'")
    assert "unsafe-inline" not in policy.partition("script-src")[2]


def test_no_script_but_the_pages_own_may_run(report: Report) -> None:
    """The policy names the hash of each; the licence of the library is there, as it demands."""
    html = page(report)
    scripts = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    assert len(scripts) == 2
    hashes = (b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    (allowed,) = re.findall(r'script-src ([^"]*)"', html)
    assert allowed.replace("&#x27;", "'") == " ".join(f"'sha256-{one}'" for one in hashes)
    assert "Copyright (c) 2022 Leon Sorokin" in html
    assert "MessagePack" not in html
    assert page(report) == html


def test_a_page_is_no_load_for_a_mailbox(tmp_path: Path) -> None:
    """Of five minutes 400 kB at most; of longer drives it holds no more points."""
    assert len(page(report_of(write_messages(tmp_path / "a.mcap", drive_messages(6000)))).encode()) < 400_000


def test_the_page_can_be_read_without_seeing_it(report: Report) -> None:
    """Language, headings in order, charts that are named, tables with captions and heads."""
    html = page(report)
    elements = Elements(html)
    assert next(elements.of("html"))["lang"] == "en"
    levels = [int(tag[1]) for tag, _ in elements.found if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    charts = [one for one in elements.of("div") if (one.get("class") or "").startswith("chart ")]
    assert len(charts) == 4
    assert all(one["role"] == "group" and one["aria-label"] for one in charts)
    assert html.count("<table>") == html.count("<caption>") > 4
    assert all(one.get("scope") == "col" for one in elements.of("th"))


def test_what_the_summary_says_is_on_the_page(report: Report) -> None:
    """Stops, refusals, completeness, versions, faults, files."""
    html = page(report)
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


def test_the_verdict_comes_first(tmp_path: Path) -> None:
    """The sentence, the figures, and the worst moment with its link stand before all charts and tables."""
    log = [gateway_info(0, "a = 1\n"), *restart(100, 60), gateway_info(160, "a = 2\n")]
    html = page(report_of(write_messages(tmp_path / "a.mcap", sorted(log, key=lambda one: one.time_ns))))
    before, _, after = html.partition(">Path<")
    assert (
        '<p class="verdict">1 drive, at least 4.9 m (3.0 s not recorded); 1 stop: the gateway died.</p>' in before
    )
    assert "<strong>1</strong><span>stops by faults</span>" in before
    assert '<p class="note">Worst moment, <a href="#t=2027-01-15T08:00:08.000Z">08:00:08.000</a>: ' in before
    row = '<tr class="error" data-ms="1800000008000"><td><a href="#t=2027-01-15T08:00:08.000Z">'
    assert f"{row}08:00:08.000</a></td><td>gateway</td>" in after
    for text_of_one in ("a = 1\n", "a = 2\n"):
        assert f"<td>{gateway_info(0, text_of_one).configuration_sha256[:12]}</td>" in after
    assert "<td>a 2, 1 before</td>" in after


def test_errors_are_shown_however_many_events_there_are(report: Report) -> None:
    """The table has room for so many; those that matter least are left out."""
    robot = report.robots[0]
    lease = msgspec.structs.replace(robot.moments[0], severity="info", kind="lease")
    death = msgspec.structs.replace(lease, severity="error", kind="gateway", time_ns=lease.time_ns + 1)
    moments = [lease] * (MOMENTS_SHOWN + 50) + [death]
    drawn = msgspec.structs.replace(robot.drawn[0], moments=moments)
    changed = msgspec.structs.replace(robot, drawn=[drawn], moments=moments, more_moments=2)
    html = page(msgspec.structs.replace(report, robots=[changed]))
    assert html.count("<td>lease</td>") == MOMENTS_SHOWN - 1
    assert html.count("<td>gateway</td>") == 1
    assert "53 of less weight, or later, are left out" in html


def test_several_drives_have_a_table_with_links(tmp_path: Path) -> None:
    """Each with its distance, its stops, its worst moment, and a section of its own."""
    html = page(report_of(write_messages(tmp_path / "a.mcap", drives_over(3, 3))))
    table = html.partition('id="overview"')[2].partition("</table>")[0]
    assert len(re.findall(r"<td>(2\.9|3\.0) m</td><td class=number>1</td>", table)) == 3  # Of 2.95 m.
    assert re.findall(r'href="(#drive-\d)"', table) == ["#drive-0", "#drive-1", "#drive-2"]
    assert table.count('<b><a href="#t=') == 3
    assert html.count('class="drive" id="drive-') == 3


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
