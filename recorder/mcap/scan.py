"""What is whole in a damaged or unfinished MCAP file, piece by piece, each proven by its checksum.

A piece is a chunk with its message indexes, or another record with the check behind it. Where the bytes make no
sense the scan goes on at the next piece that is proven. In a file without checks, which others wrote, a record
outside of chunks is taken as it is.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, Final

import msgspec
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream

from recorder.mcap.chunk import HEADER_IN_LENGTH, MESSAGE_HEADER, MESSAGE_OPCODE
from recorder.mcap.summary import CHECK, CHECK_OPCODE, FOOTER_LENGTH, MAGIC, RECORD_HEADER, encode, encode_index

RECORD_MAX: Final = 1 << 30
"""A record that says it is longer than this is damaged: it is not worth a gigabyte of memory to see."""

SEARCH_BYTES: Final = 1 << 20
"""The search for the next whole piece reads this much at once."""

LOOK_FOR_CHECKS: Final = 4096
"""A file is one of ours if there is a check within so many bytes of its beginning, where we have several."""

NO_RECORD: Final = "a chunk holds what is no record"

BROKEN: Final = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    OverflowError,
    MemoryError,
    RuntimeError,  # what the lz4 package raises
)
"""What the mcap package's parsers raise on bytes that are no such record."""

_CHECK_MARK: Final = RECORD_HEADER.pack(CHECK_OPCODE, CHECK.size - RECORD_HEADER.size)
_COMPRESSION_AT: Final = RECORD_HEADER.size + 28
"""Where in a chunk its compression is named: behind two times, a size and a CRC."""
_COMPRESSION_MARKS: Final = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")

_WRITTEN_OPCODES: Final = {
    Opcode.HEADER,
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.MESSAGE,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
    CHECK_OPCODE,
    Opcode.DATA_END,
}
_PARSED: Final = {
    Opcode.HEADER: records.Header.read,
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.ATTACHMENT: records.Attachment.read,
}

Parsed = records.Header | records.Schema | records.Channel | records.Metadata | records.Attachment


class ChunkPiece(msgspec.Struct, frozen=True):
    """A chunk whose content its CRC proves.

    Attributes:
        offset, chunk_end, end: of the chunk, of its record, and of the message indexes behind it.
        record: the chunk; its times are those of its content, whatever it said.
        content: its records, not compressed.
        declared: the schemas and channels within.
        index: as in ``recorder.mcap.chunk.Chunk``, found anew.
        as_written: the chunk's head, and every message index behind it, say what is there.
        has_true_head: the chunk's head does.
    """

    offset: int
    chunk_end: int
    end: int
    record: records.Chunk
    content: bytes
    declared: list[Parsed]
    index: dict[int, array[int]]
    as_written: bool
    has_true_head: bool


class RecordPiece(msgspec.Struct, frozen=True):
    """A record outside of chunks, and its check.

    Attributes:
        raw: the bytes of both; ``length`` of them are the record's.
        parsed: None for a message and for what MCAP leaves to applications.
    """

    offset: int
    end: int
    raw: bytes
    length: int
    parsed: Parsed | None


class DataEnd(msgspec.Struct, frozen=True):
    """The data ends here; what follows can be made anew. ``crc`` is what it says of all data, 0 if nothing."""

    offset: int
    crc: int


class Damage(msgspec.Struct, frozen=True):
    """From here on nothing can be believed, up to the next piece."""

    offset: int
    detail: str


Found = ChunkPiece | RecordPiece | DataEnd | Damage


