"""Streams of feedback frames, batches of raw frames, and stored samples."""

from collections import Counter
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import EXTENDED, REMOTE, FaultKind, Frame
from gateway.chassis.supervision import silence_ns
from gateway.choice.chassis import CHASSIS
from gateway.telemetry.feedback import FeedbackStream, FrameBatch
from gateway.telemetry.samples import KeptSamples
from schemas.messages import Variant
from schemas.settings import PERIOD_WINDOW_FRAMES
from schemas.subjects import KEPT_PIECE
from tests.support.frames import MS, Feedback

GEAR = "Auto_GearFeedBack"
PERIOD_NS = 10 * MS


class Gears:
    def __init__(self) -> None:
        self.faults: Counter[FaultKind] = Counter()
        self.stream = FeedbackStream(CHASSIS.decoder(load(Variant.COARSE).messages[GEAR]), self.faults)
        self._feedback = Feedback(Variant.COARSE)

    def receive(self, times_ns: Iterable[int]) -> None:
        for now_ns in times_ns:
            assert self.stream.receive(self._feedback.frame(GEAR), now_ns) is not None

    def failures(self, now_ns: int) -> list[str]:
        return self.stream.health(1.0, now_ns).failures


def test_a_silence_is_no_fault_of_the_period() -> None:
    gears = Gears()
    gears.receive(range(0, 10 * PERIOD_NS, PERIOD_NS))
    gears.stream.tick(10**9)
    gears.receive(range(10**9, 10**9 + 3 * PERIOD_WINDOW_FRAMES * PERIOD_NS, PERIOD_NS))
    assert gears.faults == {FaultKind.SILENCE: 1}


def test_a_period_that_had_failed_is_forgotten_in_a_silence() -> None:
    gears = Gears()
    gears.receive(range(0, (PERIOD_WINDOW_FRAMES + 1) * PERIOD_NS // 2, PERIOD_NS // 2))
    end_ns = PERIOD_WINDOW_FRAMES * PERIOD_NS // 2
    assert gears.failures(end_ns) == ["period"]
    silent_ns = end_ns + silence_ns(PERIOD_NS) + 1
    gears.stream.tick(silent_ns)
    assert gears.failures(silent_ns) == ["silence"]


@given(batches=st.lists(st.integers(0, 30), max_size=8))
def test_frames_beyond_the_capacity_are_dropped_oldest_first_and_counted(batches: list[int]) -> None:
    held = FrameBatch("can0", capacity=10)
    added = taken = dropped = 0
    for size in batches:
        for _ in range(size):
            held.add(Frame(EXTENDED | added, b""))
            added += 1
        batch = held.take(0)
        dropped += max(0, size - 10)
        if batch is None:
            assert size == 0
            continue
        taken += len(batch.can_id)
        assert batch.can_id == [EXTENDED | number for number in range(added - min(size, 10), added)]
        assert batch.dropped == dropped
    assert (held.received, taken + dropped) == (added, added)


def test_a_row_keeps_everything_of_its_frame() -> None:
    held = FrameBatch("can0")
    held.add(Frame(REMOTE | 0x123, b"", 17, 0, 5))
    held.add(Frame(EXTENDED | 0x18C4D1EF, b"\x01\x02", 18, 4))
    batch = held.take(99)
    assert batch is not None
    assert (batch.bus, batch.time_ns, batch.frame_time_ns) == ("can0", 99, [17, 18])
    assert (batch.can_id, batch.length, batch.fd_flags) == (
        [REMOTE | 0x123, EXTENDED | 0x18C4D1EF],
        [5, 2],
        [0, 4],
    )
    assert batch.data == [b"", b"\x01\x02"]
    assert held.take(100) is None


def kept(count: int, max_bytes: int = 1_000_000) -> KeptSamples:
    """Ten-byte samples that contain their sequence."""
    samples = KeptSamples(max_bytes)
    for number in range(count):
        samples.add(b"%010d" % number)
    return samples


@pytest.mark.parametrize("first", [0, 5, 99, 100, 4711])
def test_a_piece_begins_with_the_sequence_that_was_asked_for(first: int) -> None:
    found = [int(payload) for payload in kept(100).piece(first)]
    assert found == list(range(first, min(100, first + KEPT_PIECE)))


def test_the_oldest_go_by_their_bytes() -> None:
    samples = kept(100, max_bytes=305)
    assert [int(payload) for payload in samples.piece(0)] == list(range(70, 70 + KEPT_PIECE))
    assert [int(payload) for payload in samples.piece(98)] == [98, 99]


def test_what_is_larger_than_all_there_is_room_for_is_not_kept() -> None:
    samples = kept(3, max_bytes=20)
    samples.add(bytes(21))
    assert samples.piece(0) == []
    samples.add(b"four")
    assert samples.piece(0) == samples.piece(4) == [b"four"]
