"""Reads logs, and finds what a report says of them."""

import random
from pathlib import Path

import pytest

from recorder.review.faults import Faults
from recorder.review.logs import find_logs
from recorder.review.report import survey
from recorder.review.report.survey import read_report
from recorder.session import Plan, Session
from schemas.exit_codes import CommandError
from schemas.recording import GapReason, RecordGap
from tests.recorder.fakes import SECOND, WALL_NS, Log, info, sample_of
from tests.recorder.review.report.drive import PERIOD_NS, drive, report_of, undecodable, write_log

SEEDS = 60


def test_a_log_of_a_drive(tmp_path: Path) -> None:
    """Its figures, its facts and the recorder's account of it."""
    report = report_of(write_log(tmp_path / "a.mcap", drive(201)))
    (robot,) = report.robots
    assert robot.summary.distance_m == pytest.approx(10.0)
    assert robot.summary.facts["variant"] == "coarse"
    assert robot.summary.facts["versions.cruiser-gateway"] == "0.1.0"
    assert robot.summary.completeness["fleet/cruiser-1/state"].written == 201
    assert report.files[0].is_accounted
    assert not report.fault_count


def test_several_robots_have_a_report_each(tmp_path: Path) -> None:
    """In the order of their names; no more than there is room for, and the others are counted."""
    report = report_of(write_log(tmp_path / "a.mcap", drive(20), robots=["r-2", "r-1"]))
    assert [robot.summary.name for robot in report.robots] == ["r-1", "r-2"]
    assert all("fleet/r-1/" in topic for topic in report.robots[0].summary.completeness)


def test_robots_beyond_the_limit_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names can be made up without end."""
    monkeypatch.setattr(survey, "ROBOTS_MAX", 2)
    report = report_of(write_log(tmp_path / "a.mcap", drive(3), robots=["r-1", "r-2", "r-3", "r-4"]))
    assert ([robot.summary.name for robot in report.robots], report.more_robots) == (["r-1", "r-2"], 2)


def test_robots_of_one_name_under_two_roots_are_told_apart(tmp_path: Path) -> None:
    """The second is called by its root too."""
    log = Log()
    for root in ("fleet", "depot"):
        for message in drive(5):
            log.receive(sample_of(message, root=root), wall_ns=message.time_ns)
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    assert [robot.summary.name for robot in report_of(path).robots] == ["cruiser-1", "depot/cruiser-1"]


def test_files_that_follow_each_other_are_one_drive(tmp_path: Path) -> None:
    """The path goes on, and the accounts add up."""
    messages = drive(200)
    half = len(messages) // 2
    paths = [write_log(tmp_path / "a.mcap", messages[:half]), write_log(tmp_path / "b.mcap", messages[half:])]
    (robot,) = report_of(*paths).robots
    assert robot.summary.distance_m == pytest.approx(199 * 0.05)
    assert robot.summary.gaps == 0
    assert robot.summary.completeness["fleet/cruiser-1/state"].written == 200


def test_the_period_that_is_asked_about(tmp_path: Path) -> None:
    """What is outside of it is not in the report."""
    faults = Faults()
    logs = find_logs([write_log(tmp_path / "a.mcap", drive(200))], faults)
    report = read_report(logs, WALL_NS + 2 * SECOND, WALL_NS + 4 * SECOND, faults)
    (robot,) = report.robots
    assert (robot.summary.start_ns, robot.summary.end_ns) == (
        WALL_NS + 2 * SECOND,
        WALL_NS + 4 * SECOND - PERIOD_NS,
    )


def test_a_log_that_was_not_finished_has_no_account(tmp_path: Path) -> None:
    """What is in it is told all the same, and that it is cut off is a fault."""
    whole = write_log(tmp_path / "a.mcap", drive(2000)).read_bytes()
    path = tmp_path / "b.mcap.part"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    faults = Faults()
    report = report_of(path, faults=faults)
    assert report.robots[0].summary.distance_m > 1
    assert not report.files[0].is_accounted
    assert report.robots[0].summary.facts["variant"] == "coarse"
    assert faults


def test_what_the_recorder_could_not_keep_is_told(tmp_path: Path) -> None:
    """By topic and reason."""
    log = Log(Session(Plan(name="a", chunk_bytes=262_144, flush_ns=SECOND // 2, version="0.1.0")))
    log.receive(sample_of(info()), *(sample_of(message) for message in drive(3)))
    for reason in (GapReason.DISK, GapReason.QUEUE, GapReason.DISK):
        gap = RecordGap(WALL_NS, 0, "fleet/cruiser-1/state", reason, WALL_NS, WALL_NS, 5)
        log.carry_out(log.session.add_own("fleet/@recorder/vm/gap", gap, 0))
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    (robot,) = report_of(path).robots
    assert [(one.reason, one.count) for one in robot.summary.unwritten] == [("disk", 10), ("queue", 5)]


def test_what_cannot_be_read_is_a_fault_or_nobodys(tmp_path: Path) -> None:
    """A sample that is no message of ours is no state of the robot's."""
    log = Log()
    log.receive(undecodable())
    for message in drive(3):
        log.receive(sample_of(message), wall_ns=message.time_ns)
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    assert report_of(path).robots[0].summary.known_s == pytest.approx(0.1)


def test_damage_anywhere_never_ends_in_an_exception(tmp_path: Path) -> None:
    """Bytes turned, cut off or doubled: a report or a clear line."""
    whole = write_log(tmp_path / "a.mcap", drive(100)).read_bytes()
    path = tmp_path / "b.mcap"
    read = 0
    for seed in range(SEEDS):
        chance = random.Random(seed)  # noqa: S311 - damage, not secrets
        data = bytearray(whole)
        for _ in range(chance.choice((1, 3, 50))):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(data[: chance.choice((len(data), chance.randrange(len(data))))])
        try:
            read += len(report_of(path).robots)
        except CommandError:
            continue
    assert read > SEEDS // 4
