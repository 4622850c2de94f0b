"""Frames lost, by their alive counters."""

import cantools
import pytest
from cantools.database.can import Database
from hypothesis import given
from hypothesis import strategies as st

from recorder.review.alive import COUNTER_SPAN, AliveCount, feedback_frames
from schemas.can_word import EXTENDED
from schemas.dbc_files import DBC_FILES, DbcFrame, dbc_text
from schemas.messages import Variant
from tests.recorder.fakes import GEAR_FEEDBACK, MS, feedback

PERIOD_NS = 10 * MS
GEAR = DbcFrame(EXTENDED | GEAR_FEEDBACK, "Auto_GearFeedBack", "Chassis", PERIOD_NS)


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


@pytest.mark.parametrize(
    ("gap_ns", "unseen"), [(COUNTER_SPAN * PERIOD_NS, COUNTER_SPAN - 1), (100 * PERIOD_NS, 99), (-1, 0)]
)
def test_a_gap_too_long_for_the_counter_is_an_outage(gap_ns: int, unseen: int) -> None:
    """The period tells what it cost; a step back of the clock is one too, and tells nothing."""
    count = gear_count()
    count.receive(0, feedback(0))
    count.receive(gap_ns, feedback(5))
    assert (count.outages, count.lost, count.unseen) == (1, 0, unseen)


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
