"""The bytes of an MCAP file (https://mcap.dev/spec), on any binary stream.

Schemas and channels go into the data section itself, not into chunks: a damaged chunk then costs its own
messages and no others. Each record, and each chunk with its indexes, is one write; after a failed write
``cut_back`` takes the file to the end of its last whole record.
"""

from __future__ import annotations

import errno
import struct
import sys
import zlib
from array import array
from collections import Counter
from typing import Final, Protocol, cast

import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from recorder.chunk import Chunk
from recorder.effects import LogChannel

MAGIC: Final = b"\x89MCAP0\r\n"
COMPRESSION: Final = "zstd"
COMPRESSION_LEVEL: Final = 1
"""zstd's fastest ordinary level: within a few per cent of the default's size on these records."""

SCHEMA_ENCODING: Final = "protobuf"
MESSAGE_ENCODING: Final = "protobuf"

_RECORD_HEADER: Final = struct.Struct("<BQ")
_INDEX_HEADER: Final = struct.Struct("<BQHI")


_SUMMARY_ORDER: Final = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)


class LogStream(Protocol):
    """A binary stream, buffered or not: ``write`` may take less than it is given."""

    def write(self, data: memoryview, /) -> int | None:
        """Write some of the data; returns how many bytes, or None if none could be."""
        ...

    def seek(self, offset: int, /) -> int:
        """Go to an offset."""
        ...

    def truncate(self) -> int:
        """End the stream here."""
        ...


class _Group:
    """Records of one kind that the summary will hold."""

    def __init__(self) -> None:
        self.encoded = bytearray()
        self.count = 0

    def add(self, record: records.McapRecord) -> None:
        self.encoded += _encode(record)
        self.count += 1


