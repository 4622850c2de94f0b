from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from gateway.client import link
from gateway.client.link import RobotLink
from gateway.telemetry.received import Missed, Received
from schemas import codec, keys
from schemas.codec import PayloadFault
from schemas.decisions import SafetyState
from schemas.messages import RobotState
from schemas.subjects import BY_TYPE
from tests.support.messages import ROOT, STANDBY, STATE
from tests.support.waiting import wait_until

MOVES = msgspec.structs.replace(STATE, speed_mps=0.5)
FORGED = msgspec.structs.replace(STATE, speed_mps=0.0)


def sample(message: SafetyState | RobotState) -> Received:
    """As it comes over Zenoh."""
    subject = BY_TYPE[type(message)]
    return Received(keys.build(ROOT, "cruiser-1", subject), subject.encoding, codec.encode(message))


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
    opened = RobotLink(port, port, "cruiser-1")
    try:
        wait_until(lambda: not port.batch)
        with opened.heard:
            seen = opened.look()
            assert opened.look() == []
    finally:
        opened.close()
    return [one if isinstance(one, Missed) else one[2] for one in seen]


def test_a_forged_state_hides_none_of_the_robots_own() -> None:
    """Though both came in one batch, and the forged one is newer: what the robot does is seen."""
    assert looked_at([sample(STANDBY), sample(MOVES), sample(FORGED)]) == [STANDBY, MOVES, FORGED]


def test_a_look_says_where_samples_are_missing() -> None:
    """Where the port lost some, and where more came than wait for a look."""
    assert looked_at([sample(MOVES), Missed(), sample(FORGED)]) == [Missed(), FORGED]
    flood = looked_at([sample(MOVES), *[sample(FORGED)] * link.SEEN_KEPT])
    assert flood[0] == Missed()
    assert len(flood) <= link.SEEN_KEPT
