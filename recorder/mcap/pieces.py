"""The pieces of an MCAP file in order, and the proof of their content. Pure, except for the stream.

A chunk is found packed. Unpacked it is a block of messages, like a single message outside of chunks. A block is
read message by message, by its index, or with many others as numpy arrays (``arrays``).

In a damaged or unfinished file a checksum proves each intact piece: a chunk with its message indexes, or another
record with the check behind it. After damage the scan continues at the next proven piece. In a file of another
application, without checks, a record outside of chunks is accepted as it is.
"""

from __future__ import annotations

import re
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from itertools import repeat
from typing import BinaryIO, Final, TypeVar, cast

import msgspec
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap import records
from mcap.opcode import Opcode

from recorder.mcap.framing import (
    BROKEN,
    CHECK,
    CHECK_MARK,
    CHECK_OPCODE,
    CHUNK_NAME_AT,
    DECLARED_MAX,
    FIRST_RECORD,
    FOOTER,
    HEADER_IN_LENGTH,
    LAST_OPCODE,
    MAGIC,
    MESSAGE_HEADER,
    MESSAGE_OPCODE,
    RECORD_HEADER,
    RECORD_MAX,
    RECORDS_MAX,
    UNPACKED_MAX,
    DamagedError,
    RecordFile,
    check_of,
    has_wrong_crc,
    parse,
    parsing,
)
from recorder.mcap.summary_reader import IndexedChunk, place_entries

NO_RECORD: Final = "a chunk holds what is no record"
HALF_RECORD: Final = "a chunk holds half a record"
TOO_MANY_RECORDS: Final = f"a chunk holds more than {RECORDS_MAX} records"
TOO_MUCH_DECLARED: Final = f"schemas and channels in chunks are longer than {DECLARED_MAX} bytes"

_CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""A chunk up to the name of its compression: two times, size and checksum unpacked, length of the name."""

_ZSTD_HEAD: Final = struct.Struct("<QQQII4sQ")  # a zstd chunk up to its data

_DECLARED: Final = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})  # besides messages, what a chunk may hold

Topic = TypeVar("Topic")
Made = TypeVar("Made")

Index = Mapping[int, "array[int]"]
"""Per channel, alternating log time and offset in the block of each message."""


class Fault(msgspec.Struct, frozen=True):
    """A fault of the file, at ``offset`` bytes. ``cuts``: nothing after it can be read."""

    offset: int
    detail: str
    cuts: bool = False


class LoggedMessage(msgspec.Struct, frozen=True, gc=False):
    """A message record. Times are nanoseconds since 1970."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


Declared = records.Schema | records.Channel


class DeclaredRoom:
    """The limit of schemas and channels in the chunks of one file; each id counts once."""

    def __init__(self) -> None:
        self._left = DECLARED_MAX
        self._seen: set[tuple[int, bytes]] = set()

    def read(self, opcode: int, body: bytes) -> Declared:
        key = opcode, body[:2]
        if key not in self._seen:
            if len(body) > self._left:
                raise DamagedError(TOO_MUCH_DECLARED)
            self._seen.add(key)
            self._left -= len(body)
        return cast("Declared", parse(opcode, body))


class MessageBlock(msgspec.Struct, frozen=True):
    """Message records, and the schemas and channels that other applications put between them.

    Attributes:
        offset: of the chunk, or of the first record outside of chunks, in the file.
        content: the records, opcodes and lengths included.
    """

    offset: int
    content: bytes
    room: DeclaredRoom = msgspec.field(default_factory=DeclaredRoom)

    @property
    def is_single(self) -> bool:
        content = self.content
        return len(content) >= MESSAGE_HEADER.size and RECORD_HEADER.unpack_from(content) == (
            MESSAGE_OPCODE,
            len(content) - RECORD_HEADER.size,
        )

    def messages(self) -> Iterator[LoggedMessage | Declared | Fault]:
        """The records one by one; a Fault comes last."""
        content = self.content
        unpack, head = MESSAGE_HEADER.unpack_from, MESSAGE_HEADER.size
        try:
            for opcode, start, end in split(content):
                if opcode == MESSAGE_OPCODE:
                    _, _, channel_id, sequence, log_ns, publish_ns = unpack(content, start)
                    yield LoggedMessage(channel_id, sequence, log_ns, publish_ns, content[start + head : end])
                elif opcode in _DECLARED:
                    yield self.room.read(opcode, content[start + RECORD_HEADER.size : end])
        except BROKEN as error:
            yield Fault(self.offset, _in_words(error))

    def read_index(self) -> tuple[Index, list[Declared | Fault]]:
        """Walk the records. Returns the messages' index and all other records; a Fault comes last."""
        index, declared, why = _index_of(self.content, self.room)
        return index, [*declared, *([Fault(self.offset, why)] if why else [])]

    def pick(
        self,
        index: Index,
        wanted: Mapping[int, Topic],
        make: Callable[[Topic, int, int, int, bytes], Made],
        from_ns: int,
        to_ns: int,
    ) -> list[Made] | None:
        """The wanted messages in the order of the block; None if the index does not match the messages.

        Args:
            index: of the message indexes behind the chunk.
            wanted: the first argument of ``make`` for each channel; other channels are skipped.
            make: gets that argument, sequence, log time, publish time and data of a message.
        """
        if has_too_many(index):
            return None
        places: list[tuple[int, int, int]] = []
        for channel, entries in index.items():
            if channel in wanted:
                places += zip(entries[1::2], entries[::2], repeat(channel), strict=False)
        places.sort()
        content = self.content
        unpack, head, end = MESSAGE_HEADER.unpack_from, MESSAGE_HEADER.size, len(content)
        made = []
        try:
            for offset, expected_ns, expected_id in places:
                opcode, length, channel_id, sequence, log_ns, publish_ns = unpack(content, offset)
                behind = offset + RECORD_HEADER.size + length
                if opcode != MESSAGE_OPCODE or length < HEADER_IN_LENGTH or behind > end:
                    return None
                if channel_id != expected_id or log_ns != expected_ns:
                    return None
                if from_ns <= log_ns < to_ns:
                    data = content[offset + head : behind]
                    made.append(make(wanted[channel_id], sequence, log_ns, publish_ns, data))
        except (struct.error, OverflowError):
            # Beyond the content, or beyond the address range.
            return None
        return made


