"""Reads logs, and finds what a report says of them."""

from pathlib import Path

import pytest

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Selection
from recorder.record.robot_log import LogPlan
from recorder.review.drives import MARGIN_NS, Outage
from recorder.review.report import account, gather
from recorder.review.report.gather import read_margins, read_report
from schemas.decisions import ArbiterState, Severity
from schemas.recording import GapReason, RecorderEvent, RecorderEventKind, RecordGap
from tests.support.drives import drive_messages, drives_over, restart, undecodable, write_messages
from tests.support.logs import Log
from tests.support.messages import (
    PERIOD_NS,
    SECOND,
    WALL_NS,
    arbiter,
    event,
    gateway_info,
    info,
    refusal,
    sample_of,
    state,
)
from tests.support.reading import report_of


def test_several_robots_have_a_report_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of their names. Names can be made up without end: beyond a limit they are counted."""
    path = write_messages(tmp_path / "a.mcap", drive_messages(20), robots=["r-2", "r-1", "r-3", "r-4"])
    monkeypatch.setattr(gather, "ROBOTS_MAX", 2)
    report = report_of(path)
    assert ([robot.summary.name for robot in report.robots], report.more_robots) == (["r-1", "r-2"], 2)
    assert all("fleet/r-1/" in topic for topic in report.robots[0].summary.completeness)


def test_robots_of_one_name_under_two_roots_are_told_apart(tmp_path: Path) -> None:
    """Both are called by their roots too."""
    paths = [write_messages(tmp_path / root, drive_messages(5), root=root) for root in ("fleet", "depot")]
    assert [robot.summary.name for robot in report_of(*paths).robots] == ["depot/cruiser-1", "fleet/cruiser-1"]


def test_a_name_in_two_logs_is_two_robots(tmp_path: Path) -> None:
    """Each recorder knows but one of the name; neither's gateway, nor what is said of it, is the other's."""
    paths = []
    for root in ("fleet", "depot"):
        log = Log()
        log.receive(sample_of(gateway_info(0, f"[robot]\nroot = '{root}'\n"), root=root))
        for message in drive_messages(20):
            log.receive(sample_of(message, root=root), wall_ns=message.time_ns)
        said = RecorderEvent(
            WALL_NS + 9, 0, Severity.WARNING, RecorderEventKind.FULL, "cruiser-1", "", "", f"of {root}"
        )
        log.add_own(f"{root}/@recorder/vm/event", said, 0)
        paths.append(tmp_path / f"{root}.mcap")
        paths[-1].write_bytes(log.close())
    for one, root in zip(report_of(*paths).robots, ("depot", "fleet"), strict=True):
        hash_of_its_own = gateway_info(0, f"[robot]\nroot = '{root}'\n").configuration_sha256
        assert one.summary.name == f"{root}/cruiser-1"
        assert [known.configuration_sha256 for known in one.summary.in_force] == [hash_of_its_own]
        assert one.summary.facts["configuration_sha256"] == hash_of_its_own
        assert [moment.text for moment in one.moments if moment.kind == "recorder"] == [f"of {root}"]


def died(path: Path) -> Path:
    """A log in which a gateway dies at 9.95 s, and another one with another configuration begins at 13 s."""
    log = Log()
    told = {0: gateway_info(0, "[command]\nspeed_limit_mps = 2.222\n")}
    told[260] = gateway_info(260, "[command]\nspeed_limit_mps = 0.6\n")
    for message in restart(200, 60):
        number = (message.time_ns - WALL_NS) // PERIOD_NS
        if number in told:
            log.receive(sample_of(told.pop(number)), wall_ns=message.time_ns)
        log.receive(sample_of(message), wall_ns=message.time_ns)
    path.write_bytes(log.close())
    return path


def test_a_gateway_that_died_and_another_that_began_are_told(tmp_path: Path) -> None:
    """In the summary, among the events, and with both configurations."""
    (robot,) = report_of(died(tmp_path / "a.mcap")).robots
    heard_ns, began_ns = WALL_NS + 199 * PERIOD_NS, WALL_NS + 260 * PERIOD_NS
    assert robot.summary.outages == [Outage(heard_ns, began_ns, is_commanding=True)]
    told = [(one.kind, one.severity, one.time_ns) for one in robot.moments if one.severity == "error"]
    assert told == [("gap", "error", heard_ns), ("gateway", "error", began_ns)]
    assert [one.since_ns for one in robot.summary.in_force] == [WALL_NS, began_ns]
    assert robot.summary.in_force[1].settings == ["command.speed_limit_mps 0.6, 2.222 before"]
    assert robot.summary.silences == []
    assert robot.drawn[0].outages == [(heard_ns, began_ns)]


@pytest.mark.parametrize(
    ("from_number", "to_number", "is_again", "in_force"),
    [(220, 280, True, 2), (100, 250, False, 1), (262, 280, None, 1), (100, 190, None, 1)],
)
def test_a_period_knows_of_a_gateway_that_died_in_it(
    tmp_path: Path,
    from_number: int,
    to_number: int,
    is_again: bool | None,  # noqa: FBT001 - a case
    in_force: int,
) -> None:
    """That begins while nothing is heard, or ends so; before and after there is nothing to tell."""
    faults = Faults()
    logs = find_logs([died(tmp_path / "a.mcap")], faults)
    period = WALL_NS + from_number * PERIOD_NS, WALL_NS + to_number * PERIOD_NS
    (robot,) = read_report(logs, Selection(from_ns=period[0], to_ns=period[1]), faults).robots
    assert [one.began_ns is not None for one in robot.summary.outages] == ([] if is_again is None else [is_again])
    assert len(robot.summary.in_force) == in_force
    assert not robot.summary.ends_commanding
    assert robot.summary.start_ns >= period[0]


def test_an_incident_beside_its_log_tells_nothing_twice(tmp_path: Path) -> None:
    """Neither of the robot's nor of the recorder's."""
    data = died(tmp_path / "a.mcap").read_bytes()
    once = report_of(tmp_path / "a.mcap").robots[0]
    (tmp_path / "b.mcap").write_bytes(data)
    twice = report_of(tmp_path / "a.mcap", tmp_path / "b.mcap").robots[0]
    assert twice.moments == once.moments
    assert twice.summary.outages == once.summary.outages
    assert twice.summary.in_force == once.summary.in_force


def test_what_comes_again_much_later_is_told_once(tmp_path: Path) -> None:
    """As where a recorder asked for all events of a drive that another one has, too."""
    events = [event(number) for number in range(600)]
    first = write_messages(tmp_path / "a.mcap", [state(0), *events])
    log = Log()
    for message in events:
        log.receive(sample_of(message), wall_ns=message.time_ns + 60 * SECOND)
    (tmp_path / "b.mcap").write_bytes(log.close())
    (robot,) = report_of(first, tmp_path / "b.mcap").robots
    assert robot.summary.stops == {"front_bumper": 1}
    assert robot.summary.events["stop"] == 600


def test_what_was_before_the_beginning_of_the_log_is_not_in_the_report(tmp_path: Path) -> None:
    """A recorder asks a gateway for what it did not hear, and gets the stops and requests of an hour ago too."""
    log = Log()
    for number in range(100):
        log.receive(sample_of(state(number)), wall_ns=WALL_NS + number * PERIOD_NS)
    before = [one(-72_000, sequence=49, tick=1) for one in (event, refusal)]
    for message in (*before, event(50), refusal(50)):
        log.receive(sample_of(message), wall_ns=WALL_NS + 100 * PERIOD_NS)
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    (robot,) = report_of(path).robots
    assert robot.summary.start_ns == WALL_NS
    assert (robot.summary.stops, robot.summary.refused) == ({"front_bumper": 1}, 1)
    assert [moment.time_ns for moment in robot.moments] == [WALL_NS + 50 * PERIOD_NS]


def test_files_that_follow_each_other_are_one_drive(tmp_path: Path) -> None:
    """The path goes on, and the accounts add up."""
    messages = drive_messages(200)
    half = len(messages) // 2
    paths = [
        write_messages(tmp_path / "a.mcap", messages[:half]),
        write_messages(tmp_path / "b.mcap", messages[half:]),
    ]
    (robot,) = report_of(*paths).robots
    assert robot.summary.distance_m == pytest.approx(199 * 0.05)
    assert robot.summary.gaps == 0
    assert robot.summary.completeness["fleet/cruiser-1/state"].written == 200


def test_a_log_that_was_not_finished_has_no_account(tmp_path: Path) -> None:
    """What is in it is told all the same, and that it is cut off is a fault."""
    whole = write_messages(tmp_path / "a.mcap", drive_messages(2000)).read_bytes()
    path = tmp_path / "b.mcap.part"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    faults = Faults()
    report = report_of(path, faults=faults)
    assert report.robots[0].summary.distance_m > 1
    assert not report.files[0].is_accounted
    assert report.robots[0].summary.facts["variant"] == "coarse"
    assert faults


def test_metadata_tell_of_each_gateway_not_only_of_the_last(tmp_path: Path) -> None:
    """Of two robots of one name, too: their recorder calls only the second one by its root."""
    log = Log()
    log.receive(sample_of(gateway_info(0), root="fleet"))
    for root in ("fleet", "depot"):
        log.receive(sample_of(gateway_info(50, f"root = '{root}'\n"), root=root))
        log.receive(sample_of(state(0), root=root), wall_ns=WALL_NS)
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    for robot, root in zip(report_of(path).robots, ("depot", "fleet"), strict=True):
        own = gateway_info(50, f"root = '{root}'\n").configuration_sha256
        hashes = [one.configuration_sha256 for one in robot.summary.in_force]
        assert hashes == [*([gateway_info(0).configuration_sha256] if root == "fleet" else []), own]
        assert robot.summary.facts["configuration_sha256"] == own
        assert robot.summary.facts["recorder_version"] == "0.1.0"


def test_a_file_that_is_gone_says_nothing_and_names_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who reads the rows tells of it; names can be made up."""
    monkeypatch.setattr(gather, "NAMES_MAX", 2)
    path = write_messages(tmp_path / "a.mcap", drive_messages(1), robots=["r-1", "r-2", "r-3"])
    (log,) = find_logs([path], Faults())
    assert len(read_margins(log).facts) == 2
    log.path.unlink()
    assert (read_margins(log).facts, read_margins(log).completeness) == ({}, {})


