"""The reader of MCAP files: piece by piece, in the file's order and in any state; whole, cut off or damaged.

    for piece in read_pieces(stream, size):
        match piece:
            case PackedChunk():     # .index and times are known; .unpack() and .read_index() read it
            case MessageBlock():    # a message outside of chunks: .messages()
            case records.Schema() | records.Channel() | records.Metadata() | ...:
            case Fault():           # what is wrong, and where; the reading continues if possible
            case SummaryStart():    # the rest repeats some of the data
            case End():

After a damaged record the reader looks for the next piece that is proven by a checksum (``pieces``). A chunk is
read from the disk only when it is unpacked.

``record_at`` reads one record, ``summary_reader`` the end of a file, ``recovery`` the good data of a damaged one.
"""

from __future__ import annotations

import zlib
from array import array
from collections.abc import Generator, Iterator
from typing import BinaryIO, Final

import msgspec
from mcap import records
from mcap.opcode import Opcode

from recorder.mcap.framing import (
    BROKEN,
    CHECK,
    CHECK_OPCODE,
    CHUNK_TIMES,
    FIRST_RECORD,
    FOOTER,
    MAGIC,
    RECORD_HEADER,
    DamagedError,
    RecordFile,
    check_of,
    has_wrong_crc,
    is_reserved,
    parse,
    record_at,
)
from recorder.mcap.pieces import DeclaredRoom, Fault, Index, LoggedMessage, MessageBlock, PackedChunk, Scanner

__all__ = [
    "FIRST_RECORD",
    "DamagedError",
    "DeclaredRoom",
    "End",
    "Fault",
    "Index",
    "LoggedMessage",
    "MessageBlock",
    "PackedChunk",
    "PassedOver",
    "Piece",
    "SummaryStart",
    "is_mcap",
    "read_pieces",
    "record_at",
]

_BLOCK_BYTES: Final = 1 << 20  # read at once
_GLANCE_BYTES: Final = 1 << 13  # read at once where most is skipped

_YIELDED: Final = frozenset(
    {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.STATISTICS}
)


class End(msgspec.Struct, frozen=True):
    """The footer and the closing magic: the file is whole, except for earlier faults."""


class PassedOver(msgspec.Struct, frozen=True):
    """A skipped record of a later version of MCAP."""

    offset: int
    opcode: int


class SummaryStart(msgspec.Struct, frozen=True):
    """The end of the data; the rest repeats some of it."""


Piece = (
    records.Header
    | records.Schema
    | records.Channel
    | records.Attachment
    | records.Metadata
    | records.Statistics
    | MessageBlock
    | PackedChunk
    | PassedOver
    | SummaryStart
    | Fault
    | End
)


def is_mcap(stream: BinaryIO) -> bool:
    """Report whether a file begins as MCAP does."""
    stream.seek(0)
    return stream.read(len(MAGIC)) == MAGIC


def read_pieces(stream: BinaryIO, size: int, *, is_verifying: bool = True) -> Iterator[Piece]:
    """The pieces of a file. Schemas, channels and statistics come again from the summary.

    Args:
        is_verifying: also verify data, checks and summary, which reads every byte. Unpacking a chunk always
            verifies its checksum.
    """
    return _Reading(stream, size, is_verifying=is_verifying).pieces()