class PackedChunk(msgspec.Struct, frozen=True):
    """A chunk that is not yet read.

    Attributes:
        offset, length: of the chunk's record in the file, opcode and length included.
        start_ns, end_ns: log times of the first and last message, by its head.
        index: of the message indexes behind the chunk, unproven; None if there are none, or some may be missing.
        places: offset in the file of each channel's message index.
        end: the end of the message indexes in the file.
    """

    stream: BinaryIO
    offset: int
    length: int
    start_ns: int
    end_ns: int
    index: Index | None
    places: Mapping[int, int]
    end: int
    room: DeclaredRoom

    def unpack(self) -> MessageBlock:
        """The chunk's records, with a verified checksum; DamagedError if they cannot be unpacked."""
        with parsing():
            size = self.length - RECORD_HEADER.size
            if size > RECORD_MAX:
                raise DamagedError(f"a chunk of {size} bytes is too large")
            self.stream.seek(self.offset + RECORD_HEADER.size)
            return MessageBlock(self.offset, _content(self.stream.read(size)), self.room)

    def read_index(self) -> tuple[Index, list[Declared | Fault]]:
        """As ``MessageBlock.read_index``; ignores the message indexes."""
        try:
            return self.unpack().read_index()
        except DamagedError as error:
            return {}, [Fault(self.offset, f"a chunk cannot be read: {error}")]

    def described(self) -> IndexedChunk:
        """The entry that the summary should hold of this chunk, if it can be unpacked."""
        self.stream.seek(self.offset + RECORD_HEADER.size)
        start_ns, end_ns, unpacked, _, name_length = _CHUNK_HEAD.unpack(self.stream.read(_CHUNK_HEAD.size))
        return IndexedChunk(
            start_ns=start_ns,
            end_ns=end_ns,
            offset=self.offset,
            length=self.length,
            places=place_entries(self.places),
            indexes_length=self.end - self.offset - self.length,
            compression=self.stream.read(name_length),
            packed=int.from_bytes(self.stream.read(8), "little"),
            unpacked=unpacked,
        )


def content_of(chunk: records.Chunk) -> bytes:
    """The records of a chunk, with its checksum verified if it has one. Raises what ``framing.BROKEN`` lists."""
    if chunk.compression not in _UNPACKERS:
        raise DamagedError(f"its compression {chunk.compression!r} is not supported")
    if chunk.uncompressed_size > (UNPACKED_MAX if chunk.compression else RECORD_MAX):
        raise DamagedError(f"a chunk of {chunk.uncompressed_size} bytes is too large")
    content = _UNPACKERS[chunk.compression](chunk.data, chunk.uncompressed_size)
    if len(content) != chunk.uncompressed_size:
        raise DamagedError("a chunk's sizes differ")
    if chunk.uncompressed_crc not in {0, zlib.crc32(content)}:
        raise DamagedError("its checksum is wrong")
    return content


def _from_lz4(data: bytes, size: int) -> bytes:
    """The content of all frames, or one byte more than it should have."""
    content = b""
    while data and len(content) <= size:
        unpacking = LZ4FrameDecompressor()
        content += unpacking.decompress(data, max_length=size + 1 - len(content))
        if not unpacking.eof:
            raise DamagedError("a chunk's sizes differ")
        data = unpacking.unused_data or b""
    return content


def _from_zstd(data: bytes, size: int) -> bytes:
    try:
        return zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(size + 1)
    except zstandard.ZstdError as error:
        raise DamagedError(f"decompression error: {str(error).rpartition(': ')[2]}") from error


_UNPACKERS: Final[Mapping[str, Callable[[bytes, int], bytes]]] = {
    "": lambda data, _: data,
    "lz4": _from_lz4,
    "zstd": _from_zstd,
}
"""All compressions of MCAP's registry."""