class Scanner:
    """Looks through a file.

    Args:
        stream: the file.
        size: its length in bytes.
    """

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self._stream = stream
        self._size = size
        self.has_checks = _CHECK_MARK in self.read(0, LOOK_FOR_CHECKS)

    def read(self, offset: int, length: int) -> bytes:
        """Bytes at an offset, fewer at the end."""
        self._stream.seek(offset)
        return self._stream.read(min(length, max(0, self._size - offset)))

    def scan(self) -> Iterator[Found]:
        """What the file holds, in its order."""
        offset: int | None = len(MAGIC)
        if self.read(0, len(MAGIC)) != MAGIC:
            yield Damage(0, "the file does not begin as MCAP does")
            offset = self.next_piece(0)
        while offset is not None and offset < self._size:
            found = self._piece(offset)
            yield found
            if isinstance(found, DataEnd):
                return
            offset = self.next_piece(offset) if isinstance(found, Damage) else found.end

    def is_closed(self, data_end: int) -> bool:
        """Whether the file, whose data ends there, has a proper summary and footer and then ends."""
        start = self._size - len(MAGIC) - RECORD_HEADER.size - FOOTER_LENGTH
        behind = data_end + RECORD_HEADER.size + 4
        if start < behind or self._size - behind > RECORD_MAX:
            return False
        rest = self.read(behind, self._size - behind)
        footer = rest[start - behind : -len(MAGIC)]
        summary_start, _, crc = struct.unpack_from("<QQI", footer, RECORD_HEADER.size)
        return (
            rest.endswith(MAGIC)
            and RECORD_HEADER.unpack_from(footer) == (Opcode.FOOTER, FOOTER_LENGTH)
            and summary_start in {0, behind}
            and crc in {0, zlib.crc32(rest[: -len(MAGIC) - 4])}
        )

    def is_torn(self, offset: int) -> bool:
        """Whether what stands from there to the end is but the beginning of one last write, or nothing at all."""
        at = offset
        while at < self._size:
            head = self.read(at, RECORD_HEADER.size)
            if len(head) < RECORD_HEADER.size:
                break
            opcode, length = RECORD_HEADER.unpack(head)
            at += RECORD_HEADER.size + length
            if opcode not in _WRITTEN_OPCODES or (opcode == Opcode.CHUNK and at <= self._size):
                return self._is_blank(offset)
        return True

    def _is_blank(self, offset: int) -> bool:
        """Whether only zeros follow: a power cut leaves them where the length of a file came to the disk first."""
        while block := self.read(offset, SEARCH_BYTES):
            if any(block):
                return False
            offset += len(block)
        return True

    def _record(self, offset: int) -> tuple[int, bytes] | None:
        """Opcode and all bytes of the record there, if it is not longer than the file."""
        head = self.read(offset, RECORD_HEADER.size)
        if len(head) < RECORD_HEADER.size:
            return None
        opcode, length = RECORD_HEADER.unpack(head)
        if length > min(RECORD_MAX, self._size - offset - len(head)):
            return None
        return opcode, head + self.read(offset + len(head), length)

    def _piece(self, offset: int) -> Found:
        record = self._record(offset)
        if record is None:
            return Damage(offset, "a record is cut off")
        opcode, raw = record
        try:
            if opcode == Opcode.CHUNK:
                return self._chunk(offset, raw)
            if opcode == Opcode.DATA_END:
                return self._data_end(offset, raw)
            return self._other(offset, opcode, raw)
        except BROKEN as error:
            return Damage(offset, f"a record cannot be read: {error}")

    def _data_end(self, offset: int, raw: bytes) -> Found:
        behind = self.read(offset + len(raw), 1)
        if len(raw) != RECORD_HEADER.size + 4 or (behind and behind[0] > max(Opcode)):
            return Damage(offset, "a record cannot be read")
        return DataEnd(offset, int.from_bytes(raw[RECORD_HEADER.size :], "little"))

    def _other(self, offset: int, opcode: int, raw: bytes) -> Found:
        end = offset + len(raw)
        is_known = opcode in _PARSED or opcode == MESSAGE_OPCODE
        if self.has_checks:
            check = self.read(end, CHECK.size)
            if not is_known or check != CHECK.pack(CHECK_OPCODE, 8, len(raw), zlib.crc32(raw)):
                return Damage(offset, "a record's check is wrong")
            end += len(check)
        elif not is_known and opcode <= max(Opcode):
            return Damage(offset, "a record has no place there")
        parsed: Parsed | None = None
        if opcode in _PARSED:
            parsed = _PARSED[Opcode(opcode)](ReadDataStream(BytesIO(raw[RECORD_HEADER.size :])))
            if isinstance(parsed, records.Attachment) and _has_wrong_crc(raw):
                return Damage(offset, "an attachment's checksum is wrong")
        elif opcode == MESSAGE_OPCODE:
            MESSAGE_HEADER.unpack_from(raw)
        return RecordPiece(offset, end, self.read(offset, end - offset), len(raw), parsed)

    def _chunk(self, offset: int, raw: bytes) -> Found:
        chunk = records.Chunk.read(ReadDataStream(BytesIO(raw[RECORD_HEADER.size :])))
        if self.has_checks and not chunk.uncompressed_crc:
            return Damage(offset, "a chunk's checksum is missing")
        promised = zstandard.frame_content_size(chunk.data) if chunk.compression == "zstd" else -1
        if chunk.uncompressed_size > RECORD_MAX or promised not in {-1, chunk.uncompressed_size}:
            return Damage(offset, "a chunk's sizes differ")
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        content = stream.read(length)
        index, declared = index_content(content)
        times = [entries[::2] for entries in index.values()]
        true = records.Chunk(
            compression=chunk.compression,
            data=chunk.data,
            message_start_time=min(map(min, times), default=0),
            message_end_time=max(map(max, times), default=0),
            uncompressed_crc=chunk.uncompressed_crc,
            uncompressed_size=length,
        )
        has_true_head = encode(true) == raw
        chunk_end = offset + len(raw)
        is_indexed, end = self._message_indexes(chunk_end, index)
        as_written = has_true_head and is_indexed
        return ChunkPiece(offset, chunk_end, end, true, content, declared, index, as_written, has_true_head)

    def _message_indexes(self, offset: int, index: dict[int, array[int]]) -> tuple[bool, int]:
        """Whether the message indexes there say what the chunk before holds, and where they end."""
        expected = message_indexes(index)
        if self.read(offset, len(expected)) == expected:
            return True, offset + len(expected)
        # Others may put them in another order.
        found: dict[int, list[tuple[int, int]]] = {}
        while (record := self._record(offset)) is not None and record[0] == Opcode.MESSAGE_INDEX:
            raw = record[1]
            try:
                one = records.MessageIndex.read(ReadDataStream(BytesIO(raw[RECORD_HEADER.size :])))
            except BROKEN:
                return False, offset
            if encode(one) != raw or one.channel_id in found:
                return False, offset
            found[one.channel_id] = sorted(one.records)
            offset += len(raw)
        return found == {
            channel_id: sorted(zip(entries[::2], entries[1::2], strict=True))
            for channel_id, entries in index.items()
        }, offset

    def next_piece(self, damaged: int) -> int | None:
        """Where the next proven piece begins, behind a damaged one."""
        record = self._record(damaged)
        if record is not None and self._is_proven(damaged + len(record[1])):
            return damaged + len(record[1])
        at = damaged + 1
        while (candidate := self._find(at)) is not None:
            mark, start = candidate
            if start > damaged and self._is_proven(start):
                return start
            at = mark + 1
        return None

    def _is_proven(self, offset: int) -> bool:
        if offset >= self._size:
            return False
        found = self._piece(offset)
        if isinstance(found, ChunkPiece):
            return found.record.uncompressed_crc != 0
        if isinstance(found, DataEnd):
            return self.is_closed(offset)
        return isinstance(found, RecordPiece) and (self.has_checks or found.parsed is not None)

    def _find(self, start: int) -> tuple[int, int] | None:
        """The first mark from there on that a piece may have, and where that piece would begin."""
        overlap = max(map(len, (_CHECK_MARK, *_COMPRESSION_MARKS)))
        while start < self._size:
            block = self.read(start, SEARCH_BYTES + overlap)
            marks = []
            for pattern in (_CHECK_MARK, *_COMPRESSION_MARKS):
                at = block.find(pattern)
                if at >= 0:
                    marks.append((at, pattern))
            if marks:
                at, pattern = min(marks)
                mark = start + at
                if pattern != _CHECK_MARK:
                    return mark, mark - _COMPRESSION_AT
                length = int.from_bytes(self.read(mark + len(pattern), 4), "little")
                return mark, mark - length
            start += SEARCH_BYTES
        return None


