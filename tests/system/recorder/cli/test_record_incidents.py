"""``cruiser record``: a robot's alarm keeps what came before and after in a file of its own."""

import json
import signal
import time
from functools import partial
from pathlib import Path

import msgspec
import pytest

from recorder.disk.keeper import read_entries
from recorder.record.incidents import INCIDENT_NAME
from recorder.review.check import check_log
from recorder.review.info import read_info
from schemas import keys
from schemas.command_line import ExitCode
from schemas.decisions import ArbiterState, EventKind, SafetyEvent, SafetyState, Severity
from schemas.messages import Gear
from schemas.reasons import Reason
from schemas.recording import RecorderEventKind
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.logs import logs_in
from tests.support.messages import STANDBY, gear, key_of, sample_of
from tests.support.processes.recorder import (
    Process,
    Told,
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

HOSTILE = "a wheel \x1b[2J\x07\nis off"


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> str:
    """Where a test's peer listens; incidents are short."""
    monkeypatch.setenv("CRUISER_RECORDER_INCIDENT_AFTER_S", "1.5")
    return free_endpoint()


def alarm(text: str = "a wheel is off", severity: Severity = Severity.ERROR) -> SafetyEvent:
    return SafetyEvent(
        time_ns=time.time_ns(),
        sequence=0,
        tick=1,
        severity=severity,
        kind=EventKind.FAULT,
        reason=Reason.NONE,
        operator="",
        text=text,
    )


class Robot:
    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self.sent = 0

    def drive(self) -> None:
        for _ in range(5):
            self._peer.put(sample_of(gear(self.sent, time.time_ns())))
            self.sent += 1
        time.sleep(0.02)

    def drive_until(self, files: str, directory: Path) -> Path:
        def is_there() -> bool:
            self.drive()
            return any(directory.glob(files))

        wait_until(is_there)
        return next(directory.glob(files))


def started(told: Told, robot: Robot) -> int:
    """Wait until the recorder has heard the robot for a while; how much of it was sent before that while."""

    def is_heard() -> bool:
        robot.drive()
        return bool(told.healths()) and told.healths()[-1].ring_bytes > 0

    wait_until(is_heard)
    early, count = robot.sent, len(told.healths())

    def is_later() -> bool:
        robot.drive()
        return len(told.healths()) >= count + 2

    wait_until(is_later)
    return early


def check(incident: Path, robot_sent: int, early: int, before: int) -> list[int]:
    """An incident holds some of what came before and after, the alarm and why it was made."""
    found = read_info(incident)
    assert check_log(incident).whole
    assert found.metadata[INCIDENT_NAME]["because"] == "fault: a wheel is off"
    assert counts(found)[key_of(SafetyEvent)] == 1
    held = sequences(incident, key_of(Gear))
    assert held == list(range(held[0], held[-1] + 1)), "nothing is missing or twice"
    assert held[0] < early < before <= held[-1] < robot_sent
    return held


def test_an_alarm_keeps_what_came_before_and_after(peer: Peer, endpoint: str, tmp_path: Path) -> None:
    """The log goes on beside it, lacks nothing, and links to it; everybody is told."""
    robot = Robot(peer)
    with recording(*at(tmp_path, endpoint), "--json") as process:
        told = Told(peer)
        early = started(told, robot)
        before = robot.sent
        peer.put(sample_of(alarm("nothing much", Severity.INFO)))
        peer.put(sample_of(alarm()))
        incident = robot.drive_until("cruiser-1-*.incident.mcap", tmp_path)
        wait_until(lambda: bool(told.events(RecorderEventKind.INCIDENT)))
        robot.drive()
        code, out, err = process.end()
    assert code == ExitCode.OK
    assert json.loads(out)["incidents"] == 1
    assert "1 incidents" in err
    (event,) = told.events(RecorderEventKind.INCIDENT)
    assert (event.file, event.robot, event.severity) == (incident.name, "cruiser-1", Severity.WARNING)
    found = read_info(incident)
    assert counts(found)[key_of(SafetyEvent)] == 2
    held = sequences(incident, key_of(Gear))
    assert held == list(range(held[0], held[-1] + 1))
    assert held[0] < early < before < held[-1] < robot.sent
    (log,) = [path for path in whole(tmp_path) if path != incident]
    assert json.loads(out)["path"] == str(log)
    assert found.metadata[INCIDENT_NAME] | {"at_ns": ""} == {
        "at_ns": "",
        "because": "fault: a wheel is off",
        "file": log.name,
    }
    assert read_info(log).metadata[INCIDENT_NAME]["file"] == incident.name
    recorded = sequences(log, key_of(Gear))
    assert recorded == list(range(recorded[0], robot.sent))
    assert set(held) <= set(recorded)


def test_a_recorder_that_stands_by_writes_incidents_alone(
    peer: Peer, endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That there is no log is no failure."""
    monkeypatch.setenv("CRUISER_RECORDER_STANDBY", "true")
    robot = Robot(peer)
    with recording(*at(tmp_path, endpoint)) as process:
        early = started(Told(peer), robot)
        before = robot.sent
        assert logs_in(tmp_path) == []
        peer.put(sample_of(alarm()))
        incident = robot.drive_until("*.incident.mcap", tmp_path)
        code, out, err = process.end()
    assert (code, out) == (ExitCode.OK, "")
    assert "1 incidents" in err
    assert "no sample came" not in err
    assert logs_in(tmp_path) == [incident.name]
    check(incident, robot.sent, early, before)


def test_an_incident_that_a_kill_cuts_off_is_recovered_as_one(
    peer: Peer, endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It and the log are parts; the next start makes both whole under their names, and says so."""
    monkeypatch.setenv("CRUISER_RECORDER_INCIDENT_AFTER_S", "300")
    robot = Robot(peer)
    with recording(*at(tmp_path, endpoint)) as process:
        early = started(Told(peer), robot)
        before = robot.sent
        peer.put(sample_of(alarm()))
        part = robot.drive_until("*.incident.mcap.part", tmp_path)

        def holds_what_came_after() -> bool:
            robot.drive()
            found = [one for one in readable(tmp_path) if one.path == str(part)]
            kept = {key_of(Gear), key_of(SafetyEvent)}
            return any(kept <= counts(one).keys() and INCIDENT_NAME in one.metadata for one in found)

        wait_until(holds_what_came_after)
        wait_until(lambda: grows(part, robot))
        process.kill()
    left = logs_in(tmp_path)
    assert sorted(name.partition("Z")[2] for name in left) == [".incident.mcap.part", ".mcap.part"]
    told = Told(peer)
    with recording(*at(tmp_path, endpoint)) as process:
        wait_until(lambda: len(told.events(RecorderEventKind.RECOVERED)) == 2)
        wait_until(partial(heard, peer, tmp_path, "next"))
        process.end()
    incident = part.with_suffix("")
    assert {event.file for event in told.events(RecorderEventKind.RECOVERED)} == {
        name.removesuffix(".part") for name in left
    }
    check(incident, robot.sent, early, before)
    assert [entry.name for entry in read_entries(tmp_path) if entry.is_incident] == [incident.name]
    assert all(check_log(path).whole for path in tmp_path.iterdir())


def grows(part: Path, robot: Robot) -> bool:
    """Does what came after the alarm reach the incident?"""
    size = part.stat().st_size
    wait_until(lambda: robot.drive() or part.stat().st_size > size)  # type: ignore[func-returns-value]  # None goes on
    return True


def test_an_incident_at_the_end_is_whole(peer: Peer, endpoint: str, tmp_path: Path) -> None:
    """A signal ends it with all that came until then."""
    robot = Robot(peer)
    with recording(*at(tmp_path, endpoint)) as process:
        started(Told(peer), robot)
        peer.put(sample_of(alarm()))
        part = robot.drive_until("*.incident.mcap.part", tmp_path)
        process.signal(signal.SIGTERM)
        code, _, _ = process.end(None)
    assert code == ExitCode.OK
    assert not part.exists()
    assert all(check_log(path).whole for path in tmp_path.iterdir())
    assert len(whole(tmp_path)) == 2


def test_what_a_robot_says_rules_no_terminal(peer: Peer, endpoint: str, tmp_path: Path) -> None:
    """Its alarm's text goes into the recorder's own log."""

    def is_written(process: Process) -> bool:
        assert process.is_running
        return any(tmp_path.glob("*.incident.mcap"))

    with recording(*at(tmp_path, endpoint)) as process:
        link(peer, tmp_path)
        peer.put(sample_of(alarm(HOSTILE)))
        wait_until(partial(is_written, process))
        code, _, err = process.end()
    assert code == ExitCode.OK
    assert "what came before and after: fault: a wheel \\x1b[2J" in err
    assert all(line.isprintable() for line in err.splitlines())


def test_the_death_of_a_gateway_at_work_keeps_what_came_before(endpoint: str, tmp_path: Path) -> None:
    """Its liveliness token goes with it, whatever it could not say any more."""
    with recording(*at(tmp_path, endpoint)) as process:
        with Peer(endpoint) as gateway:
            token = gateway.session.liveliness().declare_token(keys.liveliness("fleet", "cruiser-1"))
            told = Told(gateway)
            sent = 0

            def is_heard() -> bool:
                nonlocal sent
                said = msgspec.structs.replace(
                    STANDBY,
                    time_ns=time.time_ns(),
                    sequence=sent,
                    state=ArbiterState.ENGAGED,
                    output_speed_mps=0.6,
                )
                gateway.put(sample_of(said))
                sent += 1
                return any(health.ring_bytes for health in told.healths())

            wait_until(is_heard)
            del token
        wait_until(lambda: any(tmp_path.glob("cruiser-1-*.incident.mcap")))
        code, _, err = process.end()
    assert code == ExitCode.OK
    (incident,) = tmp_path.glob("cruiser-1-*.incident.mcap")
    found = read_info(incident)
    assert "the gateway died, or the link to it" in found.metadata[INCIDENT_NAME]["because"]
    assert counts(found)[key_of(SafetyState)] > 0
    assert "it was engaged, and told 0.60 m/s" in err
