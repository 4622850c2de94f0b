"""``cruiser record`` and its disk: a budget, and a full disk."""

import json
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
import pytest

from recorder.disk.keeper import read_entries
from recorder.review.check import check_log
from recorder.review.info import read_info
from schemas.command_line import ExitCode
from schemas.decisions import EventKind, Severity
from schemas.recording import GapReason, RecorderEventKind, RecorderState
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.logs import logs_in
from tests.support.messages import FakeSample, safety_event, sample_of
from tests.support.processes.recorder import Told, ask, at, heard, link, recording, whole
from tests.support.waiting import wait_until


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("CRUISER_RECORDER_INCIDENT_AFTER_S", "0.5")
    monkeypatch.setenv("CRUISER_RECORDER_FLOOR_BYTES", "0")
    return free_endpoint()


def fill_until(peer: Peer, condition: Callable[[], object]) -> None:
    """Publish about a megabyte a second until a condition holds."""

    def is_so() -> bool:
        peer.put(FakeSample("fleet/cruiser-1/large", "zenoh/bytes", os.urandom(20_000)))
        time.sleep(0.01)
        return bool(condition())

    wait_until(is_so, deadline_s=60)


def make_incident(peer: Peer, directory: Path) -> Path:
    event = msgspec.structs.replace(safety_event(EventKind.FAULT, Severity.ERROR), time_ns=time.time_ns())
    peer.put(sample_of(event))
    wait_until(lambda: any(directory.glob("*.incident.mcap")))
    return next(directory.glob("*.incident.mcap"))


def test_a_budget_is_kept_and_the_oldest_logs_go(
    peer: Peer, endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert f"{deleted[0]} was deleted to free disk space" in err
    found = [read_info(path) for path in whole(tmp_path)]
    assert [one.findings for one in map(check_log, whole(tmp_path)) if not one.whole] == []
    assert [(one.path, one.bytes) for one in found if one.bytes >= budget] == []


def number(name: str) -> int:
    return int(name.partition("Z")[2].partition(".")[0].lstrip("-") or 1)


def test_when_nothing_may_go_recording_stops_and_goes_on_when_there_is_room(
    small_disk: Path, peer: Peer, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other data on the disk costs no log; the missing time is a gap."""
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
        assert out.startswith("bench: disk full: recording incidents only\n")
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
    assert "recording stopped: the disk is full" in err
    found = [check_log(path) for path in whole(small_disk)]
    assert len(found) == 2
    assert all(one.whole for one in found)
