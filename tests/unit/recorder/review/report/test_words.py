"""A robot in words: the verdict, and the lines below it."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from recorder.record.accounting import KeyReport
from recorder.review.drives import DIED, Outage, Silence
from recorder.review.report.findings import (
    Driver,
    Refusal,
    Report,
    duration,
    metres,
    moment_words,
    reason_words,
    size,
    summary_lines,
    verdict,
    who,
)
from schemas.reasons import Reason
from tests.support.drives import drive_messages, write_messages
from tests.support.messages import SECOND, WALL_NS
from tests.support.reading import report_of

FIRST = "2027-01-15 08:00:01.000 UTC"
LOSSY = {"fleet/cruiser-1/state": KeyReport(sent=9, received=7, written=7, lost_link=2, lost_bus=3)}
BUMPER = "the front bumper was hit"
REMOTE = "the hand transmitter has the robot"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Of a short drive."""
    return report_of(write_messages(tmp_path_factory.mktemp("log") / "a.mcap", drive_messages(201)))


def changed(report: Report, **changes: object) -> Report:
    """With other figures of its robot."""
    (robot,) = report.robots
    summary = msgspec.structs.replace(robot.summary, **changes)
    return msgspec.structs.replace(report, robots=[msgspec.structs.replace(robot, summary=summary)])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, f"1 drive, 10.0 m; 1 stop: {BUMPER}."),
        ({"distance_m": 0.01, "stops": {}}, "1 drive, 0 m; no stops."),
        ({"known_s": 0.0, "stops": {}}, "1 drive, distance not in the log; no stops."),
        ({"gaps": 2, "gap_s": 8.31, "stops": {}}, "1 drive, at least 10.0 m (8.3 s not recorded); no stops."),
        ({"stops": {DIED: 1}}, "1 drive, 10.0 m; 1 stop: the gateway died."),
        ({"stops": {}, "ends": {"disengaged": 2}}, "1 drive, 10.0 m; no stops; 2 normal ends."),
        (
            {"stops": {"remote_stop": 1}},
            "1 drive, 10.0 m; 1 stop by an operator: a remote stop was received.",
        ),
        (
            {"stops": {"front_bumper": 2, "hand_transmitter": 1}},
            f"1 drive, 10.0 m; 3 stops (2 faults, 1 by operators): 2 x {BUMPER}, 1 x {REMOTE}.",
        ),
        (
            {"stops": {}, "ends_commanding": True},
            "1 drive, 10.0 m; no stops; recording ends while the robot is commanded.",
        ),
    ],
)
def test_the_verdict(report: Report, changes: dict[str, Any], said: str) -> None:
    """Distance, drives, stops by cause, normal ends."""
    (robot,) = changed(report, **{"ends_commanding": False} | changes).robots
    assert verdict(robot) == said


