"""Raw frames that never came, by their alive counters."""

import cantools
import msgspec
import numpy as np
import pytest
from cantools.database.can import Database
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.frames import load
from recorder.encoding.protobuf import compile_encoder
from recorder.mcap.arrays import PADDING, Places
from recorder.review.checking import AliveCount, FrameCount, feedback_frames
from schemas.can_word import COUNTER_SPAN
from schemas.cruiser import DBC_FILES, dbc_text
from schemas.messages import CanFrame, Variant
from tests.support.messages import GEAR_FEEDBACK, MS, can_frame, feedback

PERIOD_NS = 10 * MS
GEAR = load(Variant.COARSE).messages["Auto_GearFeedBack"]


def gear_count() -> AliveCount:
    """The count of a frame of 10 ms."""
    return AliveCount(GEAR)


@pytest.mark.parametrize("variant", DBC_FILES)
def test_the_frames_and_their_periods_come_from_the_dbc(variant: Variant) -> None:
    """All that the chassis sends, none of the commands; a log of either variant is read by the same."""
    frames = feedback_frames()
    assert frames[GEAR_FEEDBACK] == GEAR
    database = cantools.database.load_string(dbc_text(variant), database_format="dbc")
    assert isinstance(database, Database)
    sent = [message for message in database.messages if message.senders == ["Chassis"]]
    assert {identifier: (frame.name, frame.period_ns) for identifier, frame in frames.items()} == {
        message.frame_id: (message.name, (message.cycle_time or 0) * MS) for message in sent
    }
    assert len(frames) == 10


@given(st.integers(0, 15), st.lists(st.booleans(), min_size=1, max_size=200))
def test_what_is_lost_is_counted_exactly_while_gaps_are_short(first: int, arrives: list[bool]) -> None:
    """Any pattern of losses without a gap of 16 periods."""
    count = gear_count()
    numbers = [0]
    for number, comes in enumerate(arrives, start=1):
        if comes or number - numbers[-1] == COUNTER_SPAN - 1:
            numbers.append(number)
    for number in numbers:
        count.receive(number * PERIOD_NS, feedback(first + number))
    assert (count.frames, count.lost) == (len(numbers), numbers[-1] + 1 - len(numbers))
    assert (count.repeated, count.corrupt, count.outages) == (0, 0, 0)


@pytest.mark.parametrize("gap", [16, 17, 100, 999])
@pytest.mark.parametrize("counter", range(COUNTER_SPAN))
def test_across_a_long_gap_the_counter_decides_and_the_period_only_says_how_often_it_went_round(
    gap: int, counter: int
) -> None:
    """Of all numbers that fit the counter, the one that is nearest to what the period says."""
    count = gear_count()
    count.receive(0, feedback(0))
    count.receive(gap * PERIOD_NS, feedback(counter))
    fitting = range((counter - 1) % COUNTER_SPAN, gap + COUNTER_SPAN, COUNTER_SPAN)
    nearest = min(abs(lost - (gap - 1)) for lost in fitting)
    lost = count.lost + count.unseen
    assert count.outages == 1
    assert lost in fitting
    assert abs(lost - (gap - 1)) == nearest


def test_a_step_back_of_the_clock_tells_nothing() -> None:
    """Neither does the counter: what was between the two is not known."""
    count = gear_count()
    count.receive(0, feedback(0))
    count.receive(-1, feedback(5))
    assert (count.outages, count.lost, count.unseen) == (1, 0, 0)


STALLS = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 120)), max_size=4)
"""When a machine stands still, and for how long, in periods."""


