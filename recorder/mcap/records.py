"""An MCAP file piece by piece, in its order and in any state: chunks, still packed, and the records around.

What is wrong with a file is a value, a Fault, and the reading goes on where it can: behind a damaged record it
looks for the next piece that proves itself by a checksum. Nothing of a chunk is read from the disk before it is
unpacked, so who wants few of them pays for few.
"""

from __future__ import annotations

import struct
import sys
import zlib
from array import array
from collections.abc import Generator, Iterator, Mapping
from io import BytesIO
from typing import BinaryIO, Final

import msgspec
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream

from recorder.mcap.scan import BROKEN, RECORD_MAX, Scanner
from recorder.mcap.summary import CHECK, CHECK_OPCODE, FOOTER_LENGTH, MAGIC, RECORD_HEADER

_CHUNK_TIMES: Final = struct.Struct("<QQ")
_INDEX_HEAD: Final = struct.Struct("<HI")
COMPRESSIONS: Final = frozenset({"", "lz4", "zstd"})
"""All that MCAP's registry names; the mcap package takes any other name for none."""

_BLOCK_BYTES: Final = 1 << 20
"""All that is read goes by in such blocks; where most is passed over, in smaller ones."""
_GLANCE_BYTES: Final = 1 << 13

_PARSED: Final = {
    Opcode.HEADER: records.Header.read,
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.STATISTICS: records.Statistics.read,
}


class Fault(msgspec.Struct, frozen=True):
    """Something wrong with the file.

    Attributes:
        offset: where in the file, in bytes.
        cuts: nothing can be read beyond it.
    """

    offset: int
    detail: str
    cuts: bool = False


class End(msgspec.Struct, frozen=True):
    """The footer and the closing magic: the file is whole, but for the faults before."""


class SummaryStart(msgspec.Struct, frozen=True):
    """The data ends here; what follows repeats some of it."""


class LooseMessage(msgspec.Struct, frozen=True):
    """A message record outside of chunks.

    Attributes:
        offset: in the file, in bytes.
        raw: the whole record, opcode and length included.
    """

    offset: int
    raw: bytes


