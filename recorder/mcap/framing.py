"""The framing of MCAP files (https://mcap.dev/spec): magic, opcodes, record headers, checksums. Pure.

Known to this room alone: others write by ``writer`` and ``chunk``, and read by ``reader`` and ``summary_reader``.
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

LENGTH_AT, CHANNEL_AT, SEQUENCE_AT, LOG_AT, PUBLISH_AT, DATA_AT = 1, 9, 11, 15, 23, MESSAGE_HEADER.size
"""Places in a message record of its numbers, and of its data."""

INDEX_HEADER: Final = struct.Struct("<BQHI")
"""A message index up to its entries: opcode, length, channel, bytes of the entries."""

CHUNK_TIMES: Final = struct.Struct("<QQ")
"""The beginning of a chunk's record: the first and the last log time in it."""

LAST_OPCODE: Final = max(Opcode)  # the last one that MCAP defines

CHECK_OPCODE: Final = 0x80
"""A record of our own (MCAP leaves 0x80 and above to applications, and readers skip them): a checksum.

MCAP has none for schemas, channels and metadata before the file is finished: in a log of a recorder that was
killed a flipped bit would change a topic's name, and nobody would know.
"""

CHECK: Final = struct.Struct("<BQII")
"""The check: opcode, length, and of how many bytes right before it which CRC-32."""

CHECK_MARK: Final = RECORD_HEADER.pack(CHECK_OPCODE, CHECK.size - RECORD_HEADER.size)
"""The beginning of every check."""

FOOTER: Final = struct.Struct("<BQQQI")
"""The footer: opcode, length, where the summary and its own offsets begin, and the checksum of all since then."""

CHUNK_NAME_AT: Final = RECORD_HEADER.size + 28
"""Place in a chunk's record of its compression's name: behind two times, a size and a CRC."""

RECORD_MAX: Final = 1 << 30
"""A record that says it is longer than this is damaged: it is not worth a gigabyte of memory to see."""

UNPACKED_MAX: Final = 1 << 27
"""A packed chunk that promises more is not unpacked: no recorder makes such, and a few kilobytes might hold a
gigabyte of tiny messages, each of which costs whoever reads it several times its length."""

RECORDS_MAX: Final = 1 << 20
"""A chunk is read up to this many records, twice as many as the largest of a recorder's could hold."""

DECLARED_MAX: Final = 1 << 27
"""Schemas and channels in the chunks of a file are read up to so many bytes: whoever reads keeps them all."""

BROKEN: Final = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    OverflowError,
    MemoryError,
    RuntimeError,  # what the lz4 package raises
)
"""Exceptions of the mcap package's parsers on bytes that are no such record."""

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
    """Bytes that are not the record that should be there, or whose checksum is wrong."""


@contextmanager
def parsing() -> Iterator[None]:
    """Turn everything that a parser raises on damaged bytes into a DamagedError of the same text."""
    try:
        yield
    except DamagedError:
        raise
    except BROKEN as error:
        raise DamagedError(str(error)) from error


class RecordFile:
    """The bytes of a file and the headers of its records; what lies close together is read at once."""

    def __init__(self, stream: BinaryIO, size: int, block_bytes: int = _GLANCE_BYTES) -> None:
        self.size = size
        self._stream = stream
        self._block_bytes = block_bytes
        self._block = b""
        self._block_at = 0

    def read(self, offset: int, length: int) -> bytes:
        """Bytes at an offset, fewer at the end."""
        start = offset - self._block_at
        if start < 0 or start + length > len(self._block):
            self._stream.seek(offset)
            self._block = self._stream.read(max(0, min(max(length, self._block_bytes), self.size - offset)))
            self._block_at, start = offset, 0
        return self._block[start : start + length]

    def header(self, offset: int) -> tuple[int, int] | None:
        """Opcode of the record there, and where it ends, in the file or beyond; None if there is no header."""
        head = self.read(offset, RECORD_HEADER.size)
        if len(head) < RECORD_HEADER.size:
            return None
        opcode, length = RECORD_HEADER.unpack(head)
        return opcode, offset + RECORD_HEADER.size + length

    def record(self, offset: int) -> tuple[int, bytes] | None:
        """Opcode and all bytes of the record there; None if it is longer than the file, or than any may be."""
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
        """The message index there: its channel, its entries, and where it ends; None if there is none."""
        head = self.read(offset, INDEX_HEADER.size)
        if len(head) < INDEX_HEADER.size or head[0] != Opcode.MESSAGE_INDEX:
            return None
        _, length, channel_id, entries_length = INDEX_HEADER.unpack(head)
        end: int = offset + RECORD_HEADER.size + length
        # Behind the entries there may be fields of a later version.
        is_true = end >= offset + INDEX_HEADER.size + entries_length and entries_length % 16 == 0
        if not is_true or end > self.size:
            return None
        entries = array("Q")
        entries.frombytes(self.read(offset + INDEX_HEADER.size, entries_length))
        if sys.byteorder == "big":
            entries.byteswap()
        return channel_id, entries, end


def is_reserved(opcode: int) -> bool:
    """True of those that a later version of MCAP may use: readers pass over such records."""
    return LAST_OPCODE < opcode < CHECK_OPCODE


def parse(opcode: int, body: bytes) -> Any:  # noqa: ANN401 - by the opcode
    """The mcap package's record of this opcode.

    Raises:
        what BROKEN lists.
    """
    return _PARSERS[opcode](ReadDataStream(BytesIO(body)))


def record_at(stream: BinaryIO, offset: int, kind: type[Record], size: int | None = None) -> Record | None:
    """The record of this kind there; None if there is none.

    Args:
        size: its bytes in the file, if they are known: a record of another size is none.

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
    """A message index record: log times and offsets in turns, of the messages of one channel in a chunk."""
    if sys.byteorder == "big":
        entries = entries[:]
        entries.byteswap()
    data = entries.tobytes()
    return INDEX_HEADER.pack(Opcode.MESSAGE_INDEX, 6 + len(data), channel_id, len(data)) + data


def encode_indexes(index: Mapping[int, array[int]]) -> bytes:
    """The records that stand behind a chunk with this index."""
    return b"".join(encode_index(channel_id, entries) for channel_id, entries in index.items())


def check_of(length: int, crc: int) -> bytes:
    """The check of so many bytes with this CRC-32."""
    return CHECK.pack(CHECK_OPCODE, CHECK.size - RECORD_HEADER.size, length, crc)


def checked(data: bytes) -> bytes:
    return data + check_of(len(data), zlib.crc32(data))


def has_wrong_crc(attachment: bytes) -> bool:
    """True of an attachment's body with a checksum that is not its own; 0 is none."""
    at = 16
    for size in (4, 4, 8):  # Name, media type and data, each behind its length.
        at += size + int.from_bytes(attachment[at : at + size], "little")
    return int.from_bytes(attachment[at : at + 4], "little") not in {0, zlib.crc32(attachment[:at])}
