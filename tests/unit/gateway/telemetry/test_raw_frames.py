"""Raw frames in batches."""

from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.frame import EXTENDED, REMOTE, Frame
from gateway.telemetry.feedback import FrameBatch


@given(batches=st.lists(st.integers(0, 30), max_size=8))
def test_frames_beyond_the_capacity_are_dropped_oldest_first_and_counted(batches: list[int]) -> None:
    """What is taken and what is dropped is what was added; the newest are kept, in their order."""
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
    """Flags, length asked for by a remote frame, CAN FD flags, data and time are in the columns."""
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