class PackedChunk(msgspec.Struct, frozen=True):
    """A chunk, not yet read.

    Attributes:
        offset, length: of the chunk's record in the file, opcode and length included.
        start_ns, end_ns: log times of its first and last message, as its head says.
        index: of each channel the log time and the offset of each message, in turns, as the message indexes
            behind the chunk say; None if there are none, or some may be missing. Nothing has proven them.
        places: of each channel in ``index`` where in the file its message index stands.
        end: where in the file the message indexes end.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    index: Mapping[int, array[int]] | None
    places: Mapping[int, int]
    end: int

    def read(self, stream: BinaryIO) -> records.Chunk:
        """The chunk as it stands in the file.

        Raises:
            what ``recorder.mcap.scan.BROKEN`` lists: it is damaged.
        """
        stream.seek(self.offset + RECORD_HEADER.size)
        body = stream.read(self.length - RECORD_HEADER.size)
        chunk: records.Chunk = records.Chunk.read(ReadDataStream(BytesIO(body)))
        return chunk

    def unpack(self, stream: BinaryIO, chunk: records.Chunk | None = None) -> bytes:
        """The chunk's records; its checksum is verified.

        Args:
            stream: the file.
            chunk: what ``read`` has given, if that was asked before.

        Raises:
            what ``recorder.mcap.scan.BROKEN`` lists: it is damaged, or packed in a way that nobody here knows.
        """
        chunk = chunk or self.read(stream)
        if chunk.compression not in COMPRESSIONS:
            raise ValueError(f"its compression {chunk.compression!r} is not known here")
        if chunk.uncompressed_size > RECORD_MAX:
            raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes is too large")
        if chunk.compression == "zstd" and zstandard.frame_content_size(chunk.data) not in {
            -1,
            chunk.uncompressed_size,
        }:
            raise ValueError("a chunk's sizes differ")
        content, length = get_chunk_data_stream(chunk, validate_crc=True)
        return bytes(content.read(length))


Piece = (
    records.Header
    | records.Schema
    | records.Channel
    | records.Attachment
    | records.Metadata
    | records.Statistics
    | LooseMessage
    | PackedChunk
    | SummaryStart
    | Fault
    | End
)


def read_pieces(stream: BinaryIO, size: int, *, is_verifying: bool = True) -> Iterator[Piece]:
    """What a file holds. Schemas, channels and statistics come again from the summary.

    Args:
        stream: the file, which can be sought in; it is past the opening magic, or will be taken to be.
        size: its length in bytes.
        is_verifying: hold the data, the checks and the summary against their checksums too, which reads every
            byte. A chunk's own is verified whenever it is unpacked.
    """
    return _Reading(stream, size, is_verifying=is_verifying).pieces()


def _is_no_opcode(opcode: int) -> bool:
    return opcode == 0 or max(Opcode) < opcode < CHECK_OPCODE


class _Reading:
    def __init__(self, stream: BinaryIO, size: int, *, is_verifying: bool) -> None:
        self._stream = stream
        self._size = size
        self._is_verifying = is_verifying
        # Of the data section up to its end, then of the summary; None once bytes were passed over.
        self._crc: int | None = zlib.crc32(MAGIC)
        # Where the record before begins and ends: a check repeats its length and checksum.
        self._last = (0, 0)
        self._block = b""
        self._block_at = 0
        self._block_bytes = _BLOCK_BYTES if is_verifying else _GLANCE_BYTES

    def pieces(self) -> Iterator[Piece]:
        offset = len(MAGIC)
        while offset < self._size:
            head = self._read(offset, RECORD_HEADER.size)
            opcode, length = RECORD_HEADER.unpack(head) if len(head) == RECORD_HEADER.size else (0, self._size)
            if length > self._size - offset - len(head):
                behind = yield from self._pass_over(offset, "the file is cut off within a record")
            elif _is_no_opcode(opcode):
                behind = yield from self._pass_over(offset, "this is no record")
            elif opcode == Opcode.FOOTER:
                yield from self._end(offset, head, length)
                return
            else:
                behind = yield from self._record(offset, opcode, length)
            if behind is None:
                return
            offset = behind
        yield Fault(self._size, "the file ends without a footer", cuts=True)

    def _read(self, offset: int, length: int) -> bytes:
        start = offset - self._block_at
        if start < 0 or start + length > len(self._block):
            self._stream.seek(offset)
            self._block = self._stream.read(max(length, self._block_bytes))
            self._block_at, start = offset, 0
        return self._block[start : start + length]

    def _pass_over(self, offset: int, detail: str) -> Generator[Piece, None, int | None]:
        """Looks for the next piece. Returns, at the end of the iteration, where it is; None if there is none."""
        behind = Scanner(self._stream, self._size).next_piece(offset)
        self._crc = None
        yield Fault(offset, detail, cuts=behind is None)
        return behind

    def _record(self, offset: int, opcode: int, length: int) -> Generator[Piece, None, int]:
        """One record, and with a chunk its indexes. Returns, at the end, where the next one begins."""
        end = offset + RECORD_HEADER.size + length
        if opcode == Opcode.DATA_END:
            yield from self._data_end(offset, end)
            return end
        before, self._last = self._last, (offset, end)
        self._take(offset, end)
        if opcode == CHECK_OPCODE:
            is_ours = length == CHECK.size - RECORD_HEADER.size
            if self._is_verifying and is_ours and self._read(offset, CHECK.size) != self._check_of(*before):
                yield Fault(offset, "the check of the record before is wrong")
        elif opcode == Opcode.CHUNK:
            end = yield from self._chunk(offset, end)
        elif opcode == Opcode.MESSAGE:
            yield LooseMessage(offset, self._read(offset, end - offset))
        elif opcode == Opcode.ATTACHMENT or opcode in _PARSED:
            yield from self._other(offset, opcode, self._read(offset + RECORD_HEADER.size, length))
        return end

    def _take(self, offset: int, end: int) -> None:
        """Adds bytes of the file to the checksum of all."""
        if self._is_verifying and self._crc is not None:
            self._crc = self._crc_of(offset, end, self._crc)

    def _crc_of(self, offset: int, end: int, crc: int = 0) -> int:
        for start in range(offset, end, _BLOCK_BYTES):
            crc = zlib.crc32(self._read(start, min(_BLOCK_BYTES, end - start)), crc)
        return crc

    def _check_of(self, offset: int, end: int) -> bytes:
        """The check that belongs behind this record."""
        # A longer record than a check can hold is none of ours.
        length = min(end - offset, 2**32 - 1)
        return CHECK.pack(CHECK_OPCODE, CHECK.size - RECORD_HEADER.size, length, self._crc_of(offset, end))

    def _data_end(self, offset: int, end: int) -> Iterator[Piece]:
        expected = int.from_bytes(self._read(offset + RECORD_HEADER.size, 4), "little")
        if end - offset != RECORD_HEADER.size + 4:
            yield Fault(offset, "the end of the data cannot be read")
        elif self._is_verifying and self._crc is not None and expected not in {0, self._crc}:
            yield Fault(offset, "the data's checksum is wrong")
        self._crc = 0
        yield SummaryStart()

    def _chunk(self, offset: int, end: int) -> Generator[Piece, None, int]:
        """Yields the chunk. Returns where its message indexes end."""
        times = self._read(offset + RECORD_HEADER.size, _CHUNK_TIMES.size)
        length = end - offset
        index: dict[int, array[int]] = {}
        places: dict[int, int] = {}
        while (entry := self._index(end)) is not None:
            channel_id, entries, behind = entry
            self._last = end, behind
            index.setdefault(channel_id, array("Q")).extend(entries)
            places.setdefault(channel_id, end)
            end = behind
        self._take(offset + length, end)
        if len(times) == _CHUNK_TIMES.size:
            start_ns, end_ns = _CHUNK_TIMES.unpack(times)
            is_all = bool(index) and self._is_record(end)
            yield PackedChunk(offset, length, start_ns, end_ns, index if is_all else None, places, end)
        else:
            yield Fault(offset, "a chunk is too short")
        return end

    def _is_record(self, offset: int) -> bool:
        """Whether a whole record of another kind follows. Else one of the message indexes may be missing."""
        head = self._read(offset, RECORD_HEADER.size)
        if len(head) < RECORD_HEADER.size:
            return False
        opcode, length = RECORD_HEADER.unpack(head)
        is_other = not _is_no_opcode(opcode) and opcode != Opcode.MESSAGE_INDEX
        return is_other and offset + len(head) + int(length) <= self._size

    def _index(self, offset: int) -> tuple[int, array[int], int] | None:
        """The message index there: its channel, its entries, and where it ends; None if there is none."""
        head = self._read(offset, RECORD_HEADER.size + _INDEX_HEAD.size)
        if len(head) < RECORD_HEADER.size + _INDEX_HEAD.size or head[0] != Opcode.MESSAGE_INDEX:
            return None
        _, length = RECORD_HEADER.unpack_from(head)
        channel_id, entries_length = _INDEX_HEAD.unpack_from(head, RECORD_HEADER.size)
        behind = offset + RECORD_HEADER.size + length
        if length != _INDEX_HEAD.size + entries_length or entries_length % 16 or behind > self._size:
            return None
        entries = array("Q")
        entries.frombytes(self._read(offset + len(head), entries_length))
        if sys.byteorder == "big":
            entries.byteswap()
        return channel_id, entries, behind

    def _other(self, offset: int, opcode: int, body: bytes) -> Iterator[Piece]:
        try:
            if opcode == Opcode.ATTACHMENT:
                attachment = records.Attachment.read(ReadDataStream(BytesIO(body)))
                if int.from_bytes(body[-4:], "little") not in {0, zlib.crc32(body[:-4])}:
                    yield Fault(offset, "an attachment's checksum is wrong")
                yield attachment
            else:
                yield _PARSED[Opcode(opcode)](ReadDataStream(BytesIO(body)))
        except BROKEN as error:
            yield Fault(offset, f"a record cannot be read: {error}")

    def _end(self, offset: int, head: bytes, length: int) -> Iterator[Piece]:
        if length != FOOTER_LENGTH:
            yield Fault(offset, "the footer cannot be read", cuts=True)
            return
        body = self._read(offset + len(head), length)
        rest = self._read(offset + len(head) + length, len(MAGIC) + 1)
        if self._is_verifying and self._crc is not None:
            expected = int.from_bytes(body[-4:], "little")
            if expected not in {0, zlib.crc32(body[:-4], zlib.crc32(head, self._crc))}:
                yield Fault(offset, "the summary's checksum is wrong")
        if rest == MAGIC:
            yield End()
        elif rest.startswith(MAGIC):
            yield Fault(offset, "there is more behind the end of the file")
            yield End()
        else:
            yield Fault(offset, "the file is cut off within its last bytes", cuts=True)