class McapFile:
    """An MCAP file that is being written.

    Args:
        stream: where the bytes go, from its present beginning on.
        library: who writes, for the file's header.
    """

    def __init__(self, stream: LogStream, library: str) -> None:
        self._is_finished = False
        self._stream = stream
        self._size = 0
        self._data_crc = 0
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        self._schemas: dict[str, records.Schema] = {}
        self._counts: Counter[int] = Counter()
        self._start_ns: int | None = None
        self._end_ns = 0
        # What the summary repeats, in its order; kept as bytes, for a long log has many.
        self._groups = {opcode: _Group() for opcode in _SUMMARY_ORDER}
        self._write(MAGIC + _encode(records.Header(profile="", library=library)))

    @property
    def size(self) -> int:
        """Bytes of whole records so far."""
        return self._size

    @property
    def messages(self) -> int:
        """Messages written so far."""
        return self._counts.total()

    def add_channel(self, channel: LogChannel) -> None:
        """Write a channel, and its schema if it is the first of that name."""
        data = b""
        schema = self._schemas.get(channel.schema_name)
        if schema is None:
            schema = records.Schema(
                id=len(self._schemas) + 1,
                data=channel.schema_data,
                encoding=SCHEMA_ENCODING,
                name=channel.schema_name,
            )
            data = _encode(schema)
        record = records.Channel(
            id=channel.channel_id,
            topic=channel.topic,
            message_encoding=MESSAGE_ENCODING,
            metadata={},
            schema_id=schema.id,
        )
        self._write(data + _encode(record))
        if data:
            self._schemas[schema.name] = schema
            self._groups[Opcode.SCHEMA].add(schema)
        self._groups[Opcode.CHANNEL].add(record)

    def write_chunk(self, chunk: Chunk) -> None:
        """Compress and write messages, with an index per channel."""
        compressed = self._compressor.compress(chunk.records)
        record = _encode(
            records.Chunk(
                compression=COMPRESSION,
                data=compressed,
                message_start_time=chunk.start_ns,
                message_end_time=chunk.end_ns,
                uncompressed_crc=zlib.crc32(chunk.records),
                uncompressed_size=len(chunk.records),
            )
        )
        parts = [record]
        offsets: dict[int, int] = {}
        end = self._size + len(record)
        for channel_id, entries in chunk.index.items():
            offsets[channel_id] = end
            part = _encode_index(channel_id, entries)
            parts.append(part)
            end += len(part)
        start = self._size
        self._write(b"".join(parts))
        self._counts.update({channel_id: len(entries) // 2 for channel_id, entries in chunk.index.items()})
        self._start_ns = chunk.start_ns if self._start_ns is None else min(self._start_ns, chunk.start_ns)
        self._end_ns = max(self._end_ns, chunk.end_ns)
        self._groups[Opcode.CHUNK_INDEX].add(
            records.ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=start,
                compression=COMPRESSION,
                compressed_size=len(compressed),
                message_end_time=chunk.end_ns,
                message_index_length=end - start - len(record),
                message_index_offsets=offsets,
                message_start_time=chunk.start_ns,
                uncompressed_size=len(chunk.records),
            )
        )

    def add_attachment(self, name: str, media_type: str, data: bytes, log_ns: int) -> None:
        """Write an attachment. Its time of creation is not known, which MCAP says with 0."""
        record = _encode(
            records.Attachment(create_time=0, log_time=log_ns, name=name, media_type=media_type, data=data)
        )
        index = records.AttachmentIndex(
            offset=self._size,
            length=len(record),
            log_time=log_ns,
            create_time=0,
            data_size=len(data),
            name=name,
            media_type=media_type,
        )
        self._write(record)
        self._groups[Opcode.ATTACHMENT_INDEX].add(index)

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Write a metadata record."""
        record = _encode(records.Metadata(name=name, metadata=entries))
        index = records.MetadataIndex(offset=self._size, length=len(record), name=name)
        self._write(record)
        self._groups[Opcode.METADATA_INDEX].add(index)

    def finish(self) -> None:
        """Write what makes the file whole: the end of the data, the summary and the footer; but once."""
        if self._is_finished:
            return
        data_end = _encode(records.DataEnd(self._data_crc))
        start = self._size + len(data_end)
        self._groups[Opcode.STATISTICS] = _Group()
        self._groups[Opcode.STATISTICS].add(self._statistics())
        summary, offsets = bytearray(), bytearray()
        for opcode, group in self._groups.items():
            if group.count:
                offset = records.SummaryOffset(
                    group_opcode=opcode, group_start=start + len(summary), group_length=len(group.encoded)
                )
                offsets += _encode(offset)
                summary += group.encoded
        offset_start = start + len(summary)
        summary += offsets
        # The summary's checksum covers the footer too, up to the checksum itself.
        footer = _RECORD_HEADER.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, offset_start)
        crc = zlib.crc32(footer, zlib.crc32(summary))
        self._write(data_end + summary + footer + struct.pack("<I", crc) + MAGIC)
        self._is_finished = True

    def cut_back(self) -> None:
        """After a failed write: take the stream back to the end of the last whole record.

        Raises:
            OSError: the stream cannot even be cut.
        """
        self._stream.seek(self._size)
        self._stream.truncate()

    def _statistics(self) -> records.Statistics:
        return records.Statistics(
            attachment_count=self._groups[Opcode.ATTACHMENT_INDEX].count,
            channel_count=self._groups[Opcode.CHANNEL].count,
            channel_message_counts=dict(self._counts),
            chunk_count=self._groups[Opcode.CHUNK_INDEX].count,
            message_count=self.messages,
            message_end_time=self._end_ns,
            message_start_time=self._start_ns or 0,
            metadata_count=self._groups[Opcode.METADATA_INDEX].count,
            schema_count=self._groups[Opcode.SCHEMA].count,
        )

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            taken = self._stream.write(view)
            if not taken:
                raise OSError(errno.EAGAIN, "the stream takes no bytes")
            view = view[taken:]
        self._data_crc = zlib.crc32(data, self._data_crc)
        self._size += len(data)


def _encode(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return cast("bytes", builder.end())


def _encode_index(channel_id: int, entries: array[int]) -> bytes:
    if sys.byteorder == "big":
        entries = entries[:]
        entries.byteswap()
    data = entries.tobytes()
    return _INDEX_HEADER.pack(Opcode.MESSAGE_INDEX, 6 + len(data), channel_id, len(data)) + data
