"""The bytes of an MCAP file: the mcap package, which others wrote, is the judge."""

import struct
import zlib
from io import BytesIO
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader, make_reader
from mcap.records import Chunk, ChunkIndex, DataEnd, McapRecord, MessageIndex
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap_protobuf.decoder import DecoderFactory

from recorder.encoding.protobuf import descriptor_set
from recorder.mcap.framing import MAGIC, MESSAGE_HEADER
from recorder.mcap.writer import LogChannel, McapFile
from schemas.messages import Gear, GearPosition, RawSample
from tests.support.logs import Disk, sealed, small_log
from tests.support.messages import MS, WALL_NS

RECORD_HEADER = struct.Struct("<BQ")
U64 = st.integers(0, 2**63 - 1)
CHANNELS = [LogChannel(number, f"topic/{number}", "cruiser.Gear", descriptor_set(Gear)) for number in (1, 2, 3)]
CHUNKS = st.lists(
    st.lists(
        st.tuples(st.integers(1, 3), st.integers(0, 2**32 - 1), U64, U64, st.binary(max_size=30)), max_size=8
    ),
    max_size=5,
)


def write(chunks: list[list[tuple[int, int, int, int, bytes]]], disk: Disk | None = None) -> bytes:
    """A file with these chunks of messages."""
    disk = disk or Disk()
    file = McapFile(disk, "test")
    for channel in CHANNELS:
        file.add_channel(channel)
    for messages in chunks:
        if messages:
            file.write_chunk(sealed(messages))
    file.finish()
    return disk.getvalue()


def read_all(data: bytes) -> list[McapRecord]:
    """Every record outside the chunks."""
    return list(StreamReader(BytesIO(data), emit_chunks=True, validate_crcs=True).records)


@given(CHUNKS)
def test_every_reader_of_the_mcap_package_reads_all_messages(
    chunks: list[list[tuple[int, int, int, int, bytes]]],
) -> None:
    """By index and in one pass, checksums verified, in the order of the log times."""
    data = write(chunks)
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


def test_many_channels_at_once_are_those_that_come_one_by_one() -> None:
    """The same records in one write, each schema but once; those that came before count."""
    others = [
        LogChannel(7, "raw", "cruiser.RawSample", descriptor_set(RawSample)),
        LogChannel(8, "none", "", b"", schema_encoding="", message_encoding="json"),
    ]
    alone, together = Disk(), Disk()
    for disk in (alone, together):
        file = McapFile(disk, "test")
        file.add_channel(CHANNELS[0])
        file.add_channels([])
        if disk is alone:
            for channel in [*CHANNELS[1:], *others]:
                file.add_channel(channel)
        else:
            file.add_channels([*CHANNELS[1:], *others])
        file.add_channels(others[:0])
        file.finish()

    def found(disk: Disk) -> list[McapRecord]:
        return list(StreamReader(BytesIO(disk.getvalue())).records)

    assert found(alone)[:-3] == found(together)[:-3]
    summary = make_reader(BytesIO(together.getvalue()), validate_crcs=True).get_summary()
    assert summary is not None
    assert {number: channel.schema_id for number, channel in summary.channels.items()} == {
        1: 1,
        2: 1,
        3: 1,
        7: 2,
        8: 0,
    }
    assert [schema.name for schema in summary.schemas.values()] == ["cruiser.Gear", "cruiser.RawSample"]


@given(CHUNKS)
def test_statistics_and_indexes_say_what_is_there(chunks: list[list[tuple[int, int, int, int, bytes]]]) -> None:
    """Counts, times, and the place of every chunk and of every message in it."""
    data = write(chunks)
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
    """Follow a chunk's index into the file and into the chunk."""
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


def test_the_data_checksum_is_written_and_right() -> None:
    """It covers all up to the end of the data; a reader that verifies it would raise."""
    data = small_log()
    ends = [record for record in read_all(data) if isinstance(record, DataEnd)]
    assert len(ends) == 1
    place = data.index(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00" + ends[0].data_section_crc.to_bytes(4, "little"))
    assert ends[0].data_section_crc == zlib.crc32(data[:place]) != 0


def test_attachments_and_metadata_are_found_by_index() -> None:
    """Each index leads to its record, and the record is as it was given."""
    reader = SeekingReader(BytesIO(small_log()), validate_crcs=True)
    attachments = {one.name: one for one in reader.iter_attachments()}
    assert attachments["cruiser-1/cruiser-coarse.dbc"].data == b'VERSION "1"\n'
    assert attachments["cruiser-1/configuration.toml"].media_type == "application/toml"
    metadata = [one for one in reader.iter_metadata() if one.name == "cruiser"]
    assert metadata[-1].metadata["cruiser-1.variant"] == "coarse"
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.attachment_count == len(summary.attachment_indexes) == 4
    assert summary.statistics.metadata_count == len(summary.metadata_indexes)


def test_a_public_protobuf_reader_decodes_every_message() -> None:
    """Numbers come out as numbers, flags as flags, bytes as bytes: what a viewer plots."""
    reader = make_reader(BytesIO(small_log()), validate_crcs=True, decoder_factories=[DecoderFactory()])
    decoded: dict[str, list[Any]] = {}
    for schema, channel, message, content in reader.iter_decoded_messages():
        assert schema is not None
        assert channel.message_encoding == schema.encoding == "protobuf"
        assert message.log_time == WALL_NS
        decoded.setdefault(schema.name, []).append(content)
    assert [gear.sequence for gear in decoded["cruiser.Gear"]] == list(range(5))
    assert decoded["cruiser.Gear"][0].gear_position == list(GearPosition).index(GearPosition.DRIVE)
    frame = decoded["cruiser.CanFrame"][1]
    assert (frame.time_ns, frame.identifier, frame.is_extended) == (WALL_NS + 10 * MS, 0x18C4D1EF, True)
    assert isinstance(frame.data, bytes)
    assert decoded["cruiser.RawSample"][0].payload == b"hello"
    assert decoded["cruiser.GatewayInfo"][0].versions["cruiser-gateway"] == "0.1.0"


@given(st.integers(1, 64))
def test_a_stream_may_take_a_little_at_a_time(at_once: int) -> None:
    """Short writes are gone on with; nothing is lost or doubled."""
    chunks = [[(1, 1, 5, 5, b"one"), (2, 1, 4, 4, b"two")]]
    assert write(chunks, Disk(at_once=at_once)) == write(chunks)


def test_a_stream_that_takes_nothing_is_an_error() -> None:
    """Rather than waiting for ever."""
    with pytest.raises(OSError, match="takes no bytes"):
        McapFile(Disk(at_once=0), "test")


@given(st.data())
def test_after_a_full_disk_the_file_is_cut_back_to_whole_records(data: st.DataObject) -> None:
    """Whatever write fails, all chunks before it can be read, and no half record is left."""
    chunks = [[(1, number, number, number, bytes([number]) * 50)] for number in range(1, 8)]
    whole = write(chunks)
    header = len(write([])) - 100
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
    """After a failed sync the end may be asked for again; the file still has one summary and one footer."""
    stream = BytesIO()
    log = McapFile(stream, "test")
    log.finish()
    log.cut_back()
    log.finish()
    assert stream.getvalue().count(MAGIC) == 2
