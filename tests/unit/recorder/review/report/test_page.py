"""The page of a report, its charts and its words."""

import hashlib
import json
import re
from base64 import b64encode
from collections.abc import Iterator
from html.parser import HTMLParser
from importlib.resources import files
from itertools import accumulate, pairwise
from math import cos, hypot, radians, sin, tan
from pathlib import Path
from random import Random
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.review import report as report_package
from recorder.review.drives import DIED
from recorder.review.entries import EntryKind
from recorder.review.report.findings import (
    LINES,
    PLACES_MAX,
    DrivenPath,
    Point,
    Report,
    RobotReport,
    Series,
    Spans,
    verdict,
)
from recorder.review.report.page import MOMENTS_SHOWN, figures, page, safe_json, text
from schemas.decisions import ArbiterState, Severity
from schemas.messages import Message, Mode
from tests.support.drives import HOSTILE, drive_messages, restart, write_messages
from tests.support.messages import MS, PERIOD_NS, arbiter, event, gateway_info, refusal, state
from tests.support.reading import report_of


def series_of(*samples: tuple[int, float], limit: int = 1500) -> list[Point | None]:
    series = Series(limit)
    for time_ms, value in samples:
        series.add(time_ms * MS, value)
    return list(series.points())


@given(
    values=st.lists(st.floats(-10, 10), min_size=1, max_size=400),
    random=st.randoms(use_true_random=False),
    limit=st.integers(1, 40),
)
def test_bounds_and_ends_survive_whatever_the_order(values: list[float], random: Random, limit: int) -> None:
    """The lowest and highest value, the first and the last sample are drawn; the number of points is bounded."""
    samples = [(number * 20, value) for number, value in enumerate(values)]
    shuffled = list(samples)
    random.shuffle(shuffled)
    points = [point for point in series_of(*shuffled, limit=limit) if point is not None]
    assert len(points) <= 4 * limit
    assert points == sorted(points)
    assert {points[0], points[-1]} == {(samples[0][0], values[0]), (samples[-1][0] * MS, values[-1])}
    assert (min(value for _, value in points), max(value for _, value in points)) == (min(values), max(values))


def test_a_silence_breaks_the_line() -> None:
    times_ms = (0, 100, 200, 300, 3000, 3100)
    found = series_of(*((time_ms, float(time_ms)) for time_ms in times_ms))
    assert [None if point is None else point[1] for point in found] == [0, 100, 200, 300, None, 3000, 3100]


@pytest.mark.parametrize(
    ("samples", "found"),
    [
        ("0 a, 100 a, 200 b, 300 b", "0-200 a, 200-300 b"),
        ("0 a, 400 a, 5000 a, 5001 a", "0-400 a, 5000-5001 a"),
        ("0 , 100 a, 200 , 300 a, 250 late, 400 a", "100-200 a, 300-400 a"),
    ],
)
def test_a_value_holds_until_another_comes(samples: str, found: str) -> None:
    spans = Spans()
    for sample in samples.split(", "):
        time_ms, _, value = sample.partition(" ")
        spans.add(int(time_ms) * MS, value)
    assert ", ".join(f"{one.start_ns // MS}-{one.end_ns // MS} {one.value}" for one in spans.spans()) == found


def test_a_long_drive_keeps_a_bounded_number_of_places_near_the_path() -> None:
    path = DrivenPath()
    radius_m = 0.660 / tan(radians(10))
    for number in range(10 * 3600 * 5):
        turn_rad = number * 0.2 / radius_m
        pose = (radius_m * sin(turn_rad), radius_m * (1 - cos(turn_rad)), turn_rad)
        path.add(number * 200 * MS, pose, begins=not number)
    places = path.places()
    assert PLACES_MAX // 4 < len(places) <= PLACES_MAX + 1
    assert all(abs(hypot(place.x_m, place.y_m - radius_m) - radius_m) < 0.05 for place in places)
    assert places[-1].time_ns == (10 * 3600 * 5 - 1) * 200 * MS
    assert places == sorted(places, key=lambda place: place.time_ns)


BUMPER = "the front bumper was hit"
REMOTE = "the remote control has the robot"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return report_of(write_messages(tmp_path_factory.mktemp("log") / "a.mcap", drive_messages(201)))


