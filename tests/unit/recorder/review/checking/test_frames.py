"""Raw frames that never came."""

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.transcode import compile_encoder
from recorder.review.checking.alive import AliveCount, feedback_frames
from recorder.review.checking.frames import FrameCount
from schemas.messages import CanFrame
from tests.support.messages import GEAR_FEEDBACK, MS, can_frame, feedback

ENCODE = compile_encoder(CanFrame)
DRIVE_FEEDBACK = 0x18C4D3EF


def frame(number: int, identifier: int = GEAR_FEEDBACK, data: bytes | None = None, bus: str = "can0") -> CanFrame:
    """A frame of so many periods after the first."""
    made = can_frame(identifier, 10 * MS * number, feedback(number) if data is None else data)
    return msgspec.structs.replace(made, bus=bus)


def counts(*batches: list[CanFrame]) -> list[tuple[object, ...]]:
    """What is counted of frames that come in these batches."""
    count = FrameCount()
    for batch in batches:
        assert count.take([ENCODE(one) for one in batch]) == []
    return [msgspec.structs.astuple(one) for one in count.info("t")]


FRAMES = st.builds(
    frame,
    st.integers(0, 60),
    st.sampled_from([GEAR_FEEDBACK, DRIVE_FEEDBACK, 0x123]),
    st.sampled_from([None, None, None, None, bytes(8), b"\x01" + bytes(7), b"\x01", b""]),
    st.sampled_from(["can0", "can0", "can0", "b"]),
)


@given(st.lists(st.lists(FRAMES, min_size=1, max_size=20), max_size=5))
def test_many_at_once_count_as_each_by_itself(batches: list[list[CanFrame]]) -> None:
    """In any order, corrupt ones among them, of any length and bus."""
    assert counts(*batches) == counts(*([one] for batch in batches for one in batch))


@given(st.lists(st.tuples(st.integers(0, 400), st.integers(0, 15)), min_size=1, max_size=40), st.booleans())
def test_counters_in_bulk_count_as_one_by_one(steps: list[tuple[int, int]], is_regular: bool) -> None:  # noqa: FBT001 - drawn
    """With gaps, repetitions and steps back of the clock."""
    one, many = (AliveCount(feedback_frames()[GEAR_FEEDBACK]) for _ in range(2))
    frames = [
        (number * 10 * MS, number % 16) if is_regular else (10 * MS * place, counter)
        for number, (place, counter) in enumerate(steps)
    ]
    for time_ns, counter in frames:
        one.receive(time_ns, feedback(counter))
    middle = len(frames) // 2
    for part in (frames[:middle], frames[middle:]):
        if part:
            many.receive_many([time_ns for time_ns, _ in part], bytes(counter << 4 | 3 for _, counter in part))
    assert vars(one._rounds) == vars(many._rounds)
    assert vars(one) | {"_rounds": None} == vars(many) | {"_rounds": None}


def test_a_long_gap_between_regular_frames_is_an_outage() -> None:
    """Though the counters go on as they should."""
    frames = [frame(number) for number in (0, 1, 2, 35, 36, 37)]
    [(*_, lost, repeated, corrupt, outages, unseen)] = counts(frames[:1], frames[1:])
    assert (lost, repeated, corrupt, outages, unseen) == (0, 0, 0, 1, 32)


def test_a_corrupt_frame_among_many_is_counted() -> None:
    """And its counter is not read."""
    frames = [frame(number) for number in range(10)]
    frames[4] = frame(4, data=b"\x09" + feedback(4)[1:])
    [(*_, count, lost, _, corrupt, _, _)] = counts(frames)
    assert (count, lost, corrupt) == (10, 0, 1)


def test_records_that_are_no_frames_are_told() -> None:
    """By their places; the others count."""
    count = FrameCount()
    good = ENCODE(frame(0))
    assert count.take([good, b"\xff", ENCODE(frame(1)), b"\x0f" * len(good)]) == [1, 3]
    assert count.info("t")[0].frames == 2
