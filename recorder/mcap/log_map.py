"""A map of a log's chunks and channels, made without reading the chunks. From any binary stream.

A log may be whole or still being written, and damaged: what cannot be read is skipped and counted, never raised.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator
from itertools import accumulate
from typing import BinaryIO, Final

from mcap import records
from mcap.opcode import Opcode

from recorder.mcap.channel import LogChannel
from recorder.mcap.framing import (
    CHECK,
    CHUNK_TIMES,
    FIRST_RECORD,
    MAGIC,
    RECORD_HEADER,
    is_no_opcode,
)
from recorder.mcap.pieces import Fault, LoggedMessage, messages_at
from recorder.mcap.proof import ProvenRecord, Scanner
from recorder.mcap.writer import MESSAGE_ENCODING, SCHEMA_ENCODING

EARLY_NS: Final = 60_000_000_000
"""A message is logged at most so long before its publish time: recorder and source differ in their clocks."""

LATE_NS: Final = 600_000_000_000
"""A message is logged at most so long after its publish time: a recorder may have asked for it later.

A gateway keeps ten minutes of its journal at the bus's nominal load. A decision or an event of an idle robot may
be older when it is asked for, and is then not found by its time.
"""

SPAN_GAP_NS: Final = 1_000_000_000
"""Publish times of a chunk that lie further apart than this are two spans."""

DECLARATION_MAX: Final = 1 << 24
"""A schema or channel that says it is longer than this is damaged."""

LOOK_EVERY: Final = 256
"""Records between two looks at the time that is left."""

Spans = tuple[tuple[int, int], ...]
"""First and last of publish times that lie close together, in order."""


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
        """The place of the last chunk, or of the last record found behind damage."""
        self._passed: set[int] = set()
        """The records found since then: a damaged length may have skipped others before them."""
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
        scanner = Scanner(stream, size)
        looks = 0
        while not self._has_ended:
            looks += 1
            if (chunks_max is not None and len(self) >= chunks_max) or (looks % LOOK_EVERY == 0 and is_expired()):
                return
            if not self._step(scanner):
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

    def read(self, stream: BinaryIO, number: int) -> list[LoggedMessage]:
        """The messages of a chunk; none if it is damaged.

        Raises:
            OSError: the stream cannot be read.
        """
        found: list[LoggedMessage] = []
        for one in messages_at(stream, self._offsets[number]):
            if isinstance(one, LoggedMessage):
                found.append(one)
            elif isinstance(one, Fault):
                self.damaged += 1
                self._spans[number] = ()
                return []
        if number not in self._spans:
            self._spans[number] = _spans(message.publish_ns for message in found)
            lost = {message.channel_id for message in found} - self.channels.keys() - self._others
            self.damaged += len(lost)
            self._others |= lost
        return found

    def messages(self, stream: BinaryIO) -> Iterator[LoggedMessage]:
        """Every message of a log whose channel is known, chunk by chunk.

        Raises:
            OSError: the stream cannot be read.
        """
        for number in range(len(self)):
            for message in self.read(stream, number):
                if message.channel_id in self.channels:
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

    def _step(self, scanner: Scanner) -> bool:
        """Take the next record. False if there is none, or not all of it yet."""
        file, offset = scanner.file, self._offset
        if not offset:
            return self._begin(file.read(0, len(MAGIC)))
        header = file.header(offset)
        if header is None:
            return False
        opcode, end = header
        if opcode in {Opcode.DATA_END, Opcode.FOOTER}:
            self._has_ended = True
            return False
        is_declaration = opcode in {Opcode.SCHEMA, Opcode.CHANNEL}
        is_too_long = is_declaration and end - offset > RECORD_HEADER.size + DECLARATION_MAX
        if end > file.size or is_no_opcode(opcode) or is_too_long:
            return self._go_past_damage(scanner)
        if is_declaration:
            if end + CHECK.size > file.size:
                return False
            self._declare(scanner.piece(offset))
        elif opcode == Opcode.CHUNK:
            times = file.read(offset + RECORD_HEADER.size, CHUNK_TIMES.size)
            if len(times) == CHUNK_TIMES.size:
                self._add_chunk(offset, *CHUNK_TIMES.unpack(times))
        self._passed.add(offset)
        self._offset = end
        return True

    def _begin(self, magic: bytes) -> bool:
        if magic == MAGIC:
            self._offset = FIRST_RECORD
            return True
        if not MAGIC.startswith(magic):
            self.damaged += 1
            self._has_ended = True
        return False

    def _go_past_damage(self, scanner: Scanner) -> bool:
        """Nothing makes sense here: go on at the next piece that is proven. At the end it is a write under way."""
        following = scanner.next_piece(self._sure)
        while following is not None and following in self._passed:
            following = scanner.next_piece(following)
        if following is None:
            return False
        self.damaged += 1
        self._offset = self._sure = following
        self._passed.clear()
        return True

    def _add_chunk(self, offset: int, start_ns: int, end_ns: int) -> None:
        self._offsets.append(offset)
        self._starts.append(start_ns)
        self._ends.append(end_ns)
        self._sure = offset
        self._passed.clear()

    def _declare(self, found: object) -> None:
        record = found.parsed if isinstance(found, ProvenRecord) else None
        if isinstance(record, records.Schema):
            self._schemas.setdefault(record.id, record)
        elif isinstance(record, records.Channel):
            self._add_channel(record)
        else:
            self.damaged += 1

    def _add_channel(self, channel: records.Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        is_ours = channel.message_encoding == MESSAGE_ENCODING
        if schema is not None and is_ours and schema.encoding == SCHEMA_ENCODING:
            found = LogChannel(channel.id, channel.topic, schema.name, schema.data)
            self.channels.setdefault(channel.id, found)
        elif schema is not None or not channel.schema_id:
            self._others.add(channel.id)


def _spans(times_ns: Iterable[int]) -> Spans:
    spans: list[tuple[int, int]] = []
    for time_ns in sorted(times_ns):
        if spans and time_ns - spans[-1][1] <= SPAN_GAP_NS:
            spans[-1] = spans[-1][0], time_ns
        else:
            spans.append((time_ns, time_ns))
    return tuple(spans)
