"""``cruiser record``: an alarm records an incident file, with the time before and after."""

import json
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path

import msgspec
import pytest

from recorder.record.incidents import INCIDENT_NAME
from recorder.review.info import read_info
from schemas import keys
from schemas.command_line import ExitCode
from schemas.decisions import ArbiterState, EventKind, SafetyEvent, SafetyState, Severity
from schemas.messages import Gear
from schemas.recording import RecorderEventKind
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.messages import STANDBY, gear, key_of, safety_event, sample_of
from tests.support.processes.recorder import Told, at, counts, recording, sequences, whole
from tests.support.waiting import wait_until


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("CRUISER_RECORDER_INCIDENT_AFTER_S", "1.5")
    return free_endpoint()


TEXT = "a wheel \x1b[2J\x07\nis off"
"""As somebody may send it who would rule a terminal."""


class Robot:
    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self.sent = 0

    def say(self, text: str, severity: Severity) -> None:
        said = safety_event(EventKind.FAULT, severity)
        self._peer.put(sample_of(msgspec.structs.replace(said, time_ns=time.time_ns(), text=text)))

    def drive_until(self, condition: Callable[[], object]) -> int:
        """Publish gears until a condition holds. Returns how many there were before."""

        def is_so() -> bool:
            for _ in range(5):
                self._peer.put(sample_of(gear(self.sent, time.time_ns())))
                self.sent += 1
            time.sleep(0.02)
            return bool(condition())

        before = self.sent
        wait_until(is_so)
        return before


def incidents(directory: Path) -> list[Path]:
    return list(directory.glob("cruiser-1-*.incident.mcap"))


def test_an_alarm_keeps_what_came_before_and_after(peer: Peer, endpoint: str, tmp_path: Path) -> None:
    robot, told = Robot(peer), Told(peer)
    with recording(*at(tmp_path, endpoint), "--json") as process:
        robot.drive_until(lambda: told.healths() and told.healths()[-1].ring_bytes > 0)
        healths = len(told.healths())
        early = robot.drive_until(lambda: len(told.healths()) >= healths + 2)
        robot.say("nothing much", Severity.INFO)
        robot.say(TEXT, Severity.ERROR)
        before = robot.drive_until(lambda: incidents(tmp_path))
        robot.drive_until(lambda: told.events(RecorderEventKind.INCIDENT))
        code, out, err = process.end()
    assert code == ExitCode.OK
    assert json.loads(out)["incidents"] == 1
    assert ", 1 incident" in err
    assert "incidents" not in err
    assert ".incident.mcap: fault: a wheel \\x1b[2J" in err
    assert all(line.isprintable() for line in err.splitlines())
    (event,) = told.events(RecorderEventKind.INCIDENT)
    (incident,) = incidents(tmp_path)
    assert (event.file, event.robot, event.severity) == (incident.name, "cruiser-1", Severity.WARNING)
    found = read_info(incident)
    assert counts(found)[key_of(SafetyEvent)] == 2
    held = sequences(incident, key_of(Gear))
    assert held == list(range(held[0], held[-1] + 1))
    assert held[0] < early < before < held[-1] < robot.sent
    (log,) = [path for path in whole(tmp_path) if path != incident]
    about = {"at_ns": "", "because": f"fault: {TEXT}", "file": log.name}
    assert found.metadata[INCIDENT_NAME] | {"at_ns": ""} == about
    assert read_info(log).metadata[INCIDENT_NAME]["file"] == incident.name
    recorded = sequences(log, key_of(Gear))
    assert recorded == list(range(recorded[0], robot.sent))
    assert set(held) <= set(recorded)


def test_the_death_of_a_gateway_at_work_keeps_what_came_before(endpoint: str, tmp_path: Path) -> None:
    working = msgspec.structs.replace(STANDBY, state=ArbiterState.ENGAGED, output_speed_mps=0.6)
    with recording(*at(tmp_path, endpoint)) as process:
        with Peer(endpoint) as gateway:
            token = gateway.session.liveliness().declare_token(keys.liveliness("fleet", "cruiser-1"))
            told, sequence = Told(gateway), count()

            def is_heard() -> bool:
                said = msgspec.structs.replace(working, time_ns=time.time_ns(), sequence=next(sequence))
                gateway.put(sample_of(said))
                return any(health.ring_bytes for health in told.healths())

            wait_until(is_heard)
            del token
        wait_until(lambda: incidents(tmp_path))
        code, _, err = process.end()
    assert code == ExitCode.OK
    (incident,) = incidents(tmp_path)
    found = read_info(incident)
    assert "the gateway or the link to it died" in found.metadata[INCIDENT_NAME]["because"]
    assert counts(found)[key_of(SafetyState)] > 0
    assert "engaged at 0.60 m/s" in err
