"""Messages in one buffer."""

from io import BytesIO

from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.records import Message

from recorder.mcap.writer import ChunkBuilder

U64 = st.integers(0, 2**64 - 1)
MESSAGES = st.lists(
    st.tuples(st.integers(1, 2**16 - 1), st.integers(0, 2**32 - 1), U64, U64, st.binary(max_size=40)), min_size=1
)


@given(MESSAGES)
def test_the_index_leads_to_every_message(messages: list[tuple[int, int, int, int, bytes]]) -> None:
    """At each offset of the index the mcap package reads the message that was added."""
    builder = ChunkBuilder()
    for message in messages:
        builder.add(*message)
    size = len(builder)
    chunk = builder.seal()
    assert chunk is not None
    assert len(chunk.records) == size
    assert (chunk.start_ns, chunk.end_ns) == (min(m[2] for m in messages), max(m[2] for m in messages))
    for channel_id, index in chunk.index.items():
        expected = [message for message in messages if message[0] == channel_id]
        for offset, log_ns, message in zip(index[1::2], index[::2], expected, strict=True):
            stream = ReadDataStream(BytesIO(chunk.records[offset:]))
            assert stream.read1() == 0x05
            read = Message.read(stream, stream.read8())
            assert log_ns == read.log_time
            assert (read.channel_id, read.sequence, read.log_time, read.publish_time, read.data) == message


def test_a_sealed_builder_begins_anew() -> None:
    """What was handed over is not handed over twice, and nothing makes no chunk."""
    builder = ChunkBuilder()
    assert builder.seal() is None
    builder.add(1, 1, 1, 1, b"one")
    first = builder.seal()
    assert builder.seal() is None
    builder.add(1, 2, 2, 2, b"two")
    assert first is not None
    assert b"two" not in first.records
