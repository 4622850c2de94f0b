from typing import Any

import msgspec

from gateway.client import remote_stop
from gateway.telemetry.received import Missed, Received
from schemas import keys
from schemas.decisions import SafetyState
from schemas.messages import RobotState
from schemas.reasons import Reason
from tests.support.fakes.fleet import STOPS
from tests.support.messages import ROOT, STANDBY, STATE

LATCHED = msgspec.structs.replace(STANDBY, latched=[Reason.REMOTE_STOP])
MOVES = msgspec.structs.replace(STATE, speed_mps=0.3, rear_left_speed_mps=0.3, rear_right_speed_mps=0.3)
STANDS = msgspec.structs.replace(STATE, speed_mps=0.0, rear_left_speed_mps=0.0, rear_right_speed_mps=0.0)
MS = 1_000_000


class AnsweringPort:
    """A port to a robot that says at once that it stops."""

    def connected(self) -> bool:
        return True

    def put(self, _verb: str, _payload: bytes) -> None:
        """It is taken."""

    def begin(self, _verb: str, _payload: bytes, _timeout_s: float) -> "AnsweringPort":
        return self

    def poll(self) -> list[Received]:
        key = keys.command(ROOT, "cruiser-1", "first", "stop")
        return [Received(key, remote_stop.STOP.reply_encoding, STOPS)]

    is_over = True


def report_of(*batches: list[tuple[int, SafetyState | RobotState] | Missed]) -> remote_stop.StopReport:
    """What is said of a robot that answers, of which these batches were read, each sample at its time in ms."""
    waiting = iter(batches)

    def look() -> list[remote_stop.Seen | Missed]:
        return [one if isinstance(one, Missed) else (one[0] * MS, "cruiser-1", one[1]) for one in next(waiting)]

    port: Any = AnsweringPort()
    stopping = remote_stop._Stopping(port, ROOT, "cruiser-1", look)
    for number in range(len(batches)):
        stopping.step(float(number))
    return stopping.report()


def batch(at_ms: int, *states: RobotState) -> list[tuple[int, SafetyState | RobotState] | Missed]:
    """The arbiter's states and the chassis's of a second, read in one go."""
    return [(at_ms, one) for one in [LATCHED] * 20 + list(states or [STANDS] * 20)]


def test_samples_that_are_read_late_prove_a_stop_all_the_same() -> None:
    """A busy machine reads them in batches, more than a second apart: all of them say so."""
    assert report_of(batch(0), batch(1200)).stopped == ["cruiser-1"]


def test_samples_of_one_moment_prove_no_stop() -> None:
    """However many they are: anyone can send a hundred in a moment."""
    why = report_of(batch(0), batch(140)).unconfirmed["cruiser-1"]
    assert why == "it replied that it stops, but its safety/state says so too briefly"


def test_a_robot_that_is_seen_to_move_once_among_forged_samples_is_not_said_to_stop() -> None:
    """Nine of ten say that it stands; one in each batch is the robot's own."""
    forged = [batch(at_ms, *[STANDS] * 9, MOVES, *[STANDS] * 9) for at_ms in range(0, 2000, 100)]
    assert report_of(*forged).stopped == []


def test_where_samples_were_lost_the_evidence_begins_anew() -> None:
    """Who floods the network may have displaced those that say otherwise."""
    assert report_of(batch(0), batch(400)).stopped == ["cruiser-1"]
    assert report_of(batch(0), [*batch(400), Missed()]).stopped == []
    assert report_of(batch(0), [Missed()], batch(400)).stopped == []
    assert report_of(batch(0), [Missed()], batch(400), batch(800)).stopped == ["cruiser-1"]


def test_a_robot_that_stands_and_is_not_latched_is_not_said_to_stop() -> None:
    """It may drive on at once: each state has to say that the remote stop is latched."""
    unlatched: list[tuple[int, SafetyState | RobotState] | Missed] = [(800, STANDBY)]
    report = report_of(batch(0), batch(400), unlatched)
    assert report.unconfirmed == {"cruiser-1": "it replied that it stops, but its safety/state does not say so"}
