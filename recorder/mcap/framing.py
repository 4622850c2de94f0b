"""The framing of MCAP files (https://mcap.dev/spec): magic, opcodes, record headers, checksums. Pure.

Private to this package: others write by ``writer``, and read by ``reader`` and ``summary_reader``.
"""

from __future__ import annotations

import struct
import sys
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from io import SEEK_END, BytesIO
from typing import Any, BinaryIO, Final, TypeVar, cast

import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode

MAGIC: Final = b"\x89MCAP0\r\n"

FIRST_RECORD: Final = len(MAGIC)  # offset in a file of its first record
RECORD_HEADER: Final = struct.Struct("<BQ")  # opcode and length of what follows

MESSAGE_OPCODE: Final = 0x05
HEAD_FORMAT: Final = "BQHIQQ"
MESSAGE_HEADER: Final = struct.Struct(f"<{HEAD_FORMAT}")
"""A message record up to its data: opcode, length, channel, sequence, log time, publish time."""

HEADER_IN_LENGTH: Final = MESSAGE_HEADER.size - RECORD_HEADER.size
"""The part of the header that a record's length counts: all but opcode and length."""

# Offsets in a message record.
LENGTH_AT, CHANNEL_AT, SEQUENCE_AT, LOG_AT, PUBLISH_AT, DATA_AT = 1, 9, 11, 15, 23, MESSAGE_HEADER.size

INDEX_HEADER: Final = struct.Struct("<BQHI")
"""A message index up to its entries: opcode, length, channel, bytes of the entries."""

CHUNK_TIMES: Final = struct.Struct("<QQ")  # the beginning of a chunk's record: its first and last log time
LAST_OPCODE: Final = max(Opcode)  # the last one that MCAP defines

CHECK_OPCODE: Final = 0x80
"""A record of our own with a checksum; MCAP leaves 0x80 and above to applications, and readers skip them.

MCAP protects schemas, channels and metadata only in finished files: after a crash, a flipped bit in a topic's name
would go unnoticed.
"""

CHECK: Final = struct.Struct("<BQII")  # opcode, length, number of bytes before it, their CRC-32
CHECK_MARK: Final = RECORD_HEADER.pack(CHECK_OPCODE, CHECK.size - RECORD_HEADER.size)  # the start of every check
FOOTER: Final = struct.Struct("<BQQQI")  # opcode, length, offsets of the summary and its offsets, their checksum

CHUNK_NAME_AT: Final = RECORD_HEADER.size + 28
"""Offset in a chunk's record of its compression's name: behind two times, a size and a CRC."""

RECORD_MAX: Final = 1 << 30  # a longer record counts as damaged: it is never read into memory

UNPACKED_MAX: Final = 1 << 27
"""A packed chunk that states a larger size is not unpacked: a few kilobytes might hold a gigabyte of tiny
messages, each of which takes several times its length in memory."""

RECORDS_MAX: Final = 1 << 20  # most records of a chunk that are read: twice as many as our largest could hold
DECLARED_MAX: Final = 1 << 27  # most bytes of schemas and channels in the chunks of a file: readers store them all

BROKEN: Final = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    OverflowError,
    MemoryError,
    RuntimeError,  # what the lz4 package raises
)
"""Exceptions of the mcap package's parsers on damaged bytes."""

_GLANCE_BYTES: Final = 1 << 13

_PARSERS: Final[dict[int, Callable[[ReadDataStream], Any]]] = {
    Opcode.HEADER: records.Header.read,
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.CHUNK: records.Chunk.read,
    Opcode.MESSAGE_INDEX: records.MessageIndex.read,
    Opcode.ATTACHMENT: records.Attachment.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.STATISTICS: records.Statistics.read,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex.read,
    Opcode.METADATA_INDEX: records.MetadataIndex.read,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset.read,
}
_OPCODES: Final[dict[type, int]] = {
    records.Header: Opcode.HEADER,
    records.MessageIndex: Opcode.MESSAGE_INDEX,
    records.Attachment: Opcode.ATTACHMENT,
    records.Metadata: Opcode.METADATA,
}

Record = TypeVar("Record", records.Header, records.MessageIndex, records.Attachment, records.Metadata)


class DamagedError(ValueError):
    """Bytes that are not the expected record, or whose checksum is wrong."""


@contextmanager
def parsing() -> Iterator[None]:
    """Turn a parser's exceptions on damaged bytes into a DamagedError of the same text."""
    try:
        yield
    except DamagedError:
        raise
    except BROKEN as error:
        raise DamagedError(str(error)) from error


