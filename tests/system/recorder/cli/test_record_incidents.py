"""``cruiser record``: an alarm records an incident file, with the time before and after."""

import json
import time
from pathlib import Path

import msgspec
import pytest

from recorder.record.incidents import INCIDENT_NAME
from recorder.review.info import read_info
from schemas import keys
from schemas.command_line import ExitCode
from schemas.decisions import ArbiterState, EventKind, SafetyEvent, SafetyState, Severity
from schemas.messages import Gear
from schemas.reasons import Reason
from schemas.recording import RecorderEventKind
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.messages import STANDBY, gear, key_of, sample_of
from tests.support.processes.recorder import Told, at, counts, recording, sequences, whole
from tests.support.waiting import wait_until


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("CRUISER_RECORDER_INCIDENT_AFTER_S", "1.5")
    return free_endpoint()


TEXT = "a wheel \x1b[2J\x07\nis off"
"""As somebody may send it who would rule a terminal."""


def alarm(text: str = TEXT, severity: Severity = Severity.ERROR) -> SafetyEvent:
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


def test_an_alarm_keeps_what_came_before_and_after(peer: Peer, endpoint: str, tmp_path: Path) -> None:
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
    assert ".incident.mcap: fault: a wheel \\x1b[2J" in err
    assert all(line.isprintable() for line in err.splitlines())
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
        "because": f"fault: {TEXT}",
        "file": log.name,
    }
    assert read_info(log).metadata[INCIDENT_NAME]["file"] == incident.name
    recorded = sequences(log, key_of(Gear))
    assert recorded == list(range(recorded[0], robot.sent))
    assert set(held) <= set(recorded)


def test_the_death_of_a_gateway_at_work_keeps_what_came_before(endpoint: str, tmp_path: Path) -> None:
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
    assert "the gateway or the link to it died" in found.metadata[INCIDENT_NAME]["because"]
    assert counts(found)[key_of(SafetyState)] > 0
    assert "engaged at 0.60 m/s" in err
