"""The fast path into a chunk writes what the slow path writes."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.protobuf import compile_encoder
from recorder.encoding.routes import Latest, compile_adder
from recorder.encoding.samples import SEQUENCE_SPAN, KeyCounters
from recorder.mcap.writer import Chunk, ChunkBuilder
from schemas import codec
from schemas.messages import Gear, Message, RobotState
from schemas.subjects import SUBJECTS
from tests.support.messages import WALL_NS, gear
from tests.support.strategies import message_of

KINDS = [subject.type for subject in SUBJECTS]
CHANNEL = 7


def slow_path(messages: list[Message]) -> Chunk | None:
    chunk = ChunkBuilder()
    for number, message in enumerate(messages):
        data = compile_encoder(type(message))(message)
        chunk.add(CHANNEL, message.sequence, WALL_NS + number, message.time_ns, data)
    return chunk.seal()


@given(st.data())
def test_a_message_of_any_class_becomes_the_same_record(data: st.DataObject) -> None:
    """Byte for byte, index and counts included; the newest message is kept."""
    kind = data.draw(st.sampled_from(KINDS))
    first = data.draw(st.integers(0, SEQUENCE_SPAN - 10))
    drawn = data.draw(st.lists(message_of(kind), min_size=1, max_size=5))
    messages = [msgspec.structs.replace(one, sequence=first + number) for number, one in enumerate(drawn)]
    counters, chunk, latest = KeyCounters(), ChunkBuilder(), Latest()
    counters.next = first
    add = compile_adder(kind, counters, chunk, CHANNEL, latest)
    assert all(add(codec.encode(one), WALL_NS + number) for number, one in enumerate(messages))
    assert chunk.seal() == slow_path(messages)
    assert (counters.samples, counters.messages, counters.missed) == (len(messages), len(messages), 0)
    assert counters.next == first + len(messages)
    assert latest.message == codec.decode(
        next(one for one in SUBJECTS if one.type is kind), codec.encode(messages[-1])
    )
    assert latest.log_ns == WALL_NS + len(messages) - 1


@pytest.mark.parametrize("sequence", [0, 4, 6, SEQUENCE_SPAN - 1])
def test_what_does_not_follow_is_left_to_the_slow_path(sequence: int) -> None:
    """A gap, a repetition, a step back: nothing is written or counted."""
    counters, chunk = KeyCounters(), ChunkBuilder()
    counters.next = 5
    add = compile_adder(Gear, counters, chunk, CHANNEL, Latest())
    assert not add(codec.encode(gear(sequence)), WALL_NS)
    assert (len(chunk), counters.samples, counters.next) == (0, 0, 5)


def test_a_full_chunk_is_left_to_the_slow_path() -> None:
    """Which has it handed over."""
    counters, chunk = KeyCounters(), ChunkBuilder(1000)
    counters.next = 0
    add = compile_adder(Gear, counters, chunk, CHANNEL, Latest())
    count = next(number for number in range(1000) if not add(codec.encode(gear(number)), WALL_NS))
    assert chunk.is_full
    assert (counters.samples, counters.next) == (count, count)
    chunk.seal()
    assert add(codec.encode(gear(count)), WALL_NS)


@given(st.binary())
def test_what_cannot_be_decoded_leaves_no_trace(payload: bytes) -> None:
    """It raises, and the next sample is written as if it had not been."""
    counters, chunk = KeyCounters(), ChunkBuilder()
    counters.next = 1
    add = compile_adder(RobotState, counters, chunk, CHANNEL, Latest())
    with pytest.raises(msgspec.DecodeError):
        add(payload, WALL_NS)
    assert (len(chunk), dict(chunk.index), counters.samples, counters.next) == (0, {}, 0, 1)
