"""``cruiser record`` and its disk: budgets, a full disk, one that is read-only or gone for a while."""

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import msgspec
import pytest

from recorder.disk.keeper import read_entries
from recorder.review.check import check_log
from recorder.review.info import read_info
from schemas.command_line import ExitCode
from schemas.decisions import EventKind, Severity
from schemas.messages import Gear
from schemas.recording import GapReason, RecorderEventKind, RecorderState
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.logs import Log, logs_in
from tests.support.messages import SECOND, FakeSample, gear, key_of, safety_event, sample_of
from tests.support.processes.recorder import (
    Told,
    ask,
    at,
    counts,
    heard,
    link,
    readable,
    recording,
    sequences,
    whole,
)
from tests.support.waiting import wait_until

PAGE_BYTES = 4096

TORN = b"\x06\x10\x00"
"""The beginning of a record, as a killed recorder may leave it."""


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> str:
    """Where a test's peer listens; incidents are short, and nothing but a test fills its disk."""
    monkeypatch.setenv("CRUISER_RECORDER_INCIDENT_AFTER_S", "0.5")
    monkeypatch.setenv("CRUISER_RECORDER_FLOOR_BYTES", "0")
    return free_endpoint()


def fill_until(peer: Peer, condition: Callable[[], object]) -> None:
    """Publish a megabyte a second, or what the machine takes, until something is so."""

    def is_so() -> bool:
        peer.put(FakeSample("fleet/cruiser-1/large", "zenoh/bytes", os.urandom(20_000)))
        time.sleep(0.01)
        return bool(condition())

    wait_until(is_so, deadline_s=60)


def make_incident(peer: Peer, directory: Path) -> Path:
    """Have the robot raise an alarm, and wait until its incident is whole."""
    event = msgspec.structs.replace(safety_event(EventKind.FAULT, Severity.ERROR), time_ns=time.time_ns())
    peer.put(sample_of(event))
    wait_until(lambda: any(directory.glob("*.incident.mcap")))
    return next(directory.glob("*.incident.mcap"))