class _Reading:
    def __init__(self, stream: BinaryIO, size: int, *, is_verifying: bool) -> None:
        self._stream = stream
        self._file = RecordFile(stream, size, _BLOCK_BYTES if is_verifying else _GLANCE_BYTES)
        self._scanner = Scanner(stream, size)
        self._room = DeclaredRoom()
        self._is_verifying = is_verifying
        self._crc: int | None = zlib.crc32(MAGIC)  # of the data, then of the summary; None once bytes were skipped
        self._last = (0, 0)  # start and end of the previous record, to which a check applies

    def pieces(self) -> Iterator[Piece]:
        offset, size = FIRST_RECORD, self._file.size
        while offset < size:
            opcode, end = self._file.header(offset) or (0, size + 1)
            if end > size:
                behind = yield from self._pass_over(offset, "the file is cut off within a record")
            elif not opcode or (is_reserved(opcode) and not self._is_record(end)):
                behind = yield from self._pass_over(offset, "this is no record")
            elif opcode == Opcode.FOOTER:
                yield from self._end(offset, end)
                return
            else:
                behind = yield from self._record(offset, opcode, end)
            if behind is None:
                return
            offset = behind
        yield Fault(size, "the file ends without a footer", cuts=True)

    def _is_record(self, offset: int) -> bool:
        """Return True if a record that fits into the file is there, or the closing magic."""
        opcode, end = self._file.header(offset) or (0, 0)
        return (bool(opcode) and end <= self._file.size) or self._file.read(offset, len(MAGIC) + 1) == MAGIC

    def _pass_over(self, offset: int, detail: str) -> Generator[Piece, None, int | None]:
        """Yield a Fault. Returns the offset of the next piece, if any."""
        behind = self._scanner.next_piece(offset)
        self._crc = None
        yield Fault(offset, detail, cuts=behind is None)
        return behind

    def _record(self, offset: int, opcode: int, end: int) -> Generator[Piece, None, int]:
        """Yield a record, a chunk with its indexes. Returns the offset of the next one."""
        if opcode == Opcode.DATA_END:
            yield from self._data_end(offset, end)
            return end
        before, self._last = self._last, (offset, end)
        self._take(offset, end)
        if opcode == CHECK_OPCODE:
            is_wrong = self._is_verifying and self._file.read(offset, end - offset) != self._check_of(*before)
            # Records of other applications may have this opcode too.
            if is_wrong and end - offset == CHECK.size and self._scanner.has_checks:
                yield Fault(offset, "the check of the record before is wrong")
        elif opcode == Opcode.CHUNK:
            end = yield from self._chunk(offset, end)
        elif opcode == Opcode.MESSAGE:
            yield MessageBlock(offset, self._file.read(offset, end - offset))
        elif is_reserved(opcode):
            yield PassedOver(offset, opcode)
        elif opcode in _YIELDED:
            yield from self._other(offset, opcode, self._body(offset, end))
        return end

    def _body(self, offset: int, end: int) -> bytes:
        return self._file.read(offset + RECORD_HEADER.size, end - offset - RECORD_HEADER.size)

    def _take(self, offset: int, end: int) -> None:
        """Add bytes of the file to the checksum of all."""
        if self._is_verifying and self._crc is not None:
            self._crc = self._crc_of(offset, end, self._crc)

    def _crc_of(self, offset: int, end: int, crc: int = 0) -> int:
        for start in range(offset, end, _BLOCK_BYTES):
            crc = zlib.crc32(self._file.read(start, min(_BLOCK_BYTES, end - start)), crc)
        return crc

    def _check_of(self, offset: int, end: int) -> bytes:
        """The check of this record."""
        # Records too long for a check are not ours.
        return check_of(min(end - offset, 2**32 - 1), self._crc_of(offset, end))

    def _data_end(self, offset: int, end: int) -> Iterator[Piece]:
        expected = int.from_bytes(self._file.read(offset + RECORD_HEADER.size, 4), "little")
        if end - offset < RECORD_HEADER.size + 4:
            yield Fault(offset, "the end of the data cannot be read")
        elif self._is_verifying and self._crc is not None and expected not in {0, self._crc}:
            yield Fault(offset, "the data's checksum is wrong")
        self._crc = 0
        yield SummaryStart()

    def _chunk(self, offset: int, end: int) -> Generator[Piece, None, int]:
        """Yield the chunk. Returns the end of its message indexes."""
        times = self._file.read(offset + RECORD_HEADER.size, CHUNK_TIMES.size)
        length = end - offset
        index: dict[int, array[int]] = {}
        places: dict[int, int] = {}
        while (entry := self._file.message_index(end)) is not None:
            channel_id, entries, behind = entry
            self._last = end, behind
            index.setdefault(channel_id, array("Q")).extend(entries)
            places.setdefault(channel_id, end)
            end = behind
        self._take(offset + length, end)
        if len(times) == CHUNK_TIMES.size:
            start_ns, end_ns = CHUNK_TIMES.unpack(times)
            is_all = bool(index) and self._is_other(end)
            found = index if is_all else None
            yield PackedChunk(self._stream, offset, length, start_ns, end_ns, found, places, end, self._room)
        else:
            yield Fault(offset, "a chunk is too short")
        return end

    def _is_other(self, offset: int) -> bool:
        """Return True if a whole record of another kind follows. Else a message index may be missing."""
        opcode, _ = self._file.header(offset) or (0, 0)
        return opcode != Opcode.MESSAGE_INDEX and self._is_record(offset)

    def _other(self, offset: int, opcode: int, body: bytes) -> Iterator[Piece]:
        try:
            record = parse(opcode, body)
        except BROKEN as error:
            yield Fault(offset, f"a record cannot be read: {error}")
            return
        if opcode == Opcode.ATTACHMENT and has_wrong_crc(body):
            yield Fault(offset, "an attachment's checksum is wrong")
        yield record

    def _end(self, offset: int, end: int) -> Iterator[Piece]:
        if end - offset != FOOTER.size:
            yield Fault(offset, "the footer cannot be read", cuts=True)
            return
        footer = self._file.read(offset, end - offset)
        rest = self._file.read(end, len(MAGIC) + 1)
        if self._is_verifying and self._crc is not None:
            expected = int.from_bytes(footer[-4:], "little")
            if expected not in {0, zlib.crc32(footer[:-4], self._crc)}:
                yield Fault(offset, "the summary's checksum is wrong")
        if rest == MAGIC:
            yield End()
        elif rest.startswith(MAGIC):
            yield Fault(offset, "there is more behind the end of the file")
            yield End()
        else:
            yield Fault(offset, "the file is cut off within its last bytes", cuts=True)
