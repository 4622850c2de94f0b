"""The intact pieces of a damaged or unfinished MCAP file, each proven by its checksum.

A piece is a chunk with its message indexes, or another record with the check behind it. Where the bytes make no
sense the scan goes on at the next piece that is proven. In a file without checks, which others wrote, a record
outside of chunks is taken as it is.
"""

from __future__ import annotations

import re
import zlib
from array import array
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import BinaryIO, Final

import msgspec
from mcap import records
from mcap.opcode import Opcode

from recorder.mcap.framing import (
    BROKEN,
    CHECK,
    CHECK_MARK,
    CHECK_OPCODE,
    CHUNK_NAME_AT,
    FIRST_RECORD,
    FOOTER,
    LAST_OPCODE,
    MAGIC,
    MESSAGE_HEADER,
    MESSAGE_OPCODE,
    RECORD_HEADER,
    RECORD_MAX,
    RecordFile,
    check_of,
    has_wrong_crc,
    parse,
)
from recorder.mcap.pieces import Declared, DeclaredRoom, Fault, Index, content_of, index_content

SEARCH_BYTES: Final = 1 << 20
"""The search for the next whole piece reads this much at once."""

LOOK_FOR_CHECKS: Final = 4096
"""A file is one of ours if there is a check within so many bytes of its beginning, where we have several."""

_COMPRESSION_MARKS: Final = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")

_PLAIN_CHUNK: Final = re.compile(rb"\x06[\s\S]{5}\0\0\0[\s\S]{28}\0\0\0\0")
"""The head of a chunk without compression that is not longer than any may be."""

_PARSED: Final = frozenset({Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT})
_WRITTEN: Final = _PARSED | {
    Opcode.MESSAGE,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    CHECK_OPCODE,
    Opcode.DATA_END,
}

Parsed = records.Header | records.Schema | records.Channel | records.Metadata | records.Attachment


class ProvenChunk(msgspec.Struct, frozen=True):
    """A chunk whose content its CRC proves.

    Attributes:
        offset, chunk_end, end: of the chunk, of its record, and of the message indexes behind it.
        record: the chunk; its times are those of its content, whatever it said.
        content: its records, not compressed.
        declared: the schemas and channels within.
        index: as in ``recorder.mcap.chunk.Chunk``, found anew.
        raw: the bytes of the chunk and of its message indexes, as they are in the file.
        has_true_head: the chunk's head says what is there.
        places: where in ``raw`` the message index of each channel stands, if they say what is there; else None.
            A file need not have any.
    """

    offset: int
    chunk_end: int
    end: int
    record: records.Chunk
    content: bytes
    declared: list[Declared]
    index: Index
    raw: bytes
    has_true_head: bool
    places: Mapping[int, int] | None


class ProvenRecord(msgspec.Struct, frozen=True):
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
    end: int
    crc: int


Found = ProvenChunk | ProvenRecord | DataEnd | Fault


