"""The bytes of an MCAP file, judged by the independent mcap package."""

import struct
from io import BytesIO
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader, make_reader
from mcap.records import Chunk, ChunkIndex, MessageIndex
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from recorder.encoding.protobuf import descriptor_set
from recorder.mcap.framing import MAGIC, MESSAGE_HEADER
from recorder.mcap.writer import LogChannel, McapFile
from schemas.messages import Gear
from tests.support.logs import Disk, mcap_log, sealed

RECORD_HEADER = struct.Struct("<BQ")
U64 = st.integers(0, 2**63 - 1)
CHANNELS = [LogChannel(number, f"topic/{number}", "cruiser.Gear", descriptor_set(Gear)) for number in (1, 2, 3)]
CHUNKS = st.lists(
    st.lists(
        st.tuples(st.integers(1, 3), st.integers(0, 2**32 - 1), U64, U64, st.binary(max_size=30)), max_size=8
    ),
    max_size=5,
)


@given(CHUNKS)
def test_every_reader_of_the_mcap_package_reads_all_messages(
    chunks: list[list[tuple[int, int, int, int, bytes]]],
) -> None:
    data = mcap_log(CHANNELS, chunks)
    expected = sorted(message for messages in chunks for message in messages)
    for reader in (
        make_reader(BytesIO(data), validate_crcs=True),
        SeekingReader(BytesIO(data), validate_crcs=True),
        NonSeekingReader(BytesIO(data), validate_crcs=True),
    ):
        read = [message for _, _, message in reader.iter_messages()]
        assert [message.log_time for message in read] == sorted(message.log_time for message in read)
        assert expected == sorted(
            (one.channel_id, one.sequence, one.log_time, one.publish_time, one.data) for one in read
        )


@given(CHUNKS)
def test_statistics_and_indexes_say_what_is_there(chunks: list[list[tuple[int, int, int, int, bytes]]]) -> None:
    data = mcap_log(CHANNELS, chunks)
    summary = SeekingReader(BytesIO(data), validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    messages = [message for one in chunks for message in one]
    times = [message[2] for message in messages]
    assert summary.statistics.message_count == len(messages)
    assert summary.statistics.message_start_time == min(times, default=0)
    assert summary.statistics.message_end_time == max(times, default=0)
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) == len([one for one in chunks if one])
    assert (summary.statistics.schema_count, summary.statistics.channel_count) == (1, 3)
    for number in (1, 2, 3):
        counted = summary.statistics.channel_message_counts.get(number, 0)
        assert counted == sum(message[0] == number for message in messages)
    for index in summary.chunk_indexes:
        _check_chunk(data, index)


def _check_chunk(data: bytes, index: ChunkIndex) -> None:
    chunk = _record_at(data, index.chunk_start_offset, Chunk)
    assert (chunk.message_start_time, chunk.message_end_time) == (index.message_start_time, index.message_end_time)
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    content = stream.read(length)
    end = index.chunk_start_offset + index.chunk_length
    # The index says where the message indexes are; the file says what really stands behind the chunk.
    place, found_at = end, []
    while data[place] == Opcode.MESSAGE_INDEX:
        found_at.append(place)
        place += RECORD_HEADER.size + RECORD_HEADER.unpack_from(data, place)[1]
    assert index.message_index_length == place - end > 0
    assert sorted(index.message_index_offsets.values()) == found_at
    for channel_id, offset in index.message_index_offsets.items():
        entries = _record_at(data, offset, MessageIndex)
        assert entries.channel_id == channel_id
        for log_ns, place in entries.records:
            _, _, found, _, found_ns, _ = MESSAGE_HEADER.unpack_from(content, place)
            assert (found, found_ns) == (channel_id, log_ns)


def _record_at(data: bytes, offset: int, kind: type[Any]) -> Any:  # noqa: ANN401 - whichever kind is asked for
    record = next(iter(StreamReader(BytesIO(data[offset:]), skip_magic=True, emit_chunks=True).records))
    assert isinstance(record, kind)
    return record


@given(st.integers(1, 64))
def test_a_stream_may_take_a_little_at_a_time(at_once: int) -> None:
    chunks = [[(1, 1, 5, 5, b"one"), (2, 1, 4, 4, b"two")]]
    assert mcap_log(CHANNELS, chunks, disk=Disk(at_once=at_once)) == mcap_log(CHANNELS, chunks)


def test_a_stream_that_takes_nothing_is_an_error() -> None:
    with pytest.raises(OSError, match="accepts no bytes"):
        McapFile(Disk(at_once=0), "test")


@given(st.data())
def test_after_a_full_disk_the_file_is_cut_back_to_whole_records(data: st.DataObject) -> None:
    chunks = [[(1, number, number, number, bytes([number]) * 50)] for number in range(1, 8)]
    whole = mcap_log(CHANNELS, chunks)
    header = len(mcap_log(CHANNELS, [])) - 100
    disk = Disk(room=data.draw(st.integers(header, len(whole) - 1)))
    written = 0
    file = McapFile(disk, "test")
    try:
        for channel in CHANNELS:
            file.add_channel(channel)
        for messages in chunks:
            file.write_chunk(sealed(messages))
            written += 1
        file.finish()
    except OSError:
        file.cut_back()
    assert len(disk.getvalue()) == file.size
    assert file.messages == written
    disk.room = None
    file.finish()
    read = [message for _, _, message in make_reader(BytesIO(disk.getvalue()), validate_crcs=True).iter_messages()]
    assert [message.sequence for message in read] == list(range(1, written + 1))


def test_a_file_is_finished_once() -> None:
    stream = BytesIO()
    log = McapFile(stream, "test")
    log.finish()
    log.cut_back()
    log.finish()
    assert stream.getvalue().count(MAGIC) == 2
