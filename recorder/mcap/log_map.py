"""Where the chunks and channels of a log stand, found without reading the chunks. On any binary stream.

A log may be whole or still being written, and damaged: what cannot be read is skipped and counted, never raised.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from itertools import accumulate
from typing import BinaryIO, Final

import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream

from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import HEADER_IN_LENGTH, MESSAGE_HEADER, MESSAGE_OPCODE
from recorder.mcap.scan import BROKEN, RECORD_MAX, Scanner
from recorder.mcap.summary import CHECK, CHECK_OPCODE, MAGIC, RECORD_HEADER
from recorder.mcap.writer import MESSAGE_ENCODING, SCHEMA_ENCODING

EARLY_NS: Final = 60_000_000_000
"""A message is logged at most so long before its publish time: recorder and source differ in their clocks..."""

LATE_NS: Final = 600_000_000_000
"""...and at most so long after it: what a recorder asked a gateway for later stands among what came by itself.

A gateway keeps ten minutes of its journal at the bus's nominal load. A decision or an event of an idle robot may
be older when it is asked for, and is then not found by its time.
"""

SPAN_GAP_NS: Final = 1_000_000_000
"""Publish times of a chunk that lie further apart than this are two spans."""

DECLARATION_MAX: Final = 1 << 24
"""A schema or channel that says it is longer than this is damaged."""

LOOK_EVERY: Final = 256
"""Records between two looks at the time that is left."""

_CHUNK_TIMES: Final = struct.Struct("<QQ")
_HEAD_BYTES: Final = RECORD_HEADER.size + _CHUNK_TIMES.size
_FIRST_PRIVATE: Final = 0x80

Spans = tuple[tuple[int, int], ...]
"""First and last of publish times that lie close together, in order."""

Logged = tuple[int, int, int, int, bytes]
"""Channel, sequence, log time, publish time and data of a message."""


class LogMap:
    """A map of one log, which ``read_on`` takes further as the log grows.

    Attributes:
        channels: by id; those whose messages are protobuf, as a recorder of ours writes them.
        damaged: places that could not be read.
        is_complete: all that was in the log is on the map.
    """

    def __init__(self) -> None:
        self.channels: dict[int, LogChannel] = {}
        self.damaged = 0
        self.is_complete = False
        self._schemas: dict[int, records.Schema] = {}
        self._offset = 0
        self._has_ended = False
        self._sure = 0
        """Where the last chunk stands, or what was found behind damage..."""
        self._passed: set[int] = set()
        """...and the records since: a damaged length may have led past others."""
        self._offsets = array("Q")
        self._starts = array("Q")
        self._ends = array("Q")
        self._spans: dict[int, Spans] = {}
        self._others: set[int] = set()
        """Channels that are none of ours, and those that are lost."""
        self._sorted: tuple[list[int], list[int], list[int]] = ([], [], [])

    def __len__(self) -> int:
        """Chunks on the map."""
        return len(self._offsets)

    @property
    def start_ns(self) -> int:
        """The earliest log time of a chunk; of a map with chunks."""
        return min(self._starts)

    @property
    def end_ns(self) -> int:
        """The latest log time of a chunk; of a map with chunks."""
        return max(self._ends)

    def read_on(
        self,
        stream: BinaryIO,
        size: int,
        is_expired: Callable[[], bool] = lambda: False,
        chunks_max: int | None = None,
    ) -> None:
        """Go through the records that are not yet on the map.

        Args:
            stream: the log.
            size: its length in bytes.
            is_expired: leave the rest to the next time.
            chunks_max: the same, as soon as so many chunks are on the map.

        Raises:
            OSError: the stream cannot be read.
        """
        self.is_complete = False
        looks = 0
        while not self._has_ended:
            looks += 1
            if (chunks_max is not None and len(self) >= chunks_max) or (looks % LOOK_EVERY == 0 and is_expired()):
                return
            if not self._step(stream, size):
                break
        self.is_complete = True

    def near(self, from_ns: int, to_ns: int) -> list[int]:
        """The chunks that may hold what was published in [from_ns, to_ns), by their numbers, in order of time."""
        order, starts, ends = self._in_order()
        earliest, latest = from_ns - EARLY_NS, to_ns + LATE_NS
        # The latest end up to each place rises, so all chunks before the first place end too early.
        return [
            number
            for number in order[bisect_left(ends, earliest) : bisect_right(starts, latest)]
            if self._ends[number] >= earliest and self._may_hold(number, from_ns, to_ns)
        ]

    def read(self, stream: BinaryIO, number: int) -> list[Logged]:
        """The messages of a chunk; none if it is damaged.

        Raises:
            OSError: the stream cannot be read.
        """
        try:
            found = list(_messages(_content(stream, self._offsets[number])))
        except BROKEN:
            self.damaged += 1
            self._spans[number] = ()
            return []
        if number not in self._spans:
            self._spans[number] = _spans(message[3] for message in found)
            lost = {message[0] for message in found} - self.channels.keys() - self._others
            self.damaged += len(lost)
            self._others |= lost
        return found

    def messages(self, stream: BinaryIO) -> Iterator[Logged]:
        """Every message of a log whose channel is known, chunk by chunk.

        Raises:
            OSError: the stream cannot be read.
        """
        for number in range(len(self)):
            for message in self.read(stream, number):
                if message[0] in self.channels:
                    yield message

    def _may_hold(self, number: int, from_ns: int, to_ns: int) -> bool:
        spans = self._spans.get(number)
        return spans is None or any(first < to_ns and last >= from_ns for first, last in spans)

    def _in_order(self) -> tuple[list[int], list[int], list[int]]:
        """Chunks by the beginning of their log times, those beginnings, and the latest end up to each."""
        if len(self._sorted[0]) != len(self):
            order = sorted(range(len(self)), key=self._starts.__getitem__)
            starts = [self._starts[number] for number in order]
            ends = list(accumulate((self._ends[number] for number in order), max))
            self._sorted = order, starts, ends
        return self._sorted

    def _step(self, stream: BinaryIO, size: int) -> bool:
        """Take the next record. False if there is none, or not all of it yet."""
        offset = self._offset
        stream.seek(offset)
        if not offset:
            return self._begin(stream.read(len(MAGIC)))
        head = stream.read(_HEAD_BYTES)
        if len(head) < RECORD_HEADER.size:
            return False
        opcode, length = RECORD_HEADER.unpack_from(head)
        end = offset + RECORD_HEADER.size + length
        if opcode in {Opcode.DATA_END, Opcode.FOOTER}:
            self._has_ended = True
            return False
        if end > size or (not 0 < opcode <= max(Opcode) <= _FIRST_PRIVATE and opcode < _FIRST_PRIVATE):
            return self._go_past_damage(stream, size)
        if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            if length > DECLARATION_MAX:
                return self._go_past_damage(stream, size)
            if end + CHECK.size > size:
                return False
            self._declare(stream, opcode, offset, length)
        elif opcode == Opcode.CHUNK and len(head) == _HEAD_BYTES:
            start_ns, end_ns = _CHUNK_TIMES.unpack_from(head, RECORD_HEADER.size)
            self._offsets.append(offset)
            self._starts.append(start_ns)
            self._ends.append(end_ns)
            self._sure = offset
            self._passed.clear()
        self._passed.add(offset)
        self._offset = end
        return True

    def _begin(self, magic: bytes) -> bool:
        if magic == MAGIC:
            self._offset = len(MAGIC)
            return True
        if not MAGIC.startswith(magic):
            self.damaged += 1
            self._has_ended = True
        return False

    def _go_past_damage(self, stream: BinaryIO, size: int) -> bool:
        """Nothing makes sense here: go on at the next piece that is proven. At the end it is a write under way."""
        scanner = Scanner(stream, size)
        following = scanner.next_piece(self._sure)
        while following is not None and following in self._passed:
            following = scanner.next_piece(following)
        if following is None:
            return False
        self.damaged += 1
        self._offset = self._sure = following
        self._passed.clear()
        return True

    def _declare(self, stream: BinaryIO, opcode: int, offset: int, length: int) -> None:
        stream.seek(offset)
        raw = stream.read(RECORD_HEADER.size + length)
        check = stream.read(CHECK.size)
        is_checked = check[:1] == bytes([CHECK_OPCODE])
        if is_checked and check != CHECK.pack(CHECK_OPCODE, 8, len(raw), zlib.crc32(raw)):
            self.damaged += 1
            return
        body = ReadDataStream(BytesIO(raw[RECORD_HEADER.size :]))
        try:
            if opcode == Opcode.SCHEMA:
                schema = records.Schema.read(body)
                self._schemas.setdefault(schema.id, schema)
            else:
                self._add_channel(records.Channel.read(body))
        except BROKEN:
            self.damaged += 1

    def _add_channel(self, channel: records.Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        is_ours = channel.message_encoding == MESSAGE_ENCODING
        if schema is not None and is_ours and schema.encoding == SCHEMA_ENCODING:
            found = LogChannel(channel.id, channel.topic, schema.name, schema.data)
            self.channels.setdefault(channel.id, found)
        elif schema is not None or not channel.schema_id:
            self._others.add(channel.id)


def _content(stream: BinaryIO, offset: int) -> bytes:
    """The records of the chunk there, proven by its checksum."""
    stream.seek(offset)
    head = stream.read(RECORD_HEADER.size)
    _, length = RECORD_HEADER.unpack(head)
    if length > RECORD_MAX:
        raise ValueError("a chunk is too long")
    chunk = records.Chunk.read(ReadDataStream(BytesIO(stream.read(length))))
    promised = zstandard.frame_content_size(chunk.data) if chunk.compression == "zstd" else -1
    if chunk.uncompressed_size > RECORD_MAX or promised not in {-1, chunk.uncompressed_size}:
        raise ValueError("a chunk's sizes differ")
    content, size = get_chunk_data_stream(chunk, validate_crc=True)
    return content.read(size)


def _messages(content: bytes) -> Iterator[Logged]:
    position, end = 0, len(content)
    unpack, header, whole = MESSAGE_HEADER.unpack_from, RECORD_HEADER.size, MESSAGE_HEADER.size
    while position < end:
        if content[position] == MESSAGE_OPCODE:
            _, length, channel_id, sequence, log_ns, publish_ns = unpack(content, position)
            start, position = position + whole, position + header + length
            if position > end or length < HEADER_IN_LENGTH:
                raise ValueError("a chunk holds half a record")
            yield channel_id, sequence, log_ns, publish_ns, content[start:position]
        else:
            position += header + RECORD_HEADER.unpack_from(content, position)[1]


def _spans(times_ns: Iterable[int]) -> Spans:
    spans: list[tuple[int, int]] = []
    for time_ns in sorted(times_ns):
        if spans and time_ns - spans[-1][1] <= SPAN_GAP_NS:
            spans[-1] = spans[-1][0], time_ns
        else:
            spans.append((time_ns, time_ns))
    return tuple(spans)
