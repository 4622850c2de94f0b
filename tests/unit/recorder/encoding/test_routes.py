"""The fast paths into a chunk write the same as the slow one."""

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.protobuf import compile_encoder
from recorder.encoding.routes import Latest, can_adder, compile_adder, is_common, unfold
from recorder.encoding.samples import SEQUENCE_SPAN, KeyCounters
from recorder.mcap.writer import Chunk, ChunkBuilder
from schemas import codec
from schemas.can_word import ERROR, EXTENDED, IDENTIFIER_MASK, REMOTE
from schemas.messages import BUS_MAX_LENGTH, CanFrames, Gear, Message, RobotState
from schemas.subjects import BY_TYPE, SUBJECTS
from tests.support.messages import WALL_NS, batch, feedback, gear
from tests.support.strategies import TEXTS, message_of

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
    """Byte for byte, index and counts included."""
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
    counters, chunk = KeyCounters(), ChunkBuilder()
    counters.next = 5
    add = compile_adder(Gear, counters, chunk, CHANNEL, Latest())
    assert not add(codec.encode(gear(sequence)), WALL_NS)
    assert (len(chunk), counters.samples, counters.next) == (0, 0, 5)


def test_a_full_chunk_is_left_to_the_slow_path() -> None:
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
    counters, chunk = KeyCounters(), ChunkBuilder()
    counters.next = 1
    add = compile_adder(RobotState, counters, chunk, CHANNEL, Latest())
    with pytest.raises(msgspec.DecodeError):
        add(payload, WALL_NS)
    assert (len(chunk), dict(chunk.index), counters.samples, counters.next) == (0, {}, 0, 1)


CAN_CHANNEL = 300
TIMES = st.integers(0, 2**63 - 1)


@st.composite
def common_batches(draw: st.DrawFn) -> CanFrames:
    """Classic data frames of eight bytes with identifiers of one length."""
    frames = draw(st.lists(st.tuples(TIMES, st.integers(0, IDENTIFIER_MASK), st.binary(min_size=8, max_size=8))))
    flag = draw(st.sampled_from([0, EXTENDED]))
    marks = st.sampled_from([TEXTS, st.sampled_from(['\u0011"3DUfw', "can0"])])
    return CanFrames(
        time_ns=draw(TIMES),
        sequence=draw(st.integers(0, SEQUENCE_SPAN - 1)),
        bus=draw(draw(marks)),
        dropped=draw(st.integers(0, 10)),
        frame_time_ns=[time_ns for time_ns, _, _ in frames],
        can_id=[identifier | flag for _, identifier, _ in frames],
        fd_flags=[0] * len(frames),
        length=[8] * len(frames),
        data=[data for _, _, data in frames],
    )


def unfolded(message: CanFrames) -> Chunk | None:
    chunk = ChunkBuilder()
    for publish_ns, data in unfold(message):
        chunk.add(CAN_CHANNEL, message.sequence, WALL_NS, publish_ns, data)
    return chunk.seal()


def by_columns(message: CanFrames) -> tuple[bool, Chunk | None, KeyCounters]:
    counters, chunk = KeyCounters(), ChunkBuilder()
    counters.next = message.sequence
    added = can_adder(counters, chunk, CAN_CHANNEL)(codec.encode(message), WALL_NS)
    return added, chunk.seal(), counters


@given(common_batches())
def test_a_common_batch_becomes_the_same_records(message: CanFrames) -> None:
    """Byte for byte, index and counts included."""
    added, chunk, counters = by_columns(message)
    assert added
    assert chunk == unfolded(message)
    assert (counters.samples, counters.messages, counters.dropped) == (1, len(message.data), message.dropped)
    assert counters.next == (message.sequence + 1) % SEQUENCE_SPAN


@pytest.mark.parametrize(("limit_frames", "added"), [(9, [False, False]), (10, [True, False]), (11, [True, True])])
def test_what_fits_no_chunk_is_left_to_the_slow_path(limit_frames: int, added: list[bool]) -> None:
    message = batch(0, [(WALL_NS, feedback(number)) for number in range(10)])
    whole = unfolded(message)
    assert whole is not None
    counters, chunk = KeyCounters(), ChunkBuilder(len(whole.records) * limit_frames // 10)
    counters.next = 0
    add = can_adder(counters, chunk, CAN_CHANNEL)
    both = (message, msgspec.structs.replace(message, sequence=1))
    assert [add(codec.encode(one), WALL_NS) for one in both] == added
    assert (counters.samples, counters.messages) == (sum(added), 10 * sum(added))
    assert len(chunk) == len(whole.records) * sum(added)


@given(message_of(CanFrames))
def test_any_other_batch_is_left_to_the_slow_path(message: Any) -> None:  # noqa: ANN401 - drawn by its class
    added, chunk, _ = by_columns(message)
    assert added == is_common(message)
    assert chunk == (unfolded(message) if added else None)


def test_one_frame_of_another_form_sends_the_batch_down_the_slow_path() -> None:
    common = batch(0, [(WALL_NS + number, feedback(number)) for number in range(3)])
    word = common.can_id[0]
    assert is_common(common)
    for change in (
        {"can_id": [word, word | REMOTE, word]},
        {"can_id": [word | ERROR] * 3},
        {"can_id": [word, word & ~EXTENDED, word]},
        {"length": [8, 7, 8]},
        {"fd_flags": [0, 4, 0]},
        {"data": [*common.data[:2], b"seven.."]},
        {"data": common.data[:2]},
        {"frame_time_ns": common.frame_time_ns[:2]},
    ):
        other = msgspec.structs.replace(common, **change)
        assert by_columns(other)[:2] == (False, None), change


def test_a_bus_has_no_long_name() -> None:
    message = batch(0, [(WALL_NS, feedback(0))])
    for length, kind in ((BUS_MAX_LENGTH, CanFrames), (BUS_MAX_LENGTH + 1, codec.PayloadFault)):
        payload = codec.encode(msgspec.structs.replace(message, bus="b" * length))
        assert isinstance(codec.decode(BY_TYPE[CanFrames], payload), kind)
