"""When a robot counts as stopped, by its replies and samples."""

from collections import deque
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from gateway.authority.session import SILENT
from gateway.client import remote_stop
from gateway.client.refusal import Refused
from gateway.client.robot import Robot
from gateway.telemetry.samples import Missed, Received
from schemas import keys
from schemas.codec import PayloadFault
from schemas.decisions import Reply, SafetyState
from schemas.messages import RobotState
from schemas.reasons import Reason
from tests.support.fakes.fleet import STOPS
from tests.support.messages import ROOT, STANDBY, STATE

LATCHED = msgspec.structs.replace(STANDBY, latched=[Reason.REMOTE_STOP])
MOVES = msgspec.structs.replace(STATE, speed_mps=0.3, rear_left_speed_mps=0.3, rear_right_speed_mps=0.3)
STANDS = msgspec.structs.replace(STATE, speed_mps=0.0, rear_left_speed_mps=0.0, rear_right_speed_mps=0.0)
MS = 1_000_000
Sample = SafetyState | RobotState | PayloadFault
Batch = list[tuple[int, Sample] | Missed]


class AnsweringPort:
    """A port to a robot that answers at once, or never. ``is_proven``: the port accepts the reply."""

    is_over = True

    def __init__(self, reply: bytes | None = STOPS, *, is_proven: bool = True) -> None:
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
        if self.reply is None:
            return []
        key = keys.command(ROOT, "cruiser-1", "first", "stop")
        received = Received(key, remote_stop.STOP.reply_encoding, self.reply)
        if self.is_proven:
            return [received]
        self.rejected.append(received)
        return []


def report_of(*batches: Batch, port: AnsweringPort | None = None) -> remote_stop.StopReport:
    """Report on a robot of which these batches were read, each sample at its time in ms."""
    waiting = iter(batches)

    def look() -> list[remote_stop.Seen | Missed]:
        return [one if isinstance(one, Missed) else (one[0] * MS, "cruiser-1", one[1]) for one in next(waiting)]

    given: Any = port or AnsweringPort()
    stopping = remote_stop._Stopping(given, ROOT, "cruiser-1", look, lambda _: SILENT)
    for number in range(len(batches)):
        stopping.step(float(number))
    return stopping.report()


def batch(at_ms: int, *states: RobotState, says: SafetyState = LATCHED) -> Batch:
    """Twenty states of arbiter and chassis, read at once."""
    return [(at_ms, one) for one in [says] * 20 + list(states or [STANDS] * 20)]


FORGED = [batch(at_ms, *[STANDS] * 9, MOVES, *[STANDS] * 9) for at_ms in range(0, 2000, 100)]
GUESSED = msgspec.structs.replace(LATCHED, rest_confirmed=False)
NOT_LATCHED, BRIEFLY = "its safety/state does not show it", "its safety/state shows it too briefly"
SEEN: dict[str, tuple[list[Batch], str]] = {
    "read late, in batches more than a second apart": ([batch(0), batch(1200)], ""),
    "many, of one moment": ([batch(0), batch(140)], BRIEFLY),
    "nine of ten are forged, and say that it stands": (FORGED, "it has stood too briefly"),
    "none was lost": ([batch(0), batch(400)], ""),
    "lost at the end": ([batch(0), [*batch(400), Missed()]], NOT_LATCHED),
    "lost between": ([batch(0), [Missed()], batch(400)], BRIEFLY),
    "lost, and enough came then": ([batch(0), [Missed()], batch(400), batch(800)], ""),
    "stands, and is not latched": ([batch(0), batch(400), [(800, STANDBY)]], NOT_LATCHED),
    "moves": ([batch(0, MOVES), batch(400, MOVES)], "it moves at 0.30 m/s"),
    "a zero without feedback": (
        [batch(0, says=GUESSED), batch(400, says=GUESSED)],
        "its speed reads 0, not confirmed by feedback",
    ),
    "of another version": (
        [[(0, PayloadFault("state is version 2"))]],
        "its state cannot be read: state is version 2",
    ),
}


@pytest.mark.parametrize("name", SEEN)
def test_a_robot_stops_where_all_that_is_seen_says_so(name: str) -> None:
    """Three samples in 150 ms, none that contradicts, none missing."""
    batches, doubt = SEEN[name]
    report = report_of(*batches)
    assert report.stopped == ([] if doubt else ["cruiser-1"])
    assert report.unconfirmed == ({"cruiser-1": f"it replied that it stops, but {doubt}"} if doubt else {})


REFUSAL = msgspec.msgpack.encode(Reply(ok=False, reason=Reason.BUS_DOWN, detail="it moves", cure=""))


@pytest.mark.parametrize(
    ("port", "said"),
    [
        (AnsweringPort(REFUSAL), {"refused": {"cruiser-1": "bus_down: it moves"}}),
        (AnsweringPort(is_proven=False), {"unverified": {"cruiser-1": SILENT}}),
        (AnsweringPort(None), {"silent": ["cruiser-1"]}),
    ],
    ids=["it cannot stop", "its answer is not verified", "it is silent"],
)
def test_another_answer_is_no_stop_whatever_is_seen(port: AnsweringPort, said: dict[str, object]) -> None:
    report = msgspec.structs.asdict(report_of(batch(0), batch(400), port=port))
    named = {"stopped", "refused", "unconfirmed", "silent", "unverified"}
    assert {name: value for name, value in report.items() if name in named and value} == said


def test_a_stop_that_is_interrupted_at_once_is_sent_all_the_same() -> None:
    answering = AnsweringPort()
    port: Any = answering
    report = remote_stop.stop(port, ROOT, "cruiser-1", 60.0, list, lambda: True)
    assert (answering.puts, report.linked, report.stopped) == (["stop"], True, [])


def test_the_library_says_what_cannot_be_verified_and_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    unmet = msgspec.structs.replace(SILENT, text="it is not signed", cure="see ROBOT")
    report = remote_stop.StopReport([], {}, {}, [], linked=True, unverified={"cruiser-1": unmet})
    monkeypatch.setattr(remote_stop, "stop", lambda *_, **__: report)
    link: Any = SimpleNamespace(robot="cruiser-1", commands=None, look=list, doubt=None)
    with pytest.raises(Refused, match="cruiser-1 not confirmed stopped") as refused:
        Robot(link, "ann", "fleet").stop()
    said = refused.value
    assert (said.reason, said.detail, said.cure) == (Reason.NOT_CONFIRMED, "it is not signed", "see cruiser-1")