@pytest.mark.parametrize(
    ("line", "changes", "said"),
    [
        ("Robot", {}, "cruiser-1, keys fleet/cruiser-1/"),
        ("When", {}, "2027-01-15 08:00:00.000 UTC to 2027-01-15 08:00:10.000 UTC: 10.0 s"),
        (
            "Distance",
            {"top_mps": -1.0},
            "10.0 m, moving 10.0 s of 10.0 s; top speed 1.00 m/s in reverse at 2027-01-15 08:00:00.000 UTC",
        ),
        ("Distance", {"known_s": 0.0}, "not in the log"),
        ("Normal ends", {}, "none"),
        ("Normal ends", {"ends": {"disengaged": 2}}, "2 the holder of the lease disengaged"),
        ("Worst moment", {}, f"2027-01-15 08:00:10.000 UTC: stopping: {BUMPER}"),
        ("Worst moment", {"worst": None}, "none"),
        ("Gateway", {}, "no outage"),
        (
            "Gateway",
            {"outages": [Outage(WALL_NS + SECOND, WALL_NS + 6 * SECOND, is_commanding=True)]},
            f"silent for 5.0 s from {FIRST} while commanding, then restarted",
        ),
        (
            "Gateway",
            {"outages": [Outage(WALL_NS + SECOND, WALL_NS + SECOND, is_commanding=False)]},
            f"restarted at {FIRST}",
        ),
        (
            "Gateway",
            {"outages": [Outage(WALL_NS + SECOND, None, is_commanding=False)]},
            f"silent from {FIRST} to the end",
        ),
        ("Driven by", {"drivers": []}, "not in the log"),
        ("Driven by", {"drivers": [Driver("a", 1.0, 2.0)]}, "a 1.0 s, 2.0 m"),
        ("Refused", {}, "1 of 1 requests: 1 x drive of operator-2: this lease is not in force"),
        ("Refused", {"refused": 0}, "none of 0 requests"),
        (
            "Refused",
            {"refusals": [Refusal("drive", "", "odd", 1, 0, 0)]},
            "1 of 1 requests: 1 x drive of no operator: odd",
        ),
        ("Lost", {}, "nothing"),
        ("Lost", {"completeness": {}}, "the recorder's account"),
        (
            "Lost",
            {"completeness": LOSSY, "gaps": 1, "gap_s": 3.5},
            "3.5 s of motion in 1 gap; 3 frames between chassis and gateway; 2 samples on the way to the recorder",
        ),
        (
            "Lost",
            {"silences": [Silence(WALL_NS + SECOND, WALL_NS + 2 * SECOND, "3 samples of a are missing")] * 3},
            f"3 samples of a are missing, from {FIRST}; 2 more such gaps",
        ),
        ("Bus and gateway", {}, "no losses, no faults"),
        ("Bus and gateway", {"health": {"lost frames": 5}}, "5 lost frames"),
        ("Versions", {}, "variant coarse, recorder 0.1.0, cruiser-gateway 0.1.0, configuration abababababab"),
        ("Versions", {"in_force": []}, "recorder 0.1.0"),
        ("Versions", {"in_force": [], "facts": {}}, "not in the log"),
    ],
)
def test_a_line(report: Report, line: str, changes: dict[str, Any], said: str) -> None:
    """Each answers its question; what is not in the log is called so."""
    told = changed(report, **changes)
    assert dict(summary_lines(told.robots[0], told))[line] == said


def test_an_unfinished_file_is_named(report: Report) -> None:
    """Of it the recorder gave no account."""
    file = msgspec.structs.replace(report.files[0], is_accounted=False)
    told = msgspec.structs.replace(report, files=[file])
    assert dict(summary_lines(told.robots[0], told))["Lost"] == "the recorder's account of a.mcap"


def test_long_lists_end(report: Report) -> None:
    """Tables tell all; a line stays one."""
    told = changed(report, drivers=[Driver(f"operator-{number}", 1.0, 1.0) for number in range(30)])
    assert dict(summary_lines(told.robots[0], told))["Driven by"].endswith("; and 22 more")


def test_a_moment_says_who_and_how_often(report: Report) -> None:
    """Who held the lease stands in parentheses; a gap counts in its own words."""
    stop = next(one for one in report.robots[0].moments if one.is_stop)
    assert (who(stop), moment_words(stop)) == ("(operator-1)", stop.text)
    often = msgspec.structs.replace(stop, operator="operator-3", count=7, last_ns=stop.time_ns + SECOND)
    assert who(often) == "operator-3"
    assert moment_words(often) == f"{stop.text} [7 times within 1.0 s]"
    assert moment_words(msgspec.structs.replace(often, kind="gap")) == stop.text
    assert who(msgspec.structs.replace(stop, holder="")) == ""


def test_every_reason_has_words() -> None:
    """One that is not known here is told as it is."""
    assert all(reason_words(reason.value) != reason.value for reason in Reason)
    assert reason_words("of a later version") == "of a later version"


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.04, "0.0 s"), (119.94, "119.9 s"), (120, "2 min 0 s"), (3599.7, "1 h 0 min")]
)
def test_durations(seconds: float, words: str) -> None:
    """As a person would say them."""
    assert duration(seconds) == words


def test_sizes_and_lengths() -> None:
    """Units that fit."""
    assert (metres(9.96), metres(12_340)) == ("10.0 m", "12.34 km")
    assert (size(12), size(1500), size(10**10)) == ("12 bytes", "1.5 kB", "10.0 GB")


def test_a_log_with_one_state(tmp_path: Path) -> None:
    """A robot without a drive."""
    report = report_of(write_messages(tmp_path / "a.mcap", drive_messages(3)[:1]))
    assert verdict(report.robots[0]).startswith("1 drive, distance not in the log; no stops")
