"""A digest that does not say what its log says is a finding: stores are asked by it."""

from collections.abc import Callable
from io import BytesIO

import pytest

from recorder.encoding.event_digest import EventDigest
from recorder.mcap.chunk import Chunk
from recorder.mcap.writer import McapFile
from recorder.review.check import check_stream
from schemas.decisions import SafetyEvent, SafetyState
from schemas.messages import Message
from tests.support.logs import Disk, channel_of, encoded, sealed
from tests.support.messages import WALL_NS, arbiter, event

CHANNELS = (channel_of(SafetyState, 1, "fleet/a/safety/state"), channel_of(SafetyEvent, 2, "fleet/a/safety/event"))


def chunk_of(first: int, *, text: str = "stopping") -> Chunk:
    """States and two events."""
    states: list[tuple[int, Message]] = [(1, arbiter(number)) for number in range(first, first + 20)]
    events: list[tuple[int, Message]] = [(2, event(first + number, text=text)) for number in (19, 20)]
    return sealed(
        (channel, one.sequence, one.time_ns, one.time_ns, encoded(one)) for channel, one in [*states, *events]
    )


class Liar(EventDigest):
    """A digest of other chunks than those of its log."""

    def __init__(self, other: Callable[[Chunk, int], tuple[Chunk, int]]) -> None:
        super().__init__()
        self._other = other

    def add_chunk(self, chunk: Chunk, offset: int) -> None:
        super().add_chunk(*self._other(chunk, offset))


def findings(digest: EventDigest) -> list[str]:
    """What is found in a log of two chunks with this digest."""
    disk = Disk()
    file = McapFile(disk, "test", digest=digest)
    file.add_channels(CHANNELS)
    for first in (0, 21):
        file.write_chunk(chunk_of(first))
    file.finish()
    data = disk.getvalue()
    found = check_stream(BytesIO(data), len(data), "log.mcap")
    return [one.what for one in found.findings if "digest" in one.what]


def states_alone() -> Chunk:
    """States of another time."""
    states: list[tuple[int, Message]] = [(1, arbiter(number)) for number in range(200, 221)]
    return sealed((channel, one.sequence, one.time_ns, one.time_ns, encoded(one)) for channel, one in states)


def test_a_true_digest_is_no_finding() -> None:
    """Though it leaves out most of the states."""
    assert findings(EventDigest()) == []


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (lambda chunk, at: (chunk_of((chunk.start_ns > WALL_NS) * 21, text="no"), at), ["holds", "lacks"]),
        (lambda chunk, at: (chunk, at + 10**6), ["this time is elsewhere"]),
        (lambda _, at: (chunk_of(0), at), ["this time is elsewhere", "lacks"]),
        (lambda _, at: (states_alone(), at), ["another log"]),
    ],
)
def test_one_that_says_otherwise_is_found(
    other: Callable[[Chunk, int], tuple[Chunk, int]], expected: list[str]
) -> None:
    """Made-up messages, places that are wrong, events that it keeps back, and one of another log."""
    found = findings(Liar(other))
    for words in expected:
        assert any(words in what for what in found), found
