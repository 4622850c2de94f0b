import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Any

import msgspec
import pytest

from gateway.client import link
from gateway.client.link import RobotLink
from gateway.client.refusal import Refused, Unreachable
from gateway.telemetry.samples import Missed, Received
from schemas.codec import PayloadFault
from schemas.decisions import LeaseReply, SafetyState
from schemas.messages import RobotState
from schemas.reasons import Reason
from schemas.requests import Acquire, Park, Request
from schemas.subjects import BY_VERB
from tests.support.messages import STANDBY, STATE
from tests.support.metrics import received
from tests.support.waiting import wait_until

MOVES = msgspec.structs.replace(STATE, speed_mps=0.5)
FORGED = msgspec.structs.replace(STATE, speed_mps=0.0)


class FakePort:
    """Samples that come in one batch; commands go nowhere."""

    def __init__(self, batch: Sequence[Received | Missed]) -> None:
        self.batch = batch

    def drain(self) -> Iterator[Received | Missed]:
        yield from self.batch
        self.batch = []

    def close(self) -> None:
        """It is closed."""


def looked_at(batch: Sequence[Received | Missed]) -> list[SafetyState | RobotState | PayloadFault | Missed]:
    """What a look shows after one batch: the chassis's states, and where some may be missing."""
    port: Any = FakePort(batch)
    with closing(RobotLink(port, port, "cruiser-1")) as opened:
        wait_until(lambda: not port.batch)
        with opened.heard:
            seen = opened.look()
            assert opened.look() == []
    return [one if isinstance(one, Missed) else one[2] for one in seen]


def test_a_forged_state_hides_none_of_the_robots_own() -> None:
    """Though both came in one batch, and the forged one is newer: what the robot does is seen."""
    assert looked_at([received(STANDBY), received(MOVES), received(FORGED)]) == [STANDBY, MOVES, FORGED]


def test_a_look_says_where_samples_are_missing() -> None:
    """Where the port lost some, and where more came than wait for a look."""
    assert looked_at([received(MOVES), Missed(), received(FORGED)]) == [Missed(), FORGED]
    flood = looked_at([received(MOVES), *[received(FORGED)] * link.SEEN_KEPT])
    assert flood[0] == Missed()
    assert len(flood) <= link.SEEN_KEPT


class FakeDoor(FakePort):
    """A robot whose state is seen, and which answers these one after the other, the last one for ever."""

    def __init__(self, *answers: Reason | None) -> None:
        super().__init__([])
        self.prover: Any = None
        self.operator = "ann"
        self.answers = list(answers)
        self.asked = 0

    def drain(self) -> Iterator[Received | Missed]:
        yield received(STANDBY)

    def ask(self, verb: str, _payload: bytes, _timeout_s: float) -> list[Received]:
        self.asked += 1
        reason = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if reason is None:
            return []
        said = LeaseReply(ok=reason is Reason.NONE, reason=reason, detail="", cure="", lease=7, expires_s=2.0)
        return [
            Received(
                f"fleet/cruiser-1/@cmd/ann/{verb}", BY_VERB[verb].reply_encoding, msgspec.msgpack.encode(said)
            )
        ]


class FakeProof:
    """Everything is proven."""

    def with_key(self, request: Request) -> Request:
        return request

    def begin_lease(self, *_: object) -> bool:
        return True

    def __getattr__(self, _name: str) -> Callable[..., Any]:
        return lambda *_: True


def asked(door: Any, request: Request, timeout_s: float = 5.0) -> Any:  # noqa: ANN401 - a fake, a reply
    """What becomes of a request."""
    proof: Any = FakeProof()
    with closing(RobotLink(door, door, "cruiser-1", proof)) as opened:
        wait_until(lambda: opened.is_heard)
        return opened.ask(request, timeout_s)


def test_a_robot_that_is_asked_too_much_is_asked_for_its_lease_again() -> None:
    """Its door judges a bounded number of requests in a tick, and leaves others unanswered."""
    door = FakeDoor(Reason.BUSY, None, Reason.BUSY, Reason.NONE)
    assert asked(door, Acquire()).lease == 7
    assert door.asked == 4


def test_a_refusal_is_no_reason_to_ask_again() -> None:
    """Nor are other verbs sent twice: they may have been carried out."""
    for door, request in (
        (FakeDoor(Reason.LEASE_HELD), Acquire()),
        (FakeDoor(Reason.BUSY), Park(lease=7)),
    ):
        with pytest.raises(Refused):
            asked(door, request)
        assert door.asked == 1
    silent = FakeDoor(None)
    with pytest.raises(Unreachable, match="did not answer park"):
        asked(silent, Park(lease=7))
    assert silent.asked == 1


def test_a_robot_that_stays_busy_is_asked_as_long_as_one_wants_to_wait() -> None:
    """Then it is said what it said last."""
    door = FakeDoor(Reason.BUSY)
    began_s = time.monotonic()
    with pytest.raises(Refused) as refused:
        asked(door, Acquire(), 0.3)
    assert refused.value.reason is Reason.BUSY
    assert door.asked > 2
    assert time.monotonic() - began_s >= 0.2