def test_a_budget_is_kept_and_the_oldest_logs_go(
    peer: Peer, endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files are short for it; each deletion is told; an incident stays, and so does what is no log."""
    budget = 2_000_000
    monkeypatch.setenv("CRUISER_RECORDER_BUDGET_BYTES", str(budget))
    monkeypatch.setenv("CRUISER_RECORDER_INCIDENT_BEFORE_S", "1")
    (tmp_path / "notes.txt").write_bytes(bytes(5_000_000))
    told = Told(peer)
    with recording(*at(tmp_path, endpoint)) as process:
        link(peer, tmp_path)
        incident = make_incident(peer, tmp_path)
        oldest = min(entry.name for entry in read_entries(tmp_path) if not entry.is_incident)
        fill_until(peer, lambda: len(told.events(RecorderEventKind.DELETED)) >= 5)
        wait_until(lambda: told.wait_for_health().disk_used_bytes <= budget)
        code, _, err = process.end()
    assert code == ExitCode.OK
    deleted = [event.file for event in told.events(RecorderEventKind.DELETED)]
    assert deleted[0] == oldest.removesuffix(".part")
    assert deleted == sorted(deleted, key=lambda name: (name.partition("Z")[0], number(name)))
    left = logs_in(tmp_path)
    assert {incident.name, "notes.txt"} <= set(left)
    assert not set(deleted) & set(left)
    assert f"{deleted[0]} was deleted for want of room" in err
    found = [read_info(path) for path in whole(tmp_path)]
    assert [one.findings for one in map(check_log, whole(tmp_path)) if not one.whole] == []
    assert [(one.path, one.bytes) for one in found if one.bytes >= budget] == []


def test_made_up_robots_do_not_push_out_what_a_known_robot_said_last(
    peer: Peer, endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of their deleted logs is one more that an attacker filled the budget with."""
    monkeypatch.setenv("CRUISER_RECORDER_BUDGET_BYTES", "1000000")
    monkeypatch.setenv("CRUISER_RECORDER_KNOWN_ROBOTS", "cruiser-1")
    told = Told(peer)
    spoofed = 0

    def has_flooded() -> bool:
        nonlocal spoofed
        spoofed += 1
        key = f"fleet/spoof-{spoofed % 10}/large"
        peer.put(FakeSample(key, "zenoh/bytes", os.urandom(20_000)))
        time.sleep(0.005)
        return len(told.events(RecorderEventKind.DELETED)) >= 20

    with recording(*at(tmp_path, endpoint)) as process:
        link(peer, tmp_path)
        wait_until(lambda: heard(peer, tmp_path, "last"))
        process.signal(signal.SIGHUP)
        wait_until(lambda: bool(whole(tmp_path)))
        (last,) = whole(tmp_path)
        wait_until(has_flooded, deadline_s=60)
        process.end()
    deleted = [event.file for event in told.events(RecorderEventKind.DELETED)]
    assert last.name.startswith("cruiser-1")
    assert last.name not in deleted
    assert counts(read_info(last))["fleet/cruiser-1/last"]


def number(name: str) -> int:
    """Which of the files of one second a log is."""
    return int(name.partition("Z")[2].partition(".")[0].lstrip("-") or 1)


@pytest.mark.night
def test_some_of_the_disk_stays_free(
    small_disk: Path, peer: Peer, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tenth of it at most: the oldest logs go for that, and the disk is never full."""
    monkeypatch.setenv("CRUISER_RECORDER_FLOOR_BYTES", "200000000")
    monkeypatch.setenv("CRUISER_RECORDER_ROTATE_BYTES", "300000")
    (small_disk / "ballast").write_bytes(bytes(12_500_000))
    told = Told(peer)
    with recording(*at(small_disk, endpoint)) as process:
        link(peer, small_disk)

        def has_deleted() -> bool:
            # As fast as it looks at the disk, whatever the machine.
            told.wait_for_health()
            for _ in range(25):
                peer.put(FakeSample("fleet/cruiser-1/large", "zenoh/bytes", os.urandom(20_000)))
            return len(told.events(RecorderEventKind.DELETED)) >= 3

        wait_until(has_deleted, deadline_s=60)
        wait_until(lambda: told.wait_for_health().disk_free_bytes >= 1_600_000)
        assert told.wait_for_health().state is RecorderState.RECORDING
        code, _, err = process.end()
    assert code == ExitCode.OK
    assert "No space left" not in err
    assert not told.events(RecorderEventKind.FULL)
    assert not told.gaps()
    assert all(check_log(path).whole for path in whole(small_disk))


def test_when_nothing_may_go_recording_stops_and_goes_on_when_there_is_room(
    small_disk: Path, peer: Peer, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What others fill a disk with costs none of the logs that there are; what came meanwhile is told as a gap."""
    monkeypatch.setenv("CRUISER_RECORDER_FLOOR_BYTES", "200000000")
    told = Told(peer)
    with recording(*at(small_disk, endpoint), "--json") as process:
        wait_until(partial(heard, peer, small_disk, "first"))
        ballast = small_disk / "ballast"
        ballast.write_bytes(bytes(15_500_000))
        wait_until(lambda: told.wait_for_health().state is RecorderState.FULL)
        (event,) = told.events(RecorderEventKind.FULL)
        assert event.severity is Severity.ERROR
        # It says so at once, and ends its files then.
        wait_until(lambda: all(path.suffix == ".mcap" for path in small_disk.iterdir() if path != ballast))
        before = logs_in(small_disk)

        def is_told() -> bool:
            peer.put(FakeSample("fleet/cruiser-1/meanwhile", "zenoh/bytes", b"x"))
            return any(gap.key == "fleet/cruiser-1/meanwhile" for gap in told.gaps())

        wait_until(is_told)
        assert logs_in(small_disk) == before
        assert told.wait_for_health().dropped["full"] > 0
        code, out, _ = ask("status", "--connect", endpoint)
        assert code == ExitCode.OK
        assert out.startswith("bench: the disk may hold no more: nothing is written but incidents\n")
        ballast.unlink()
        wait_until(lambda: len(told.events(RecorderEventKind.FULL)) == 2)
        wait_until(partial(heard, peer, small_disk, "last"))
        code, out, err = process.end()
    assert code == ExitCode.PARTIAL
    assert told.events(RecorderEventKind.FULL)[1].severity is Severity.INFO
    (reason,) = {gap.reason for gap in told.gaps()}
    assert reason is GapReason.FULL
    lost = json.loads(out)["keys"]["fleet/cruiser-1/meanwhile"]["lost_full"]
    assert lost == sum(gap.count for gap in told.gaps() if gap.key == "fleet/cruiser-1/meanwhile") > 0
    assert "no room for" in err
    found = [check_log(path) for path in whole(small_disk)]
    assert len(found) == 2
    assert all(one.whole for one in found)


def test_without_room_from_the_start_it_says_why_there_is_no_log(
    small_disk: Path, peer: Peer, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Samples came: it is not the robot that was silent."""
    monkeypatch.setenv("CRUISER_RECORDER_FLOOR_BYTES", "200000000")
    (small_disk / "ballast").write_bytes(bytes(15_500_000))
    told = Told(peer)
    with recording(*at(small_disk, endpoint)) as process:
        wait_until(lambda: told.wait_for_health().state is RecorderState.FULL)

        def is_counted() -> bool:
            peer.put(FakeSample("fleet/cruiser-1/some", "zenoh/bytes", b"x"))
            return told.wait_for_health().dropped.get("full", 0) > 0

        wait_until(is_counted)
        code, out, err = process.end()
    assert (code, out) == (ExitCode.FAILURE, "")
    assert "the disk took no log" in err.splitlines()[-1]
    assert logs_in(small_disk) == ["ballast"]


def test_what_a_crash_left_is_made_whole_when_there_is_room(
    small_disk: Path, peer: Peer, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recorder began on a disk without room for the ends of the logs, and nothing came that it could write."""
    monkeypatch.setenv("CRUISER_RECORDER_FLOOR_BYTES", "200000000")
    log = Log()
    for number in range(100):
        log.receive(sample_of(gear(number)))
        log.tick(number * SECOND)
    good = log.disk.getvalue()
    # What is free in a file's last page takes the end of a small log, however full the disk is.
    assert len(log.close()) - len(good) > 2 * PAGE_BYTES
    first, second = (small_disk / f"cruiser-{number}-20270115T080000Z.mcap.part" for number in (1, 2))
    for path in (first, second):
        path.write_bytes(good + TORN)
    ballast = small_disk / "ballast"
    with suppress(OSError), ballast.open("wb", buffering=0) as stream:
        while stream.write(bytes(PAGE_BYTES)):
            pass
    told = Told(peer)
    with recording(*at(small_disk, endpoint)) as process:
        wait_until(lambda: told.wait_for_health().state is RecorderState.FULL)
        # One after the other: when this one is cut, the first has failed.
        wait_until(lambda: second.stat().st_size == len(good))
        assert first.read_bytes() == good
        ballast.unlink()
        wait_until(lambda: len(told.events(RecorderEventKind.RECOVERED)) == 2)
        _, _, err = process.end()
    assert f"cannot recover {first}: No space left on device" in err
    assert logs_in(small_disk) == [first.stem, second.stem]
    assert all(check_log(path).whole for path in whole(small_disk))


def test_a_directory_that_is_removed_is_made_again(peer: Peer, endpoint: str, tmp_path: Path) -> None:
    """The log goes on there in another file; it is told, and so is how much is gone."""
    logs = tmp_path / "logs"
    told = Told(peer)
    with recording(*at(logs, endpoint)) as process:
        wait_until(partial(heard, peer, logs, "first"))
        shutil.rmtree(logs)
        wait_until(partial(heard, peer, logs, "last"))
        wait_until(lambda: any(event.file for event in told.events(RecorderEventKind.DISK)))
        code, _, err = process.end()
    assert code == ExitCode.PARTIAL
    assert "Traceback" not in err
    assert all(check_log(path).whole for path in logs.iterdir())
    events = told.events(RecorderEventKind.DISK)
    assert events[0].severity is Severity.ERROR
    gone = next(int(event.text.split()[-6]) for event in events if event.file)
    assert gone > 0
    assert f"the disk did not take or keep {gone} messages" in err
    messages = sum(sum(counts(read_info(path)).values()) for path in whole(logs))
    assert f"record: {messages} messages on" in err


def test_of_a_directory_that_is_moved_the_logs_become_whole_where_they_are(
    peer: Peer, endpoint: str, tmp_path: Path
) -> None:
    """It is told, and what comes then is in the old place; both are whole."""
    logs, elsewhere = tmp_path / "logs", tmp_path / "elsewhere"
    told = Told(peer)
    with recording(*at(logs, endpoint)) as process:
        wait_until(partial(heard, peer, logs, "first"))
        logs.rename(elsewhere)
        wait_until(lambda: bool(told.events(RecorderEventKind.DISK)))
        wait_until(partial(heard, peer, logs, "last"))
        code, out, err = process.end()
    assert code == ExitCode.OK
    assert "somebody has moved or removed" in err
    assert out == f"{whole(logs)[0]}\n"
    files = [*logs.iterdir(), *elsewhere.iterdir()]
    assert {path.suffix for path in files} == {".mcap"}
    assert all(read_info(path).whole for path in files)


def remount(disk: Path, mode: str) -> None:
    """Make a disk read-only, or no more; no file on it may be open for that."""
    subprocess.run(["mount", "-o", f"remount,{mode}", str(disk)], check=True)  # noqa: S607 - wherever it is


def test_a_disk_that_is_read_only_for_a_while_costs_nothing(small_disk: Path, peer: Peer, endpoint: str) -> None:
    """What comes meanwhile waits, is told to wait, and is in the next file."""
    told = Told(peer)
    sent = 0

    def drive() -> None:
        nonlocal sent
        peer.put(sample_of(gear(sent)))
        sent += 1
        time.sleep(0.02)

    def drive_until(condition: Callable[[], object]) -> None:
        def is_so() -> bool:
            drive()
            return bool(condition())

        wait_until(is_so)

    with recording(*at(small_disk, endpoint)) as process:
        drive_until(lambda: bool(told.healths()) and has_gear(small_disk))
        # A sample that came after the hangup would begin another file.
        peer.put(FakeSample("fleet/cruiser-1/last", "zenoh/bytes", b""))
        wait_until(lambda: any(counts(one).get("fleet/cruiser-1/last") for one in readable(small_disk)))
        process.signal(signal.SIGHUP)
        wait_until(lambda: whole(small_disk))
        first = whole(small_disk)
        remount(small_disk, "ro")
        try:
            drive_until(lambda: told.events(RecorderEventKind.DISK))
            assert process.is_running
            assert told.wait_for_health().dropped == {}
        finally:
            remount(small_disk, "rw")
        drive_until(lambda: len(told.events(RecorderEventKind.DISK)) == 2)
        code, _, err = process.end()
    assert code == ExitCode.OK
    assert "Read-only file system; trying on" in err
    assert "Traceback" not in err
    fault, back = told.events(RecorderEventKind.DISK)
    assert (fault.severity, back.severity) == (Severity.ERROR, Severity.INFO)
    assert len(first) == 1
    assert len(whole(small_disk)) == len(logs_in(small_disk)) == 2
    recorded = [number for path in whole(small_disk) for number in sequences(path, key_of(Gear))]
    assert recorded == list(range(recorded[0], sent))


def has_gear(directory: Path) -> bool:
    with suppress(FileNotFoundError):
        return any(counts(read_info(path)).get(key_of(Gear)) for path in directory.iterdir())
    return False