@pytest.mark.parametrize(
    ("from_s", "to_s", "gap_s"),
    [(0, 8, 3.9 + 0.05), (6, 14, 6.4), (0, 20, 8.3), (0, 4, 0.05), (None, None, 8.3)],
)
def test_a_pause_of_the_recorder_is_missing_in_any_period(
    tmp_path: Path, from_s: float | None, to_s: float | None, gap_s: float
) -> None:
    """Also in one that ends or begins within it: the distance is at least what is told."""
    paths = []
    for first, last in ((0, 82), (248, 400)):
        log = Log()
        for number in range(first, last):
            for message in (state(number), arbiter(number)):
                log.receive(sample_of(message), wall_ns=message.time_ns)
        paths.append(tmp_path / f"{first}.mcap")
        paths[-1].write_bytes(log.close())
    faults = Faults()
    period = Selection()
    if from_s is not None and to_s is not None:
        period = Selection(from_ns=WALL_NS + round(from_s * SECOND), to_ns=WALL_NS + round(to_s * SECOND))
    (robot,) = read_report(find_logs(paths, faults), period, faults).robots
    assert robot.summary.gap_s == pytest.approx(gap_s if gap_s > 0.5 else 0.0, abs=0.15)
    assert robot.summary.outages == []


def test_each_drive_of_many_days_is_for_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its path, its stop and its time are its own; the newest are drawn."""
    monkeypatch.setattr(account, "DRAWN_MAX", 5)
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", drives_over(25, 12))).robots
    assert len(robot.drives) == 12
    assert [one.drive for one in robot.drawn] == robot.drives[-5:]
    for drawn in robot.drawn:
        drive = drawn.drive
        assert drive is not None
        assert (drive.stops, drive.missing_s, drive.worst) == (1, 0.0, "stopping: the front bumper was hit")
        assert drive.distance_m == pytest.approx(2.95)
        assert (drawn.places[0].time_ns, drawn.places[0].x_m) == (drive.start_ns, 0.0)
        assert drawn.start_ns == drive.start_ns - MARGIN_NS
        assert drawn.end_ns == min(drive.end_ns + MARGIN_NS, robot.summary.end_ns)
        assert [one.time_ns for one in drawn.moments if one.is_stop] == [drive.end_ns]
        times_ns = [point[0] for point in drawn.lines["speed_mps"] if point is not None]
        assert (times_ns[0], times_ns[-1]) == (drive.start_ns, drive.end_ns)
    assert robot.summary.distance_m == pytest.approx(12 * 2.95)
    assert robot.summary.stops == {"front_bumper": 12}


def test_a_drive_between_long_rests_is_drawn_without_them(tmp_path: Path) -> None:
    """One axis over all of it would hide it; what led to it is drawn."""
    messages = [
        message
        for number in [*range(0, 20_000, 100), *range(20_000, 20_060), *range(20_260, 40_000, 100)]
        for is_moving in [20_000 <= number < 20_060]
        for message in (
            state(number, speed_mps=float(is_moving)),
            arbiter(number, state=ArbiterState.ENGAGED if is_moving else ArbiterState.STANDBY),
        )
    ]
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", messages)).robots
    start_ns, end_ns = WALL_NS + 20_000 * PERIOD_NS, WALL_NS + 20_059 * PERIOD_NS
    (drawn,) = robot.drawn
    assert (drawn.start_ns, drawn.end_ns) == (start_ns - MARGIN_NS, end_ns + MARGIN_NS)
    times_ns = [point[0] for point in drawn.lines["speed_mps"] if point is not None]
    assert drawn.start_ns <= times_ns[0] < start_ns
    assert end_ns <= times_ns[-1] <= drawn.end_ns


def test_a_robot_without_a_drive_is_drawn_as_it_stood(tmp_path: Path) -> None:
    """Why it did not move is a question too."""
    standing = [
        message
        for number in range(50)
        for message in (state(number, speed_mps=0.0), arbiter(number, state=ArbiterState.STANDBY))
    ]
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", standing)).robots
    (drawn,) = robot.drawn
    assert (drawn.drive, robot.drives) == (None, [])
    assert len(drawn.lines["speed_limit_mps"]) == 50


def test_what_the_recorder_could_not_keep_is_told(tmp_path: Path) -> None:
    """By topic and reason."""
    log = Log(LogPlan(name="a", chunk_bytes=262_144, flush_ns=SECOND // 2, version="0.1.0"))
    log.receive(sample_of(info()), *(sample_of(message) for message in drive_messages(3)))
    for reason in (GapReason.DISK, GapReason.QUEUE, GapReason.DISK):
        gap = RecordGap(WALL_NS, 0, "fleet/cruiser-1/state", reason, WALL_NS, WALL_NS, 5)
        log.add_own("fleet/@recorder/vm/gap", gap, 0)
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    (robot,) = report_of(path).robots
    assert [(one.reason, one.count) for one in robot.summary.unwritten] == [("disk", 10), ("queue", 5)]


def test_what_cannot_be_read_is_a_fault_or_nobodys(tmp_path: Path) -> None:
    """A sample that is no message of ours is no state of the robot's."""
    log = Log()
    log.receive(undecodable())
    for message in drive_messages(3):
        log.receive(sample_of(message), wall_ns=message.time_ns)
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    assert report_of(path).robots[0].summary.known_s == pytest.approx(0.1)