def arrivals(sent: list[int], stalls: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """When each of these frames is received, in order: what comes in a stall comes at its end, all at once."""
    received = []
    for number in sent:
        at = number
        for start, length in sorted(stalls):
            at = max(at, start + length) if start <= at else at
        received.append((at * PERIOD_NS, number))
    return received


@given(st.integers(0, 15), STALLS)
def test_frames_that_come_late_and_all_at_once_are_not_lost(first: int, stalls: list[tuple[int, int]]) -> None:
    """All are in the log, with an unbroken counter, whatever the times are."""
    count = gear_count()
    for time_ns, number in arrivals(list(range(600)), stalls):
        count.receive(time_ns, feedback(first + number))
    assert (count.frames, count.lost, count.unseen, count.repeated) == (600, 0, 0, 0)


@given(STALLS, st.integers(20, 300), st.integers(0, 200))
def test_lost_frames_are_counted_as_often_as_the_counter_went_round(
    stalls: list[tuple[int, int]], start: int, length: int
) -> None:
    """A true loss is told, though frames before and behind it came late; the one right before it came in time."""
    count = gear_count()
    sent = [number for number in range(1000) if not start <= number < start + length]
    apart = [(at, stall) for at, stall in stalls if at + stall < start or at >= start + length]
    for time_ns, number in arrivals(sent, apart):
        count.receive(time_ns, feedback(number))
    assert count.lost + count.unseen == length


def test_a_repeated_counter_is_no_loss() -> None:
    """It is told apart from fifteen lost frames."""
    count = gear_count()
    count.receive(0, feedback(3))
    count.receive(PERIOD_NS, feedback(3))
    assert (count.repeated, count.lost) == (1, 0)


def test_the_counter_of_a_corrupt_frame_is_not_read() -> None:
    """It counts as the one that was due."""
    count = gear_count()
    corrupt = bytearray(feedback(1))
    corrupt[6] ^= 0x70
    for number, data in enumerate((feedback(0), bytes(corrupt), feedback(2))):
        count.receive(number * PERIOD_NS, data)
    assert (count.corrupt, count.lost, count.repeated) == (1, 0, 0)


@given(st.integers(0, 15), st.integers(0, 400))
def test_what_came_between_two_gateways_is_not_counted(counter: int, periods: int) -> None:
    """Whatever the counter is then; a gap of before is judged with what had come."""
    count = gear_count()
    for number in (0, 1, 2, 40, 41):
        count.receive(number * PERIOD_NS, feedback(number))
    lost = count.lost + count.unseen
    assert lost == 37
    count.restart()
    count.receive((41 + periods) * PERIOD_NS, feedback(counter))
    assert (count.lost + count.unseen, count.outages, count.repeated, count.frames) == (lost, 1, 0, 6)


ENCODE = compile_encoder(CanFrame)
DRIVE_FEEDBACK = 0x18C4D3EF


def frame(number: int, identifier: int = GEAR_FEEDBACK, data: bytes | None = None, bus: str = "can0") -> CanFrame:
    """A frame of so many periods after the first."""
    made = can_frame(identifier, 10 * MS * number, feedback(number) if data is None else data)
    return msgspec.structs.replace(made, bus=bus)


def take(count: FrameCount, records: list[bytes]) -> list[int]:
    """What is no frame among these messages, which stand one behind the other."""
    lengths = np.array([len(one) for one in records], np.int64)
    content = np.frombuffer(b"".join(records) + bytes(PADDING), np.uint8)
    return count.take(content, Places(np.cumsum(lengths) - lengths, lengths))


def counts(*batches: list[CanFrame]) -> list[tuple[object, ...]]:
    """What is counted of frames that come in these batches."""
    count = FrameCount()
    for batch in batches:
        assert take(count, [ENCODE(one) for one in batch]) == []
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
            data = np.frombuffer(b"".join(feedback(counter) for _, counter in part), np.uint8).reshape(-1, 8)
            many.receive_many(np.array([time_ns for time_ns, _ in part]), data)
    assert vars(one._rounds) == vars(many._rounds)
    assert vars(one) | {"_rounds": None} == vars(many) | {"_rounds": None}


def test_a_long_gap_between_regular_frames_is_an_outage() -> None:
    """Though the counters go on as they should."""
    frames = [frame(number) for number in (0, 1, 2, 35, 36, 37)]
    [(*_, lost, repeated, corrupt, outages, unseen)] = counts(frames[:1], frames[1:])
    assert (lost, repeated, corrupt, outages, unseen) == (0, 0, 0, 1, 32)


def test_records_that_are_no_frames_are_told() -> None:
    """By their places; the others count."""
    count = FrameCount()
    good = ENCODE(frame(0))
    assert take(count, [good, b"\xff", ENCODE(frame(1)), b"\x0f" * len(good)]) == [1, 3]
    assert count.info("t")[0].frames == 2