def _content(body: bytes) -> bytes:
    """The records of a chunk's record, with a fast path for chunks of our recorder."""
    if len(body) > _ZSTD_HEAD.size:
        _, _, size, crc, name_length, name, length = _ZSTD_HEAD.unpack_from(body)
        data = memoryview(body)[_ZSTD_HEAD.size :]
        is_plain = (name_length, name, length) == (4, b"zstd", len(data)) and crc and size <= UNPACKED_MAX
        if is_plain and zstandard.frame_content_size(data) == size:
            with suppress(zstandard.ZstdError):
                content = zstandard.decompress(data)
                if len(content) == size and zlib.crc32(content) == crc:
                    return content
    # Finds the fault, or reads another kind of packing.
    return content_of(parse(Opcode.CHUNK, body))


def split(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of each record in a chunk. DamagedError or struct.error if these are no records."""
    unpack = RECORD_HEADER.unpack_from
    start, size, left = 0, len(content), RECORDS_MAX
    while start < size:
        if not left:
            raise DamagedError(TOO_MANY_RECORDS)
        left -= 1
        opcode, length = unpack(content, start)
        end = start + RECORD_HEADER.size + length
        if end > size or (opcode == MESSAGE_OPCODE and length < HEADER_IN_LENGTH):
            raise DamagedError(HALF_RECORD)
        if not opcode:
            # Else every nine zeros would count as a record, and keep a reader busy for minutes.
            raise DamagedError(NO_RECORD)
        yield opcode, start, end
        start = end


def has_too_many(index: Index) -> bool:
    """True of an index with more records than a chunk may hold."""
    return sum(map(len, index.values())) > 2 * RECORDS_MAX


def index_content(content: bytes, room: DeclaredRoom | None = None) -> tuple[Index, list[Declared]]:
    """The index of a chunk's messages, and the schemas and channels among them."""
    index, declared, why = _index_of(content, room or DeclaredRoom())
    if why:
        raise DamagedError(why)
    return index, declared


def _index_of(content: bytes, room: DeclaredRoom) -> tuple[Index, list[Declared], str]:
    """The index and declarations up to the first fault, and the fault's text; empty if there is none.

    A text, because a stored exception would hold the chunk by its traceback.
    """
    index: dict[int, array[int]] = {}
    declared: list[Declared] = []
    unpack = MESSAGE_HEADER.unpack_from
    try:
        for opcode, start, end in split(content):
            if opcode == MESSAGE_OPCODE:
                _, _, channel_id, _, log_ns, _ = unpack(content, start)
                entries = index.get(channel_id)
                if entries is None:
                    entries = index[channel_id] = array("Q")
                entries.append(log_ns)
                entries.append(start)
            elif opcode in _DECLARED:
                declared.append(room.read(opcode, content[start + RECORD_HEADER.size : end]))
    except BROKEN as error:
        return index, declared, _in_words(error)
    return index, declared, ""


def _in_words(error: Exception) -> str:
    return str(error) if isinstance(error, DamagedError) else f"a record cannot be read: {error}"


SEARCH_BYTES: Final = 1 << 20  # read at once in the search for the next whole piece
LOOK_FOR_CHECKS: Final = 4096  # our files have several checks within this many bytes

_COMPRESSION_MARKS: Final = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")

_PLAIN_CHUNK: Final = re.compile(rb"\x06[\s\S]{5}\0\0\0[\s\S]{28}\0\0\0\0")
"""The head of an uncompressed chunk of permitted length."""

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
    """A chunk whose content is proven by its CRC.

    Attributes:
        offset, chunk_end, end: start of the chunk, end of its record, and end of the message indexes behind it.
        record: the chunk with the times of its content.
        index: built from the content.
        raw: the bytes of the chunk and of its message indexes in the file.
        places: offset in ``raw`` of each channel's message index; None if the indexes are wrong.
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
        raw: the bytes of both; the first ``length`` are the record's.
        parsed: None for messages and application records.
    """

    offset: int
    end: int
    raw: bytes
    length: int
    parsed: Parsed | None


class DataEnd(msgspec.Struct, frozen=True):
    """The end of the data; the rest can be rebuilt. ``crc`` is the stated checksum of all data, 0 if none."""

    offset: int
    end: int
    crc: int


Found = ProvenChunk | ProvenRecord | DataEnd | Fault


class Scanner:
    """Scans a file for pieces."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.file = RecordFile(stream, size)
        self._size = size
        self._room = DeclaredRoom()

    @cached_property
    def has_checks(self) -> bool:
        """True if our recorder wrote it; verified, as other applications may use the check's opcode."""
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
        """Return True if only the beginning of one last write follows there, or nothing."""
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
        """The piece there, or a Fault if it is not proven."""
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
        # Any other must be confirmed by the whole file: else damage could end the data too early.
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
        # Other applications may order them differently, or omit them.
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
        """The first possible mark of a piece from there on, and where that piece would begin."""
        overlap = CHUNK_NAME_AT + 4  # The head of an uncompressed chunk; the other marks are shorter.
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
