"""The drives of a robot: found by rests, counted, and those that are drawn read once more."""

from pathlib import Path

import msgspec
import pytest

from recorder.review.entries import Entry, EntryKind, EntrySource
from recorder.review.report import drives, survey
from recorder.review.report.drives import MARGIN_NS, REST_NS, Drives
from recorder.review.report.findings import Report
from schemas.decisions import ArbiterState, Severity
from schemas.messages import Message
from tests.support.drives import drive_messages, drives_over, write_messages
from tests.support.messages import PERIOD_NS, SECOND, WALL_NS, arbiter, state
from tests.support.reading import report_of

DAY_NS = 24 * 3600 * SECOND


def entry(time_ns: int, severity: Severity, text: str = "") -> Entry:
    """A stop of that time."""
    return Entry(
        time_ns=time_ns,
        last_ns=time_ns,
        robot="r",
        kind=EntryKind.STOP,
        severity=severity,
        source=EntrySource.EVENT,
        text=text,
        is_stop=True,
    )


def spans(gathered: Drives) -> list[tuple[int, int]]:
    """Beginning and end of each."""
    return [(one.start_ns, one.end_ns) for one in gathered.drives()]


@pytest.mark.parametrize(("rest_ns", "count"), [(REST_NS, 1), (REST_NS + 1, 2)])
def test_a_long_rest_ends_a_drive(rest_ns: int, count: int) -> None:
    """A shorter one is a part of it."""
    found = Drives()
    for time_ns in (10**15, 10**15 + 5, 10**15 + 5 + rest_ns):
        found.add(time_ns, time_ns, 0.5)
    assert len(found.drives()) == count
    assert sum(one.distance_m for one in found.drives()) == 1.5
    assert found.drives()[-1].end_ns == 10**15 + 5 + rest_ns


def test_a_clock_that_was_set_back_begins_another_drive() -> None:
    """They are in the order of the robot's time; the log times are the recorder's."""
    found = Drives()
    found.add(10**18, 10**18)
    found.add(10**18 - DAY_NS, 10**18 + SECOND)
    assert spans(found) == [(10**18 - DAY_NS, 10**18 - DAY_NS), (10**18, 10**18)]
    assert found.drives()[0].log_start_ns == 10**18 + SECOND


@pytest.mark.parametrize(
    ("off_ns", "is_in"), [(-MARGIN_NS, True), (-MARGIN_NS - 1, False), (MARGIN_NS + 1, False)]
)
def test_what_happens_near_a_drive_belongs_to_it(off_ns: int, is_in: bool) -> None:  # noqa: FBT001 - a case
    """Up to its margins."""
    found = Drives()
    found.add(10**18, 10**18)
    found.take_entry(entry(10**18 + off_ns, Severity.ERROR, "bad"))
    (drive,) = found.drives()
    assert (drive.stops, drive.worst, drive.severity) == ((1, "bad", "error") if is_in else (0, "", "info"))


def test_the_worst_finding_is_the_first_of_the_gravest() -> None:
    """News that are no more than news are none."""
    found = Drives()
    found.add(10**18, 10**18)
    for severity, text in (("info", "a"), ("warning", "b"), ("error", "c"), ("error", "d"), ("warning", "e")):
        found.take_entry(entry(10**18, Severity(severity), text))
    assert found.drives()[0].worst == "c"


def test_drives_beyond_the_limit_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory does not grow with the log."""
    monkeypatch.setattr(drives, "DRIVES_MAX", 2)
    found = Drives()
    for number in range(5):
        found.add(10**18 + number * DAY_NS, 10**18)
        found.take_entry(entry(10**18 + number * DAY_NS, Severity.ERROR))
    assert (len(found.drives()), found.more) == (2, 3)
    assert [one.stops for one in found.drives()] == [1, 1]


@pytest.fixture(scope="module")
def month(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Of 12 drives in 25 days."""
    return report_of(write_messages(tmp_path_factory.mktemp("log") / "a.mcap", drives_over(25, 12)))


def test_each_drive_of_many_days_is_for_itself(month: Report) -> None:
    """Its path, its stop and its time are its own; the robot's figures are those of all."""
    (robot,) = month.robots
    assert robot.is_apart
    assert len(robot.drives) == len(month.drawn) == 12
    for drive, report in zip(robot.drives, month.drawn, strict=True):
        assert report.summary.start_ns == drive.start_ns
        assert report.summary.end_ns == drive.end_ns
        assert report.summary.distance_m == pytest.approx(2.95)
        assert drive.distance_m == pytest.approx(2.95, abs=0.1)
        assert [one.time_ns for one in report.charts.moments if one.is_stop] == [drive.end_ns]
        assert report.charts.places[0].time_ns == drive.start_ns
        assert drive.stops == 1
        assert "the front bumper was hit" in drive.worst
    assert robot.summary.distance_m == pytest.approx(12 * 2.95)


def test_one_drive_in_a_short_log_is_not_apart(tmp_path: Path) -> None:
    """The report is that of the robot."""
    report = report_of(write_messages(tmp_path / "a.mcap", drive_messages(60)))
    assert not report.robots[0].is_apart
    assert report.drawn == report.robots
    assert len(report.robots[0].drives) == 1


def resting(first: int, count: int) -> list[Message]:
    """A robot that stands by, once in ten seconds."""
    return [
        message
        for number in range(first, first + 200 * count, 200)
        for message in (state(number, speed_mps=0.0), arbiter(number, state=ArbiterState.STANDBY))
    ]


def test_a_drive_between_days_of_rest_is_apart(tmp_path: Path) -> None:
    """One axis over all of it would hide it."""
    log = write_messages(tmp_path / "a.mcap", [*drive_messages(60), *resting(260, 100)])
    (robot,) = report_of(log).robots
    assert robot.is_apart
    (drive,) = robot.drives
    assert drive.end_ns == WALL_NS + 59 * PERIOD_NS
    assert drive.report is not None
    assert drive.report.summary.end_ns <= drive.end_ns + MARGIN_NS


def test_a_robot_that_only_rested_has_no_drive(tmp_path: Path) -> None:
    """It is drawn whole."""
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", resting(0, 100))).robots
    assert not robot.drives
    assert not robot.is_apart


def test_the_worst_drives_are_drawn_and_the_others_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of alike ones the last."""
    monkeypatch.setattr(survey, "DRAWN_MAX", 3)
    messages = drives_over(5, 5)
    stops = [number for number, one in enumerate(messages) if type(one).__name__ == "SafetyEvent"]
    quiet = [one for number, one in enumerate(messages) if number not in {stops[0], stops[3], stops[4]}]
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", quiet)).robots
    worse = {number for number, drive in enumerate(robot.drives) if drive.stops}
    drawn = {number for number, drive in enumerate(robot.drives) if drive.report is not None}
    assert worse == {1, 2}
    assert drawn == {1, 2, 4}


def test_many_drives_share_the_points_of_the_charts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the page does not grow with them."""
    monkeypatch.setattr(survey, "WHOLE_SHARES", 0.04)
    log = write_messages(tmp_path / "a.mcap", drives_over(2, 2, periods=400))
    lines = [msgspec.structs.asdict(one.charts)["lines"]["speed_limit_mps"] for one in report_of(log).drawn]
    assert all(10 < len(line) <= 4 * 30 for line in lines)
