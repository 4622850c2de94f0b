"""The messages of many blocks at once."""

from array import array

from hypothesis import given
from hypothesis import strategies as st

from recorder.mcap.arrays import Blocks, Read
from recorder.mcap.pieces import Index, MessageBlock
from recorder.mcap.writer import ChunkBuilder

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
    builder = ChunkBuilder()
    for message in messages:
        builder.add(*message)
    return bytes(builder.records), dict(builder.index)


def read(*chunks: tuple[bytes, Index | None]) -> Read:
    blocks = Blocks()
    for content, index in chunks:
        blocks.add(MessageBlock(0, content), index)
    return blocks.read()


def rows(found: Read) -> list[tuple[object, ...]]:
    content = found.content
    return [
        (channel, *fields, content[start : start + length].tobytes())
        for channel, places in sorted(found.places.items())
        for start, length, *fields in zip(
            places.offsets.tolist(),
            places.lengths.tolist(),
            places.sequences(content).tolist(),
            places.log_ns(content).tolist(),
            places.publish_ns(content).tolist(),
            strict=True,
        )
    ]


@given(st.lists(MESSAGES, min_size=1, max_size=4), st.randoms())
def test_all_fields_of_all_messages_come_back(
    chunks: list[list[tuple[int, int, int, int, bytes]]], random: object
) -> None:
    expected = sorted((one for chunk in chunks for one in chunk), key=lambda one: one[0])
    parts = [packed(chunk) for chunk in chunks]
    singles = [(packed([one])[0], None) for chunk in chunks for one in chunk]
    mixed = [
        part
        for chunk in chunks
        for part in random.choice(  # type: ignore[attr-defined]  # Hypothesis's Random
            [[packed(chunk)], [(packed(chunk)[0], None)], [(packed([one])[0], None) for one in chunk]]
        )
    ]
    for given_parts in (parts, [(content, None) for content, _ in parts], singles, mixed):
        found = read(*given_parts)
        assert (rows(found), found.others, found.wrong) == (expected, [], [])


@given(MESSAGES, st.integers(0, 10_000), st.integers(1, 255))
def test_nothing_false_is_taken_for_proven(
    messages: list[tuple[int, int, int, int, bytes]], place: int, flip: int
) -> None:
    content, index = packed(messages)
    damaged = bytearray(content)
    damaged[place % len(content)] ^= flip
    assert rows(read((bytes(damaged), index))) == rows(read((bytes(damaged), None)))


@given(MESSAGES, st.integers(0, 10_000), st.integers(0, 100))
def test_a_wrong_index_is_found_out_and_costs_nothing(
    messages: list[tuple[int, int, int, int, bytes]], place: int, value: int
) -> None:
    content, index = packed(messages)
    flat = [(channel_id, at) for channel_id, entries in index.items() for at in range(len(entries))]
    channel_id, at = flat[place % len(flat)]
    before, index[channel_id][at] = index[channel_id][at], value
    found = read(packed(messages), (content, index), packed(messages))
    assert found.wrong == ([] if before == value else [1])
    assert rows(found) == rows(read(*[packed(messages)] * 3))