class RecordFile:
    """Buffered access to the bytes and records of a file."""

    def __init__(self, stream: BinaryIO, size: int, block_bytes: int = _GLANCE_BYTES) -> None:
        self.size = size
        self._stream = stream
        self._block_bytes = block_bytes
        self._block = b""
        self._block_at = 0

    def read(self, offset: int, length: int) -> bytes:
        """The bytes at an offset; fewer at the end of the file."""
        start = offset - self._block_at
        if start < 0 or start + length > len(self._block):
            self._stream.seek(offset)
            self._block = self._stream.read(max(0, min(max(length, self._block_bytes), self.size - offset)))
            self._block_at, start = offset, 0
        return self._block[start : start + length]

    def header(self, offset: int) -> tuple[int, int] | None:
        """Opcode and end of the record there, perhaps beyond the file; None if there is no header."""
        head = self.read(offset, RECORD_HEADER.size)
        if len(head) < RECORD_HEADER.size:
            return None
        opcode, length = RECORD_HEADER.unpack(head)
        return opcode, offset + RECORD_HEADER.size + length

    def record(self, offset: int) -> tuple[int, bytes] | None:
        """Opcode and all bytes of the record there; None if it is too long, or exceeds the file."""
        header = self.header(offset)
        if header is None or header[1] > min(self.size, offset + RECORD_HEADER.size + RECORD_MAX):
            return None
        return header[0], self.read(offset, header[1] - offset)

    def records(self, start: int, end: int) -> Iterator[tuple[int, int, bytes]]:
        at = start
        while at < end:
            opcode, behind = self.header(at) or (0, end + 1)
            body_at = at + RECORD_HEADER.size
            if behind > end or behind - body_at > RECORD_MAX:
                raise ValueError("a record is cut off")
            yield opcode, at, self.read(body_at, behind - body_at)
            at = behind

    def message_index(self, offset: int) -> tuple[int, array[int], int] | None:
        """Channel, entries and end of the message index there; None if there is none."""
        head = self.read(offset, INDEX_HEADER.size)
        if len(head) < INDEX_HEADER.size or head[0] != Opcode.MESSAGE_INDEX:
            return None
        _, length, channel_id, entries_length = INDEX_HEADER.unpack(head)
        end: int = offset + RECORD_HEADER.size + length
        # A later version may add fields behind the entries.
        is_true = end >= offset + INDEX_HEADER.size + entries_length and entries_length % 16 == 0
        if not is_true or end > self.size:
            return None
        entries = array("Q")
        entries.frombytes(self.read(offset + INDEX_HEADER.size, entries_length))
        if sys.byteorder == "big":
            entries.byteswap()
        return channel_id, entries, end


def is_reserved(opcode: int) -> bool:
    """True of opcodes that a later version of MCAP may use: readers skip such records."""
    return LAST_OPCODE < opcode < CHECK_OPCODE


def parse(opcode: int, body: bytes) -> Any:  # noqa: ANN401 - by the opcode
    """The mcap package's record of this opcode. Raises what BROKEN lists."""
    return _PARSERS[opcode](ReadDataStream(BytesIO(body)))


def record_at(stream: BinaryIO, offset: int, kind: type[Record], size: int | None = None) -> Record | None:
    """The record of this kind, and of this size if given, at an offset; None if there is none.

    Raises:
        DamagedError: it cannot be read.
    """
    found = RecordFile(stream, stream.seek(0, SEEK_END)).record(offset)
    if found is None or found[0] != _OPCODES[kind] or size not in {None, len(found[1])}:
        return None
    with parsing():
        record: Record = parse(found[0], found[1][RECORD_HEADER.size :])
        return record


def encode(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return cast("bytes", builder.end())


def encode_index(channel_id: int, entries: array[int]) -> bytes:
    """A message index record, from alternating log times and offsets of one channel's messages in a chunk."""
    if sys.byteorder == "big":
        entries = entries[:]
        entries.byteswap()
    data = entries.tobytes()
    return INDEX_HEADER.pack(Opcode.MESSAGE_INDEX, 6 + len(data), channel_id, len(data)) + data


def encode_indexes(index: Mapping[int, array[int]]) -> bytes:
    """The message index records of a chunk."""
    return b"".join(encode_index(channel_id, entries) for channel_id, entries in index.items())


def check_of(length: int, crc: int) -> bytes:
    """The check of ``length`` bytes with this CRC-32."""
    return CHECK.pack(CHECK_OPCODE, CHECK.size - RECORD_HEADER.size, length, crc)


def checked(data: bytes) -> bytes:
    return data + check_of(len(data), zlib.crc32(data))


def has_wrong_crc(attachment: bytes) -> bool:
    """True of an attachment's body with a wrong checksum; 0 is none."""
    at = 16
    for size in (4, 4, 8):  # Name, media type and data, each behind its length.
        at += size + int.from_bytes(attachment[at : at + size], "little")
    return int.from_bytes(attachment[at : at + 4], "little") not in {0, zlib.crc32(attachment[:at])}
