from collections import deque
from collections.abc import Iterable
from typing import Any

import msgspec

from gateway.authority.session import SILENT
from gateway.client import remote_stop
from gateway.telemetry.samples import Missed, Received
from schemas import keys
from schemas.decisions import Reply, SafetyState
from schemas.messages import RobotState
from schemas.reasons import Reason
from tests.support.fakes.fleet import STOPS
from tests.support.messages import ROOT, STANDBY, STATE

LATCHED = msgspec.structs.replace(STANDBY, latched=[Reason.REMOTE_STOP])
MOVES = msgspec.structs.replace(STATE, speed_mps=0.3, rear_left_speed_mps=0.3, rear_right_speed_mps=0.3)
STANDS = msgspec.structs.replace(STATE, speed_mps=0.0, rear_left_speed_mps=0.0, rear_right_speed_mps=0.0)
MS = 1_000_000


class AnsweringPort:
    """A port to a robot that says at once that it stops.

    Attributes:
        is_proven: the port accepts the reply; else it is rejected, as one that cannot be verified.
    """

    def __init__(self, *, is_proven: bool = True, reply: bytes = STOPS) -> None:
        self.is_proven = is_proven
        self.reply = reply
        self.rejected: deque[Received] = deque()
        self.puts: list[str] = []

    def connected(self) -> bool:
        return True

    def put(self, verb: str, _payload: bytes) -> None:
        self.puts.append(verb)

    def begin(self, _verb: str, _payload: bytes, _timeout_s: float) -> "AnsweringPort":
        return self

    def poll(self) -> list[Received]:
        key = keys.command(ROOT, "cruiser-1", "first", "stop")
        received = Received(key, remote_stop.STOP.reply_encoding, self.reply)
        if self.is_proven:
            return [received]
        self.rejected.append(received)
        return []

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


Look = list[tuple[int, SafetyState | RobotState] | Missed]


def report_of_strangers(
    *batches: Look, port: AnsweringPort, proven: Iterable[Look] = ()
) -> remote_stop.StopReport:
    """What is said of a robot of which these samples cannot be verified, and ``proven`` can."""
    unproven, verified = iter(batches), iter([*proven, *[[] for _ in batches]])

    def look() -> list[remote_stop.Seen | Missed | remote_stop.Unproven]:
        seen = [(one[0] * MS, "cruiser-1", one[1]) for one in next(unproven) if not isinstance(one, Missed)]
        also = [(one[0] * MS, "cruiser-1", one[1]) for one in next(verified) if not isinstance(one, Missed)]
        return [*map(remote_stop.Unproven, seen), *also]

    given: Any = port
    stopping = remote_stop._Stopping(given, ROOT, "cruiser-1", look, lambda _: SILENT)
    for number in range(len(batches)):
        stopping.step(float(number))
    return stopping.report()


def test_what_cannot_be_verified_is_reported_as_that() -> None:
    """Neither as a robot that stopped, nor as one that is silent: its word, and why it is only that."""
    report = report_of_strangers(batch(0), batch(400), port=AnsweringPort(is_proven=False))
    assert (report.stopped, report.refused, report.unconfirmed, report.silent) == ([], {}, {}, [])
    says = "it replied that it stops, and its states show that it stands, latched"
    assert report.unverified == {"cruiser-1": remote_stop.Unverified(True, says, SILENT.text, SILENT.cure)}  # noqa: FBT003 - says that it stops


def test_an_answer_that_cannot_be_verified_is_not_improved() -> None:
    """It moves by its own states, or says that it cannot stop: then it does not say that it stops."""
    moving = report_of_strangers(batch(0, MOVES), batch(400, MOVES), port=AnsweringPort(is_proven=False))
    word = moving.unverified["cruiser-1"]
    assert (word.stops, word.says) == (False, "it replied that it stops, but it is seen to move at 0.30 m/s")
    refusal = msgspec.msgpack.encode(Reply(ok=False, reason=Reason.BUS_DOWN, detail="it moves", cure=""))
    cannot = report_of_strangers(
        batch(0), batch(400), port=AnsweringPort(is_proven=False, reply=refusal)
    ).unverified["cruiser-1"]
    assert (cannot.stops, cannot.says) == (False, "it replied that it is not stopped: bus_down: it moves")


def test_what_is_verified_counts_alone() -> None:
    """Whoever answers and publishes besides, in the robot's place."""
    port = AnsweringPort()
    report = report_of_strangers(batch(0, MOVES), batch(400, MOVES), port=port, proven=[batch(0), batch(400)])
    assert (report.stopped, report.unverified) == (["cruiser-1"], {})
    report = report_of_strangers(batch(0), batch(400), port=port)
    assert report.unconfirmed == {"cruiser-1": "it replied that it stops, but its safety/state does not say so"}


def test_of_a_silent_robot_is_said_what_is_seen() -> None:
    """And that it is not verified, where it is not."""
    port = AnsweringPort(is_proven=False)
    port.poll = list  # type: ignore[method-assign] # nobody answers
    proven = report_of_strangers([], [], port=port, proven=[batch(0), batch(400)])
    assert (proven.silent, proven.unverified) == (["cruiser-1"], {})
    assert proven.seen == {"cruiser-1": "its states say: a remote stop is latched, and it stands"}
    unproven = report_of_strangers([(0, STANDBY), (0, MOVES)], port=port)
    said = "its states say: no remote stop is latched, and it moves at 0.30 m/s, which cannot be verified: "
    assert unproven.seen == {"cruiser-1": said + SILENT.text}
    assert report_of_strangers([], port=port).seen == {}


def test_a_stop_that_is_interrupted_at_once_is_sent_all_the_same() -> None:
    """Once; and of a link that is there nobody says that it is not."""
    answering = AnsweringPort()
    port: Any = answering
    report = remote_stop.stop(port, ROOT, "cruiser-1", 60.0, list, lambda: True)
    assert answering.puts == ["stop"]
    assert report.linked
    assert report.stopped == []
