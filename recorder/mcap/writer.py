"""The bytes of an MCAP file (https://mcap.dev/spec), on any binary stream.

Schemas and channels go into the data section itself, not into chunks: a damaged chunk then costs its own
messages and no others. What has no checksum in MCAP has a check of ours behind it. Each record, and each chunk
with its indexes, is one write; after a failed write ``cut_back`` takes the file to the end of its last whole
record.
"""

from __future__ import annotations

import errno
import hashlib
import zlib
from collections.abc import Iterable
from typing import Final, Protocol

import zstandard
from mcap import records

from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import Chunk
from recorder.mcap.framing import MAGIC, checked, encode, encode_indexes
from recorder.mcap.summary import Summary

COMPRESSION: Final = "zstd"
COMPRESSION_LEVEL: Final = 3
"""zstd's own default: full chunks are a tenth smaller than at its fastest level, and it runs beside the loop."""


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
        stream: the destination of the bytes, from its present beginning on.
        library: the writer's name, for the file's header.
        profile: the header's promise about the channels, by MCAP's registry; ours promise nothing.
    """

    def __init__(self, stream: LogStream, library: str, profile: str = "") -> None:
        self._is_finished = False
        self._stream = stream
        self._size = 0
        self._data_crc = 0
        self._sha256 = hashlib.sha256()
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        self._schemas: dict[tuple[str, str, bytes], records.Schema] = {}
        self._summary = Summary()
        self._write(MAGIC + checked(encode(records.Header(profile=profile, library=library))))

    @property
    def size(self) -> int:
        """Bytes of whole records so far."""
        return self._size

    @property
    def sha256(self) -> str:
        """SHA-256 of these bytes as they were given to the stream, hexadecimal."""
        return self._sha256.hexdigest()

    @property
    def messages(self) -> int:
        """Messages written so far."""
        return self._summary.messages

    def add_channel(self, channel: LogChannel) -> None:
        """Write a channel, and its schema unless that has been written."""
        self.add_channels([channel])

    def add_channels(self, channels: Iterable[LogChannel]) -> None:
        """Write channels, each with its schema unless that has been written, at once: there may be thousands."""
        channels = list(channels)
        data: list[bytes] = []
        encoded: list[bytes] = []
        new: dict[tuple[str, str, bytes], records.Schema] = {}
        for channel in channels:
            identity = channel.schema_name, channel.schema_encoding, channel.schema_data
            schema = self._schemas.get(identity) or new.get(identity)
            if schema is None and channel.has_schema:
                schema = new[identity] = records.Schema(
                    id=len(self._schemas) + len(new) + 1,
                    data=channel.schema_data,
                    encoding=channel.schema_encoding,
                    name=channel.schema_name,
                )
                data.append(checked(encode(schema)))
            one = encode(
                records.Channel(
                    id=channel.channel_id,
                    topic=channel.topic,
                    message_encoding=channel.message_encoding,
                    metadata=channel.metadata,
                    schema_id=0 if schema is None else schema.id,
                )
            )
            encoded.append(one)
            data.append(checked(one))
        self._write(b"".join(data))
        self._schemas |= new
        for schema in new.values():
            self._summary.add_schema(schema)
        self._summary.add_channels(encoded)

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
        self._write(data + encode_indexes(chunk.index))
        self._summary.add_chunk(record, start, len(data), chunk.index)

    def add_attachment(self, name: str, media_type: str, data: bytes, log_ns: int, create_ns: int = 0) -> None:
        """Write an attachment. That its time of creation is not known MCAP says with 0."""
        record = records.Attachment(
            create_time=create_ns, log_time=log_ns, name=name, media_type=media_type, data=data
        )
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
        if self._is_finished:
            return
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
        self._sha256.update(data)
        self._size += len(data)
