"""The messages of a chunk, many at once."""

from array import array
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from recorder.mcap.chunk import ChunkBuilder
from recorder.mcap.columns import unpack_at, unpack_indexed
from recorder.mcap.framing import MESSAGE_HEADER
from recorder.mcap.pieces import index_content

MESSAGES = st.lists(
    st.tuples(
        st.integers(1, 3) | st.integers(0, 2**16 - 1),
        st.integers(0, 2**32 - 1),
        st.integers(0, 2**64 - 1),
        st.integers(0, 2**64 - 1),
        st.binary(max_size=20),
    ),
    min_size=1,
    max_size=30,
)


def packed(messages: list[tuple[int, int, int, int, bytes]]) -> tuple[bytes, dict[int, "array[int]"]]:
    """The records and the index of a chunk."""
    builder = ChunkBuilder()
    for message in messages:
        builder.add(*message)
    return bytes(builder.records), dict(builder.index)


@given(MESSAGES)
def test_all_fields_of_all_messages_come_back(messages: list[tuple[int, int, int, int, bytes]]) -> None:
    """By channel, in the order of the chunk; found by the index or one by one."""
    content, index = packed(messages)
    found = unpack_indexed(content, index)
    assert found is not None
    assert found == unpack_at(content, sorted(start for entries in index.values() for start in entries[1::2]))
    assert found.is_indexed(index)
    for one in found.by_channel:
        rows = zip(one.sequences, one.log_ns, one.publish_ns, one.datas, strict=True)
        assert list(rows) == [message[1:] for message in messages if message[0] == one.channel_id]
    times = [message[2] for message in messages]
    assert (found.start_ns, found.end_ns, found.first_ns, found.last_ns) == (
        min(times),
        max(times),
        times[0],
        times[-1],
    )
    assert found.backwards == sum(after < before for before, after in pairwise(times))


@given(MESSAGES, st.integers(0, 10_000), st.integers(1, 255))
def test_nothing_false_is_taken_for_proven(
    messages: list[tuple[int, int, int, int, bytes]], place: int, flip: int
) -> None:
    """A byte changed: what is unpacked by the index is what a walk over the records finds, or nothing."""
    content, index = packed(messages)
    damaged = bytearray(content)
    damaged[place % len(content)] ^= flip
    found = unpack_indexed(bytes(damaged), index)
    if found is not None:
        true, _ = index_content(bytes(damaged))
        assert found.is_indexed(true)


@given(MESSAGES, st.integers(0, 10_000), st.integers(0, 100))
def test_a_wrong_index_is_no_index(
    messages: list[tuple[int, int, int, int, bytes]], place: int, value: int
) -> None:
    """One entry changed."""
    content, index = packed(messages)
    flat = [(channel_id, at) for channel_id, entries in index.items() for at in range(len(entries))]
    channel_id, at = flat[place % len(flat)]
    if index[channel_id][at] != value:
        index[channel_id][at] = value
        found = unpack_indexed(content, index)
        assert found is None or not found.is_indexed(index)


def test_a_record_that_says_it_is_longer_is_seen() -> None:
    """Though the index fits all the same."""
    content, index = packed([(1, 0, 1, 1, b"abc"), (1, 1, 2, 2, b"abc")])
    damaged = bytearray(content)
    damaged[1] += 1
    assert unpack_indexed(content, index) is not None
    assert unpack_indexed(bytes(damaged), index) is None
    assert MESSAGE_HEADER.unpack_from(damaged)[1] == MESSAGE_HEADER.unpack_from(content)[1] + 1
