"""The pieces that a reader finds in an MCAP file, and the one way to take a chunk apart. Pure, but for the stream.

A chunk is still packed when it is found. Unpacked it is a block of messages, as is a single message outside of
chunks; a block is read message by message, by its index, or with many others as numpy's arrays (``arrays``).
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from itertools import repeat
from typing import BinaryIO, Final, TypeVar, cast

import msgspec
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap import records
from mcap.opcode import Opcode

from recorder.mcap.framing import (
    BROKEN,
    DECLARED_MAX,
    HEADER_IN_LENGTH,
    MESSAGE_HEADER,
    MESSAGE_OPCODE,
    RECORD_HEADER,
    RECORD_MAX,
    RECORDS_MAX,
    UNPACKED_MAX,
    DamagedError,
    parse,
    parsing,
)
from recorder.mcap.summary_reader import IndexedChunk, place_entries

NO_RECORD: Final = "a chunk holds what is no record"
HALF_RECORD: Final = "a chunk holds half a record"
TOO_MANY_RECORDS: Final = f"a chunk holds more than {RECORDS_MAX} records"
TOO_MUCH_DECLARED: Final = f"schemas and channels in chunks are longer than {DECLARED_MAX} bytes"

_CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""A chunk's record up to the name of its compression: two times, size and checksum unpacked, the name's length."""

_ZSTD_HEAD: Final = struct.Struct("<QQQII4sQ")
"""The same of a chunk packed with zstd up to its data: the name, and the length of the data."""

_DECLARED: Final = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})
"""Besides messages, what a chunk may hold."""

Topic = TypeVar("Topic")
Made = TypeVar("Made")

Index = Mapping[int, "array[int]"]
"""Per channel the log time and the offset in the block of each message, in turns."""


class Fault(msgspec.Struct, frozen=True):
    """Something wrong with the file.

    Attributes:
        offset: its place in the file, in bytes.
        cuts: nothing can be read beyond it.
    """

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
    """The room for schemas and channels in the chunks of one file: those of a new id take of it."""

    def __init__(self) -> None:
        self._left = DECLARED_MAX
        self._seen: set[tuple[int, bytes]] = set()

    def read(self, opcode: int, body: bytes) -> Declared:
        """Return the record.

        Raises:
            DamagedError: there is no more room.
            and what ``framing.BROKEN`` lists.
        """
        key = opcode, body[:2]
        if key not in self._seen:
            if len(body) > self._left:
                raise DamagedError(TOO_MUCH_DECLARED)
            self._seen.add(key)
            self._left -= len(body)
        return cast("Declared", parse(opcode, body))


