"""Write an MCAP file (https://mcap.dev/spec) on any binary stream: channels, chunks, the summary at its end.

Schemas and channels go into the data section, not into chunks, so that a damaged chunk costs only its own
messages. A record without a checksum in MCAP is followed by a check of our own. Each record, and each chunk with
its indexes, is one write; after a failed write ``cut_back`` shortens the file to its last whole record.

The summary grows as bytes with the file, because a long log has many chunks. Recovery uses it too.
"""

from __future__ import annotations

import errno
import hashlib
import re
import zlib
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Protocol

import msgspec
import zstandard
from mcap import records
from mcap.opcode import Opcode

from recorder.mcap.framing import (
    FOOTER,
    HEAD_FORMAT,
    HEADER_IN_LENGTH,
    INDEX_HEADER,
    MAGIC,
    MESSAGE_HEADER,
    MESSAGE_OPCODE,
    RECORD_HEADER,
    checked,
    encode,
    encode_indexes,
)


class LogChannel(msgspec.Struct, frozen=True):
    """A channel of a log; ``schema_data`` is the serialised descriptor set of ``schema_name``.

    Channels of other applications may have any encoding, metadata, and no schema: then its three fields are empty.
    """

    channel_id: int
    topic: str
    schema_name: str
    schema_data: bytes
    schema_encoding: str = "protobuf"
    message_encoding: str = "protobuf"
    metadata: dict[str, str] = {}


NO_LIMIT: Final = 2**63
INT64_MAX: Final = 2**63 - 1  # latest time in a log: many readers take MCAP's unsigned times for signed ones


_OURS: Final = re.compile(r"(cruiser(?:\.[a-z]+)?)\.[0-9]+")


def numbered(name: str, count: int) -> str:
    """The name of a file's ``count``-th metadata record of a name: ``cruiser``, ``cruiser.2``, ..."""
    return f"{name}.{count}" if count > 1 and _OURS.fullmatch(f"{name}.{count}") else name


def unnumbered(name: str) -> str:
    """The name of a metadata record without its number."""
    found = _OURS.fullmatch(name)
    return name if found is None else found[1]


def log_time(time_ns: int) -> int:
    """The nearest time since 1970 that a log may hold."""
    return min(max(time_ns, 0), INT64_MAX)