def changed(report: Report, **changes: object) -> Report:
    (robot,) = report.robots
    summary = msgspec.structs.replace(robot.summary, **changes)
    return msgspec.structs.replace(report, robots=[msgspec.structs.replace(robot, summary=summary)])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, f"10.0 m; 1 stop: {BUMPER}."),
        ({"distance_m": 0.01, "stops": {}}, "0 m; no stops."),
        ({"known_s": 0.0, "stops": {}}, "distance not in the log; no stops."),
        ({"gaps": 2, "gap_s": 8.31, "stops": {}}, "at least 10.0 m (8.3 s not recorded); no stops."),
        ({"stops": {DIED: 1}}, "10.0 m; 1 stop: the gateway died."),
        ({"stops": {}, "lost_samples": 3, "lost_frames": 1}, "10.0 m; no stops; 3 samples lost; 1 frame lost."),
        ({"stops": {}, "ends": {"disengaged": 2}}, "10.0 m; no stops; 2 normal ends."),
        ({"stops": {"remote_stop": 1}}, "10.0 m; 1 stop by an operator: a remote stop was received."),
        (
            {"stops": {"front_bumper": 2, "hand_transmitter": 1}},
            f"10.0 m; 3 stops (2 faults, 1 by operators): 2 x {BUMPER}, 1 x {REMOTE}.",
        ),
        ({"stops": {}, "ends_commanding": True}, "10.0 m; no stops; recording ends while the robot is commanded."),
    ],
)
def test_the_verdict(report: Report, changes: dict[str, Any], said: str) -> None:
    (robot,) = changed(report, **{"ends_commanding": False} | changes).robots
    assert verdict(robot) == f"1 drive, {said}"


def drawn_of(robot: RobotReport) -> dict[str, Any]:
    (drawn,) = robot.drawn
    return figures(robot.summary, drawn)


def robot_of(tmp_path: Path, *more: object) -> RobotReport:
    messages = [*drive_messages(100), *more]
    return report_of(write_messages(tmp_path / "a.mcap", messages)).robots[0]  # type: ignore[arg-type]


def line_of(found: dict[str, Any], key: str) -> list[tuple[int, float | None]]:
    steps, values = found["lines"][LINES.index(key)]
    return list(zip((time_ms - found["from_ms"] for time_ms in accumulate(steps)), values, strict=True))


def test_a_line_has_the_values_of_its_time_and_breaks_off(tmp_path: Path) -> None:
    robot = robot_of(tmp_path)
    begin = robot.summary.start_ns
    points = [(begin, 1.0), (begin + 20 * MS, 1.00049), None, (begin + 900 * MS, 2.0)]
    found = figures(robot.summary, msgspec.structs.replace(robot.drawn[0], lines={"speed_mps": points}))
    assert line_of(found, "speed_mps") == [(0, 1.0), (20, 1.0), (21, None), (900, 2.0)]
    assert line_of(found, "angle_deg") == []
    measured = line_of(drawn_of(robot), "speed_mps")
    assert measured[0] == (0, 1.0)
    assert measured[-1][0] == 99 * PERIOD_NS // MS


def test_what_a_log_says_rules_no_line(tmp_path: Path) -> None:
    hostile = event(101, text=HOSTILE, operator="a\x1b[31m\nb")
    holders = [arbiter(101 + number, lease_holder=HOSTILE) for number in range(3)]
    encoded = msgspec.json.encode(drawn_of(robot_of(tmp_path, hostile, *holders))).decode()
    assert "\u202e" not in encoded
    assert "operator: a\\\\x1b[31m\\\\nb" in encoded


def test_every_state_and_event_has_a_look_of_its_own() -> None:
    """The arbiter's states and the chassis's modes have colours; all kinds of events marks that differ."""
    script = (files(report_package) / "page.js").read_text()
    colours = script.partition("const COLOURS = {")[2].partition("}")[0]
    for value in (*ArbiterState, *(mode for mode in Mode if mode is not Mode.UNDEFINED)):
        assert f" {value.value}: " in colours
    marks = re.findall(r"^    (\w+): (look\(.*\)),", script, re.MULTILINE)
    assert {kind for kind, _ in marks} == {kind.value for kind in EntryKind} - {"refusal", "request"}
    assert len({look for _, look in marks}) == len(marks)


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
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Report:
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
        self.found.append((tag, dict(attrs)))

    def of(self, tag: str) -> Iterator[dict[str, str | None]]:
        return (attributes for name, attributes in self.found if name == tag)