def _has_wrong_crc(attachment: bytes) -> bool:
    expected = int.from_bytes(attachment[-4:], "little")
    return expected not in {0, zlib.crc32(attachment[RECORD_HEADER.size : -4])}


def message_indexes(index: dict[int, array[int]]) -> bytes:
    """The records that stand behind a chunk with this index."""
    return b"".join(encode_index(channel_id, entries) for channel_id, entries in index.items())


def index_content(content: bytes) -> tuple[dict[int, array[int]], list[Parsed]]:
    """The index of a chunk's messages, and the schemas and channels among them.

    Raises:
        ValueError, struct.error: these are no records.
    """
    index: dict[int, array[int]] = {}
    declared: list[Parsed] = []
    position, end = 0, len(content)
    while position < end:
        opcode, length = RECORD_HEADER.unpack_from(content, position)
        start, position = position, position + RECORD_HEADER.size + length
        if position > end or (opcode == MESSAGE_OPCODE and length < HEADER_IN_LENGTH):
            raise ValueError("a chunk holds half a record")
        if not opcode:
            raise ValueError(NO_RECORD)
        if opcode == MESSAGE_OPCODE:
            _, _, channel_id, _, log_ns, _ = MESSAGE_HEADER.unpack_from(content, start)
            entries = index.get(channel_id)
            if entries is None:
                entries = index[channel_id] = array("Q")
            entries.append(log_ns)
            entries.append(start)
        elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            body = content[start + RECORD_HEADER.size : position]
            declared.append(_PARSED[Opcode(opcode)](ReadDataStream(BytesIO(body))))
    return index, declared