class Scanner:
    """Looks through a file.

    Args:
        stream: the file.
        size: its length in bytes.

    Attributes:
        file: the file's records.
    """

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.file = RecordFile(stream, size)
        self._size = size
        self._room = DeclaredRoom()

    @cached_property
    def has_checks(self) -> bool:
        """True if a recorder of ours wrote it: other applications may have records of the check's opcode."""
        begin = self.file.read(0, LOOK_FOR_CHECKS)
        at = begin.find(CHECK_MARK)
        while at >= 0:
            found = begin[at : at + CHECK.size]
            length = int.from_bytes(found[len(CHECK_MARK) : len(CHECK_MARK) + 4], "little")
            if 0 < length <= at and found == check_of(length, zlib.crc32(begin[at - length : at])):
                return True
            at = begin.find(CHECK_MARK, at + 1)
        return False

    def scan(self) -> Iterator[Found]:
        """Yield the pieces and faults of the file, in its order."""
        offset: int | None = FIRST_RECORD
        if self.file.read(0, len(MAGIC)) != MAGIC:
            yield Fault(0, "the file does not begin as MCAP does")
            offset = self.next_piece(0)
        while offset is not None and offset < self._size:
            found = self.piece(offset)
            yield found
            if isinstance(found, DataEnd):
                return
            offset = self.next_piece(offset) if isinstance(found, Fault) else found.end

    def is_closed(self, data_end: DataEnd) -> bool:
        """Report whether the file, whose data ends there, has a proper summary and footer and then ends."""
        start = self._size - len(MAGIC) - FOOTER.size
        behind = data_end.end
        if start < behind or self._size - behind > RECORD_MAX:
            return False
        rest = self.file.read(behind, self._size - behind)
        opcode, length, summary_start, _, crc = FOOTER.unpack_from(rest, start - behind)
        return (
            rest.endswith(MAGIC)
            and (opcode, length) == (Opcode.FOOTER, FOOTER.size - RECORD_HEADER.size)
            and summary_start in {0, behind}
            and crc in {0, zlib.crc32(rest[: -len(MAGIC) - 4])}
        )

    def is_torn(self, offset: int) -> bool:
        """Return True if nothing but the beginning of one last write, or nothing at all, follows there."""
        at = offset
        while at < self._size and (header := self.file.header(at)) is not None:
            opcode, at = header
            if opcode not in _WRITTEN or (opcode == Opcode.CHUNK and at <= self._size):
                return self._is_blank(offset)
        return True

    def _is_blank(self, offset: int) -> bool:
        """Return True if only zeros follow: after a power cut a file may have its length without its data."""
        while block := self.file.read(offset, SEARCH_BYTES):
            if any(block):
                return False
            offset += len(block)
        return True

    def piece(self, offset: int) -> Found:
        """The piece there, if anything proves it."""
        record = self.file.record(offset)
        if record is None:
            return Fault(offset, "a record is cut off")
        opcode, raw = record
        try:
            if opcode == Opcode.CHUNK:
                return self._chunk(offset, raw)
            if opcode == Opcode.DATA_END:
                return self._data_end(offset, raw)
            return self._other(offset, opcode, raw)
        except BROKEN as error:
            return Fault(offset, f"a record cannot be read: {error}")

    def _data_end(self, offset: int, raw: bytes) -> Found:
        behind = self.file.read(offset + len(raw), 1)
        crc = int.from_bytes(raw[RECORD_HEADER.size :][:4], "little")
        found = DataEnd(offset, offset + len(raw), crc)
        is_plain = len(raw) == RECORD_HEADER.size + 4 and not (behind and behind[0] > LAST_OPCODE)
        # Another one counts where the whole file bears it out: else damage could end the data too early.
        is_other = len(raw) >= RECORD_HEADER.size + 4 and self.is_closed(found)
        return found if is_plain or is_other else Fault(offset, "a record cannot be read")

    def _other(self, offset: int, opcode: int, raw: bytes) -> Found:
        end = offset + len(raw)
        is_known = opcode in _PARSED or opcode == MESSAGE_OPCODE
        if self.has_checks:
            check = self.file.read(end, CHECK.size)
            if not is_known or check != check_of(len(raw), zlib.crc32(raw)):
                return Fault(offset, "a record's check is wrong")
            end += len(check)
        elif not is_known and opcode <= LAST_OPCODE:
            return Fault(offset, "a record has no place there")
        parsed: Parsed | None = None
        if opcode in _PARSED:
            body = raw[RECORD_HEADER.size :]
            parsed = parse(opcode, body)
            if opcode == Opcode.ATTACHMENT and has_wrong_crc(body):
                return Fault(offset, "an attachment's checksum is wrong")
        elif opcode == MESSAGE_OPCODE:
            MESSAGE_HEADER.unpack_from(raw)
        return ProvenRecord(offset, end, self.file.read(offset, end - offset), len(raw), parsed)

    def _chunk(self, offset: int, raw: bytes) -> Found:
        chunk: records.Chunk = parse(Opcode.CHUNK, raw[RECORD_HEADER.size :])
        if self.has_checks and not chunk.uncompressed_crc:
            return Fault(offset, "a chunk's checksum is missing")
        content = content_of(chunk)
        index, declared = index_content(content, self._room)
        times = [entries[::2] for entries in index.values()]
        true = records.Chunk(
            compression=chunk.compression,
            data=chunk.data,
            message_start_time=min(map(min, times), default=0),
            message_end_time=max(map(max, times), default=0),
            uncompressed_crc=chunk.uncompressed_crc,
            uncompressed_size=len(content),
        )
        chunk_end = offset + len(raw)
        places, end = self._message_indexes(offset, chunk_end, index)
        said = chunk.message_start_time, chunk.message_end_time, chunk.uncompressed_size
        has_true_head = said == (true.message_start_time, true.message_end_time, len(content))
        both = self.file.read(offset, end - offset)
        return ProvenChunk(offset, chunk_end, end, true, content, declared, index, both, has_true_head, places)

    def _message_indexes(self, chunk: int, offset: int, index: Index) -> tuple[dict[int, int] | None, int]:
        """Return the places of a chunk's message indexes, as in ``ProvenChunk``, and their end in the file."""
        # Others may put them in another order, or leave them out.
        found: dict[int, array[int]] = {}
        places: dict[int, int] = {}
        at = offset
        while (one := self.file.message_index(at)) is not None and one[0] not in found:
            places[one[0]] = at - chunk
            channel_id, found[channel_id], at = one
        header = self.file.header(at)
        if not found and not self.has_checks and header is not None and header[1] <= self._size:
            return (None if header[0] == Opcode.MESSAGE_INDEX else {}), at
        is_all = header is None or header[0] != Opcode.MESSAGE_INDEX
        return (places if is_all and _in_order(found) == _in_order(index) else None), at

    def next_piece(self, damaged: int) -> int | None:
        """Return the offset of the next proven piece behind a damaged one; None if there is none."""
        record = self.file.record(damaged)
        if record is not None:
            behind = damaged + len(record[1])
            while (index := self.file.message_index(behind)) is not None:
                behind = index[2]
            if self._is_proven(behind):
                return behind
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
        found = self.piece(offset)
        if isinstance(found, ProvenChunk):
            return found.record.uncompressed_crc != 0
        if isinstance(found, DataEnd):
            return self.is_closed(found)
        return isinstance(found, ProvenRecord) and (self.has_checks or found.parsed is not None)

    def _find(self, start: int) -> tuple[int, int] | None:
        """The first mark from there on that a piece may have, and where that piece would begin."""
        overlap = CHUNK_NAME_AT + 4  # The head of a chunk without compression; the other marks are shorter.
        while start < self._size:
            block = self.file.read(start, SEARCH_BYTES + overlap)
            marks = []
            for pattern in (CHECK_MARK, *_COMPRESSION_MARKS):
                at = block.find(pattern)
                if at >= 0:
                    marks.append((at, pattern))
            if plain := _PLAIN_CHUNK.search(block):
                marks.append((plain.start(), b""))
            if marks:
                at, pattern = min(marks)
                mark = start + at
                if not pattern:
                    return mark, mark
                if pattern != CHECK_MARK:
                    return mark, mark - CHUNK_NAME_AT
                length = int.from_bytes(self.file.read(mark + len(pattern), 4), "little")
                return mark, mark - length
            start += SEARCH_BYTES
        return None


def _in_order(index: Index) -> dict[int, list[tuple[int, int]]]:
    return {channel: sorted(zip(entries[::2], entries[1::2], strict=True)) for channel, entries in index.items()}