def test_the_page_names_nothing_outside_itself(hostile: Report) -> None:
    """No address in an attribute; the policy lets the browser fetch nothing."""
    elements = Elements(page(hostile))
    for tag, attributes in elements.found:
        for name in ("src", "href", "action", "srcset"):
            assert (attributes.get(name) or "#").startswith(("#", "data:")), tag
    (policy,) = (one["content"] or "" for one in elements.of("meta") if "http-equiv" in one)
    assert policy.startswith("default-src 'none'")
    assert "unsafe-inline" not in policy.partition("script-src")[2]


def test_no_script_but_the_pages_own_may_run(hostile: Report) -> None:
    html = page(hostile)
    scripts = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    assert len(scripts) == 2
    hashes = (b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    (allowed,) = re.findall(r'script-src ([^"]*)"', html)
    assert allowed.replace("&#x27;", "'") == " ".join(f"'sha256-{one}'" for one in hashes)
    assert "Copyright (c) 2022 Leon Sorokin" in html
    assert "MessagePack" not in html
    assert page(hostile) == html


def test_a_page_is_no_load_for_a_mailbox(tmp_path: Path) -> None:
    """Of five minutes 400 kB at most; of longer drives it holds no more points."""
    assert len(page(report_of(write_messages(tmp_path / "a.mcap", drive_messages(6000)))).encode()) < 400_000


def test_the_page_can_be_read_without_seeing_it(hostile: Report) -> None:
    html = page(hostile)
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


def test_the_verdict_comes_first(tmp_path: Path) -> None:
    log = [gateway_info(0, "a = 1\n"), *restart(100, 60), gateway_info(160, "a = 2\n")]
    html = page(report_of(write_messages(tmp_path / "a.mcap", sorted(log, key=lambda one: one.time_ns))))
    before, _, after = html.partition(">Path<")
    said = "1 drive, at least 4.9 m (3.0 s not recorded); 1 stop: the gateway died; 60 samples lost."
    assert f'<p class="verdict">{said}</p>' in before
    assert '<p class="note">Worst moment, <a href="#t=2027-01-15T08:00:08.000Z">08:00:08.000</a>: ' in before
    row = '<tr class="error" data-ms="1800000008000"><td><a href="#t=2027-01-15T08:00:08.000Z">'
    assert f"{row}08:00:08.000</a></td><td>gateway</td>" in after
    for text_of_one in ("a = 1\n", "a = 2\n"):
        assert f"<td>{gateway_info(0, text_of_one).configuration_sha256[:12]}</td>" in after


def test_errors_are_shown_however_many_events_there_are(hostile: Report) -> None:
    robot = hostile.robots[0]
    lease = msgspec.structs.replace(robot.moments[0], severity=Severity.INFO, kind=EntryKind.LEASE)
    gateway = {"severity": Severity.ERROR, "kind": EntryKind.GATEWAY, "time_ns": lease.time_ns + 1}
    death = msgspec.structs.replace(lease, **gateway)
    moments = [lease] * (MOMENTS_SHOWN + 50) + [death]
    drawn = msgspec.structs.replace(robot.drawn[0], moments=moments)
    changed = msgspec.structs.replace(robot, drawn=[drawn], moments=moments, more_moments=2)
    html = page(msgspec.structs.replace(hostile, robots=[changed]))
    assert html.count("<td>lease</td>") == MOMENTS_SHOWN - 1
    assert html.count("<td>gateway</td>") == 1
    assert "53 less severe or later ones are left out" in html


@given(st.recursive(st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)))
def test_json_in_a_script_stays_json_and_ends_no_script(value: object) -> None:
    encoded = safe_json(value)
    assert json.loads(encoded) == value
    assert not set(encoded) & set("<>&\u2028\u2029")


@given(st.text())
def test_text_is_never_markup(value: str) -> None:
    shown = text(value)
    assert not set(shown) & set("<>\"'")
    assert shown.isprintable()