def message_record(channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> bytes:
    """A message's record. The times are unsigned 64-bit, the sequence 32-bit, the channel 16-bit."""
    length = HEADER_IN_LENGTH + len(data)
    return MESSAGE_HEADER.pack(MESSAGE_OPCODE, length, channel_id, sequence, log_ns, publish_ns) + data


def head_source(length: str) -> tuple[str, str]:
    """The head of a message's record for generated code that packs it together with the data.

    Args:
        length: an expression, the bytes of the data.

    Returns:
        The ``struct`` format, and the first values as source; channel id, sequence, log and publish time follow.
    """
    return HEAD_FORMAT, f"{MESSAGE_OPCODE}, {HEADER_IN_LENGTH} + {length}"


class Chunk(msgspec.Struct, frozen=True):
    """Messages ready to be written.

    Attributes:
        index: per channel, alternating log time and offset in ``records`` of each message.
        start_ns, end_ns: the earliest and the latest log time.
    """

    records: bytearray
    index: dict[int, array[int]]
    start_ns: int
    end_ns: int

    @property
    def counts(self) -> dict[int, int]:
        return {channel_id: len(entries) // 2 for channel_id, entries in self.index.items()}


class _Index(dict[int, "array[int]"]):
    """An index as in ``Chunk``, with an empty array for each new channel."""

    def __missing__(self, channel_id: int) -> array[int]:
        index = self[channel_id] = array("Q")
        return index


class ChunkBuilder:
    """Collects messages; ``seal`` returns them as a chunk. It ``is_full`` at ``limit_bytes``."""

    def __init__(self, limit_bytes: int = NO_LIMIT) -> None:
        self.limit_bytes = limit_bytes
        self.records = bytearray()
        self.index = _Index()

    def __len__(self) -> int:
        return len(self.records)

    @property
    def is_full(self) -> bool:
        return len(self.records) >= self.limit_bytes

    def add(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Append a message. The times are unsigned 64-bit, the sequence 32-bit, the channel 16-bit."""
        records = self.records
        index = self.index[channel_id]
        index.append(log_ns)
        index.append(len(records))
        records += MESSAGE_HEADER.pack(
            MESSAGE_OPCODE, HEADER_IN_LENGTH + len(data), channel_id, sequence, log_ns, publish_ns
        )
        records += data

    def seal(self) -> Chunk | None:
        if not self.records:
            return None
        times = [index[::2] for index in self.index.values()]
        chunk = Chunk(
            records=self.records,
            index=dict(self.index),
            start_ns=min(map(min, times)),
            end_ns=max(map(max, times)),
        )
        self.records = bytearray()
        self.index = _Index()
        return chunk


_SUMMARY_ORDER: Final = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)


class Summary:
    """Collects the summary at the end of a file."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self._start_ns: int | None = None
        self._end_ns = 0
        # The records of the summary by kind, and their numbers.
        self._encoded = {opcode: bytearray() for opcode in _SUMMARY_ORDER}
        self._records: Counter[int] = Counter()

    @property
    def messages(self) -> int:
        return self._counts.total()

    @property
    def end_ns(self) -> int:
        """The latest log time; 0 if there is no message."""
        return self._end_ns

    @property
    def chunks(self) -> int:
        return self._records[Opcode.CHUNK_INDEX]

    def add_schema(self, schema: records.Schema) -> None:
        self._add(Opcode.SCHEMA, encode(schema))

    def add_channels(self, encoded: Sequence[bytes]) -> None:
        """Add encoded channels, each the first of its id."""
        self._add(Opcode.CHANNEL, *encoded)

    def add_messages(self, counts: Mapping[int, int], start_ns: int, end_ns: int) -> None:
        """Add the number of messages of each channel, and their first and last log time."""
        self._counts.update(counts)
        self._start_ns = start_ns if self._start_ns is None else min(self._start_ns, start_ns)
        self._end_ns = max(self._end_ns, end_ns)

    def add_chunk(
        self,
        chunk: records.Chunk,
        offset: int,
        length: int,
        index: Mapping[int, array[int]],
        places: Mapping[int, int] | None = None,
        indexes_length: int = 0,
    ) -> None:
        """Add a chunk at this offset of the file, directly followed by its message indexes.

        Args:
            places: distance of each message index from the offset, ``indexes_length`` their total size; None: as
                ``framing.encode_indexes`` puts them.
        """
        if places is None:
            places, end = {}, length
            for channel_id, entries in index.items():
                places[channel_id] = end
                end += INDEX_HEADER.size + entries.itemsize * len(entries)
            indexes_length = end - length
        if index:
            counts = {channel_id: len(entries) // 2 for channel_id, entries in index.items()}
            self.add_messages(counts, chunk.message_start_time, chunk.message_end_time)
        found = records.ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=indexes_length,
            message_index_offsets={channel_id: offset + place for channel_id, place in places.items()},
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
        self._add(Opcode.CHUNK_INDEX, encode(found))

    def add_attachment(self, attachment: records.Attachment, offset: int, length: int) -> None:
        index = records.AttachmentIndex(
            offset=offset,
            length=length,
            log_time=attachment.log_time,
            create_time=attachment.create_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        encoded = encode(index)
        self._add(Opcode.ATTACHMENT_INDEX, encoded)

    def add_metadata(self, metadata: records.Metadata, offset: int, length: int) -> None:
        index = records.MetadataIndex(offset=offset, length=length, name=metadata.name)
        self._add(Opcode.METADATA_INDEX, encode(index))

    def ending(self, data_size: int, data_crc: int) -> bytes:
        """Return the data end, summary and footer that complete a file whose data has this size and CRC."""
        data_end = encode(records.DataEnd(data_crc))
        start = data_size + len(data_end)
        self._encoded[Opcode.STATISTICS] = bytearray(encode(self._statistics()))
        summary, offsets = bytearray(), bytearray()
        for opcode, group in self._encoded.items():
            if group:
                offset = records.SummaryOffset(
                    group_opcode=opcode, group_start=start + len(summary), group_length=len(group)
                )
                offsets += encode(offset)
                summary += group
        offset_start = start + len(summary)
        summary += offsets
        # The summary's checksum covers the footer too, up to the checksum itself.
        length = FOOTER.size - RECORD_HEADER.size
        footer = FOOTER.pack(Opcode.FOOTER, length, start, offset_start, 0)[:-4]
        crc = zlib.crc32(footer, zlib.crc32(summary))
        return data_end + bytes(summary) + footer + crc.to_bytes(4, "little") + MAGIC

    def _add(self, opcode: Opcode, *encoded: bytes) -> None:
        self._encoded[opcode] += b"".join(encoded)
        self._records[opcode] += len(encoded)

    def _statistics(self) -> records.Statistics:
        return records.Statistics(
            attachment_count=self._records[Opcode.ATTACHMENT_INDEX],
            channel_count=self._records[Opcode.CHANNEL],
            channel_message_counts=dict(self._counts),
            chunk_count=self.chunks,
            message_count=self.messages,
            message_end_time=self._end_ns,
            message_start_time=self._start_ns or 0,
            metadata_count=self._records[Opcode.METADATA_INDEX],
            schema_count=self._records[Opcode.SCHEMA],
        )


COMPRESSION: Final = "zstd"
COMPRESSION_LEVEL: Final = 3
"""zstd's default: full chunks are a tenth smaller than at its fastest level."""


class LogStream(Protocol):
    """A binary stream; ``write`` may write only a part."""

    def write(self, data: memoryview, /) -> int | None:
        """Write some of the data; returns the number of bytes, or None."""

    def seek(self, offset: int, /) -> int:
        """Go to an offset."""

    def truncate(self) -> int:
        """End the stream here."""


class McapFile:
    """An MCAP file that is being written; ``profile`` is the header's, of MCAP's registry."""

    def __init__(self, stream: LogStream, library: str, profile: str = "") -> None:
        self._is_finished = False
        self._metadata: Counter[str] = Counter()  # records by name
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
        return self._size

    @property
    def sha256(self) -> str:
        """SHA-256 of the bytes written, hexadecimal."""
        return self._sha256.hexdigest()

    @property
    def messages(self) -> int:
        return self._summary.messages

    def add_channel(self, channel: LogChannel) -> None:
        self.add_channels([channel])

    def add_channels(self, channels: Iterable[LogChannel]) -> None:
        """Write channels, and their schemas that are new, in one write: there may be thousands."""
        channels = list(channels)
        data: list[bytes] = []
        encoded: list[bytes] = []
        new: dict[tuple[str, str, bytes], records.Schema] = {}
        for channel in channels:
            identity = channel.schema_name, channel.schema_encoding, channel.schema_data
            schema = self._schemas.get(identity) or new.get(identity)
            if schema is None and any(identity):
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
        record = records.Attachment(
            create_time=create_ns, log_time=log_ns, name=name, media_type=media_type, data=data
        )
        encoded, start = encode(record), self._size
        self._write(checked(encoded))
        self._summary.add_attachment(record, start, len(encoded))

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Write a metadata record. A further one of ours of that name gets a number: rerun wants each key once."""
        self._metadata[name] += 1
        record = records.Metadata(name=numbered(name, self._metadata[name]), metadata=entries)
        encoded, start = encode(record), self._size
        self._write(checked(encoded))
        self._summary.add_metadata(record, start, len(encoded))

    def finish(self) -> None:
        """Write the end of the data, the summary and the footer, once."""
        if self._is_finished:
            return
        self._write(self._summary.ending(self._size, self._data_crc))
        self._is_finished = True

    def cut_back(self) -> None:
        """After a failed write: cut the stream back to the end of the last whole record."""
        self._stream.seek(self._size)
        self._stream.truncate()

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            taken = self._stream.write(view)
            if not taken:
                raise OSError(errno.EAGAIN, "the stream accepts no bytes")
            view = view[taken:]
        self._data_crc = zlib.crc32(data, self._data_crc)
        self._sha256.update(data)
        self._size += len(data)