class MessageBlock(msgspec.Struct, frozen=True):
    """Message records, and between them the schemas and channels that others declare in chunks.

    Attributes:
        offset: of the chunk, or of the first record outside of chunks; in the file, in bytes.
        content: the records one after the other, opcodes and lengths included.
        room: for the schemas and channels of the file.
    """

    offset: int
    content: bytes
    room: DeclaredRoom = msgspec.field(default_factory=DeclaredRoom)

    @property
    def is_single(self) -> bool:
        """It is one message, and nothing else."""
        content = self.content
        return len(content) >= MESSAGE_HEADER.size and RECORD_HEADER.unpack_from(content) == (
            MESSAGE_OPCODE,
            len(content) - RECORD_HEADER.size,
        )

    def messages(self) -> Iterator[LoggedMessage | Declared | Fault]:
        """The records one by one; a Fault is the last."""
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
        """Return the places of the messages, record by record, and all other records; a Fault is the last."""
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
        """The wanted messages in the order of the block; None if an entry of the index does not fit its message.

        Args:
            index: as the message indexes behind the chunk say.
            wanted: the argument of ``make`` for each channel; messages of others are passed over.
            make: is given that, sequence, log time, publish time and data of each message.
            from_ns: the first log time.
            to_ns: the first one that is too late.
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
            # Beyond the content, or beyond what this machine can address.
            return None
        return made


class PackedChunk(msgspec.Struct, frozen=True):
    """A chunk, not yet read.

    Attributes:
        stream: the file.
        offset, length: of the chunk's record in the file, opcode and length included.
        start_ns, end_ns: log times of its first and last message, as its head says.
        index: of each channel the log time and the offset of each message, in turns, as the message indexes
            behind the chunk say; None if there are none, or some may be missing. Nothing has proven them.
        places: of each channel in ``index`` where in the file its message index stands.
        end: the end of the message indexes in the file.
        room: for the schemas and channels of the file.
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
        """The chunk's records; its checksum is verified.

        Raises:
            DamagedError: it is damaged, or packed in a way that nobody here knows.
        """
        with parsing():
            size = self.length - RECORD_HEADER.size
            if size > RECORD_MAX:
                raise DamagedError(f"a chunk of {size} bytes is too large")
            self.stream.seek(self.offset + RECORD_HEADER.size)
            return MessageBlock(self.offset, _content(self.stream.read(size)), self.room)

    def messages(self) -> Iterator[LoggedMessage | Declared | Fault]:
        """The records one by one; a Fault is the last, and the only one of a chunk that cannot be unpacked."""
        try:
            block = self.unpack()
        except DamagedError as error:
            yield Fault(self.offset, f"a chunk cannot be read: {error}")
        else:
            yield from block.messages()

    def read_index(self) -> tuple[Index, list[Declared | Fault]]:
        """As ``MessageBlock.read_index``, whatever the message indexes say."""
        try:
            return self.unpack().read_index()
        except DamagedError as error:
            return {}, [Fault(self.offset, f"a chunk cannot be read: {error}")]

    def described(self) -> IndexedChunk:
        """The chunk as the summary's index should describe it; of a chunk that can be unpacked."""
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
    """The records of a chunk, whose checksum is verified, if it has one.

    Raises:
        what ``framing.BROKEN`` lists.
    """
    if chunk.compression not in _UNPACKERS:
        raise DamagedError(f"its compression {chunk.compression!r} is not known here")
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
    """The content of all frames, or one byte more than it should have."""
    try:
        return zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(size + 1)
    except zstandard.ZstdError as error:
        raise DamagedError(f"decompression error: {str(error).rpartition(': ')[2]}") from error


_UNPACKERS: Final[Mapping[str, Callable[[bytes, int], bytes]]] = {
    "": lambda data, _: data,
    "lz4": _from_lz4,
    "zstd": _from_zstd,
}
"""All that MCAP's registry names."""


def _content(body: bytes) -> bytes:
    """The records of a chunk's record; those that a recorder of ours has packed without detours."""
    if len(body) > _ZSTD_HEAD.size:
        _, _, size, crc, name_length, name, length = _ZSTD_HEAD.unpack_from(body)
        data = memoryview(body)[_ZSTD_HEAD.size :]
        is_plain = (name_length, name, length) == (4, b"zstd", len(data)) and crc and size <= UNPACKED_MAX
        if is_plain and zstandard.frame_content_size(data) == size:
            with suppress(zstandard.ZstdError):
                content = zstandard.decompress(data)
                if len(content) == size and zlib.crc32(content) == crc:
                    return content
    # Whatever is wrong with it, or only another way to pack it, is found there.
    return content_of(parse(Opcode.CHUNK, body))


def split(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode of each record in a chunk, where it begins, and where it ends.

    Raises:
        DamagedError: these are no records.
        struct.error: a record's header is cut off.
    """
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
            # Else every nine zeros would count as a record: a bomb of them keeps a reader busy for minutes.
            raise DamagedError(NO_RECORD)
        yield opcode, start, end
        start = end


def has_too_many(index: Index) -> bool:
    """True of an index that names more records than a chunk may hold."""
    return sum(map(len, index.values())) > 2 * RECORDS_MAX


def index_content(content: bytes, room: DeclaredRoom | None = None) -> tuple[Index, list[Declared]]:
    """The index of a chunk's messages, and the schemas and channels among them.

    Raises:
        DamagedError: these are no records.
    """
    index, declared, why = _index_of(content, room or DeclaredRoom())
    if why:
        raise DamagedError(why)
    return index, declared


def _index_of(content: bytes, room: DeclaredRoom) -> tuple[Index, list[Declared], str]:
    """The same up to where these are no records, and what is wrong there; empty if nothing is.

    In words: an exception that is kept holds the chunk, by its traceback, until Python looks for garbage.
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
