"""The bytes of an MCAP file (https://mcap.dev/spec), on any binary stream.

Schemas and channels go into the data section itself, not into chunks: a damaged chunk then costs its own
messages and no others. What has no checksum in MCAP has a check of ours behind it. Each record, and each chunk
with its indexes, is one write; after a failed write ``cut_back`` takes the file to the end of its last whole
record.
"""

from __future__ import annotations

import errno
import zlib
from typing import Final, Protocol

import zstandard
from mcap import records

from recorder.chunk import Chunk
from recorder.effects import LogChannel
from recorder.mcap_summary import MAGIC, Summary, checked, encode, encode_index

COMPRESSION: Final = "zstd"
COMPRESSION_LEVEL: Final = 3
"""zstd's own default: full chunks are a tenth smaller than at its fastest level, and it runs beside the loop."""

SCHEMA_ENCODING: Final = "protobuf"
MESSAGE_ENCODING: Final = "protobuf"


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
        self._summary = Summary()
        self._write(MAGIC + checked(encode(records.Header(profile="", library=library))))

    @property
    def size(self) -> int:
        """Bytes of whole records so far."""
        return self._size

    @property
    def messages(self) -> int:
        """Messages written so far."""
        return self._summary.messages

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
            data = checked(encode(schema))
        record = records.Channel(
            id=channel.channel_id,
            topic=channel.topic,
            message_encoding=MESSAGE_ENCODING,
            metadata={},
            schema_id=schema.id,
        )
        self._write(data + checked(encode(record)))
        if data:
            self._schemas[schema.name] = schema
            self._summary.add_schema(schema)
        self._summary.add_channel(record)

    def write_chunk(self, chunk: Chunk) -> None:
        """Compress and write messages, with an index per channel."""
        record = records.Chunk(
            compression=COMPRESSION,
            data=self._compressor.compress(chunk.records),
            message_start_time=chunk.start_ns,
            message_end_time=chunk.end_ns,
            uncompressed_crc=zlib.crc32(chunk.records),
            uncompressed_size=len(chunk.records),
        )
        data, start = encode(record), self._size
        indexes = [encode_index(channel_id, entries) for channel_id, entries in chunk.index.items()]
        self._write(b"".join([data, *indexes]))
        self._summary.add_chunk(record, start, len(data), chunk.index)

    def add_attachment(self, name: str, media_type: str, data: bytes, log_ns: int) -> None:
        """Write an attachment. Its time of creation is not known, which MCAP says with 0."""
        record = records.Attachment(create_time=0, log_time=log_ns, name=name, media_type=media_type, data=data)
        encoded, start = encode(record), self._size
        self._write(checked(encoded))
        self._summary.add_attachment(record, start, len(encoded))

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Write a metadata record."""
        record = records.Metadata(name=name, metadata=entries)
        encoded, start = encode(record), self._size
        self._write(checked(encoded))
        self._summary.add_metadata(record, start, len(encoded))

    def finish(self) -> None:
        """Write what makes the file whole: the end of the data, the summary and the footer; but once."""
        if not self._is_finished:
            self._write(self._summary.ending(self._size, self._data_crc))
            self._is_finished = True

    def cut_back(self) -> None:
        """After a failed write: take the stream back to the end of the last whole record.

        Raises:
            OSError: the stream cannot even be cut.
        """
        self._stream.seek(self._size)
        self._stream.truncate()

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            taken = self._stream.write(view)
            if not taken:
                raise OSError(errno.EAGAIN, "the stream takes no bytes")
            view = view[taken:]
        self._data_crc = zlib.crc32(data, self._data_crc)
        self._size += len(data)
