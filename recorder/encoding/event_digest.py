"""The digest of a log: what ``events`` and ``why`` read of all of it, in one place at its end. Pure.

In the log itself these messages share their chunks with everything else, for a chunk is written before half a
second of messages is at risk. Whoever wants only them, over a network, would read all of the log. So the end of a
log repeats them, as an attachment: a hundredth of its size. A log without one is read whole.

Of the arbiter's states and decisions those are left out that say what their neighbours say: states of unchanged
content, but for two a second, and commands of an unbroken stream that were accepted. Next to a gap, a change, or
a late receipt all are there, so the answers are the same.

An attachment is a row of blocks, each a length, the CRC-32 of its content, and that packed with zstd: entries,
each with its kind before it.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import accumulate, repeat
from operator import attrgetter, itemgetter
from typing import Any, Final

import msgspec
import zstandard
from google.protobuf.message import DecodeError

from recorder.encoding.protobuf_schema import descriptor_set, message_class, schema_name
from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import Chunk
from schemas.decisions import RUN_TICKS, Decision, SafetyEvent, SafetyState, Verdict
from schemas.messages import GatewayHealth
from schemas.recording import RecorderEvent, RecordGap

DIGEST_NAME: Final = "cruiser.events"
DIGEST_TYPE: Final = "application/x-cruiser-events"

DIGESTED: Final[frozenset[type[msgspec.Struct]]] = frozenset(
    {SafetyEvent, Decision, SafetyState, GatewayHealth, RecorderEvent, RecordGap}
)
"""The classes of the messages in it."""

SPARED: Final[frozenset[type[msgspec.Struct]]] = frozenset({SafetyState, Decision})
"""Those of them that are left out where they say what their neighbours say."""

KEPT_NS: Final = 500_000_000
"""Of states that say the same one is kept in so much time..."""

NEXT_NS: Final = 250_000_000
"""...and where two are further apart, both. The arbiter says its state every 50 ms."""

LAG_NS: Final = 500_000_000
"""A message that was received later than this is kept: it shows how the clocks are, or was asked for later."""

PASSED_MAX: Final = 10_000
"""Decisions of a stream that are left out in a row."""

PLACE_BYTES: Final = 32_768
"""The places of chunks that are so far apart are noted."""

BLOCK_BYTES: Final = 131_072
"""A block, before it is packed."""

PART_BYTES: Final = 2 * 1024 * 1024
"""Blocks that wait in memory for the log's end; beyond it they are written as an attachment of their own."""

_UNPACKED_MAX: Final = 64 * 1024 * 1024

_BLOCK: Final = struct.Struct("<II")
_MESSAGE: Final = struct.Struct("<BIHIIQQI")
"""Kind, number in the order of the file, channel, sequence, samples left out before it, log time, publish time,
bytes of data, which follow."""
_PLACE: Final = struct.Struct("<BQQQ")
"""Kind, offset of a chunk, the earliest log time from there to the next place, and the latest up to that."""
_END: Final = struct.Struct("<BQ")
"""Kind, number of messages in the log."""
_CHANNEL: Final = struct.Struct("<BH")
"""Kind, a channel of which the digest tells."""
_MESSAGE_KIND, _PLACE_KIND, _END_KIND, _CHANNEL_KIND = 1, 2, 3, 4
_FIXED: Final = {_PLACE_KIND: _PLACE, _END_KIND: _END, _CHANNEL_KIND: _CHANNEL}

_STREAMED: Final = frozenset({"drive", "renew"})

_BY_SCHEMA: Final[Mapping[str, type[msgspec.Struct]]] = {schema_name(kind): kind for kind in DIGESTED}


def digested_kind(schema: str) -> type[msgspec.Struct] | None:
    """Return the class of the messages of a schema, by its name; None if the digest does not hold such."""
    return _BY_SCHEMA.get(schema)


class DigestedMessage(msgspec.Struct, frozen=True, gc=False):
    """A message in the digest.

    Attributes:
        number: its place among them in the order of the file.
        passed: accepted commands of the same stream right before it that were left out.
    """

    number: int
    channel_id: int
    sequence: int
    passed: int
    log_ns: int
    publish_ns: int
    data: bytes


class EventDigest:
    """Gathers the digest of one file while it is written."""

    name = DIGEST_NAME
    media_type = DIGEST_TYPE

    def __init__(self) -> None:
        self._channels: dict[int, _Channel] = {}
        self._block = bytearray()
        self._packed = bytearray()
        self._messages = self._numbers = 0
        self._place_at = 0
        """Offset of the place whose chunks are being written; 0 before the first."""
        self._first_ns = self._last_ns = 0

    def add_channel(self, channel: LogChannel) -> None:
        """A channel of the file."""
        kind = digested_kind(channel.schema_name)
        # The schema of another version may give its numbers another meaning.
        if kind is not None and channel.schema_data == descriptor_set(kind):
            self._channels.setdefault(channel.channel_id, _Channel(channel.channel_id, kind))

    def add_chunk(self, chunk: Chunk, offset: int) -> None:
        """Take a chunk that was written at an offset of the file."""
        if not self._place_at or offset - self._place_at >= PLACE_BYTES:
            self._end_place()
            self._place_at, self._first_ns = offset, chunk.start_ns
        self._first_ns = min(self._first_ns, chunk.start_ns)
        self._last_ns = max(self._last_ns, chunk.end_ns)
        found: list[tuple[int, _Channel]] = []
        for channel_id, entries in chunk.index.items():
            self._messages += len(entries) // 2
            channel = self._channels.get(channel_id)
            if channel is not None:
                found += zip(entries[1::2], repeat(channel), strict=False)
        for at, channel in sorted(found, key=itemgetter(0)):
            self._numbers += 1
            self._add(channel.take(self._numbers, chunk.message_at(at)))
        if len(self._block) >= BLOCK_BYTES:
            self._pack()

    def take_part(self) -> bytes:
        """Return what is to be written before the file ends; nothing, as long as there is room in memory."""
        if len(self._packed) < PART_BYTES:
            return b""
        part, self._packed = bytes(self._packed), bytearray()
        return part

    def take_end(self) -> bytes:
        """Return the last part; nothing, if there is nothing that anybody would look for."""
        if not self._channels:
            return b""
        for channel_id, channel in self._channels.items():
            self._add(channel.end())
            self._block += _CHANNEL.pack(_CHANNEL_KIND, channel_id)
        self._end_place()
        self._block += _END.pack(_END_KIND, self._messages)
        self._pack()
        part, self._packed = bytes(self._packed), bytearray()
        return part

    def _end_place(self) -> None:
        if self._place_at:
            self._block += _PLACE.pack(_PLACE_KIND, self._place_at, self._first_ns, self._last_ns)

    def _add(self, kept: DigestedMessage | None) -> None:
        if kept is not None:
            self._block += _MESSAGE.pack(
                _MESSAGE_KIND,
                kept.number,
                kept.channel_id,
                kept.sequence,
                kept.passed,
                kept.log_ns,
                kept.publish_ns,
                len(kept.data),
            )
            self._block += kept.data

    def _pack(self) -> None:
        data = zstandard.compress(bytes(self._block))
        self._packed += _BLOCK.pack(len(data), zlib.crc32(self._block)) + data
        self._block.clear()


_Message = tuple[int, int, int, bytes]
"""Sequence, log time, publish time and data."""


class _Channel:
    """Leaves out of one channel what says the same as its neighbours. It sees a hundred messages a second."""

    def __init__(self, channel_id: int, kind: type[msgspec.Struct]) -> None:
        self._id = channel_id
        self._read: Callable[[bytes], Any] = message_class(kind).FromString
        self._says = _SAYS.get(kind)
        self._is_stream = kind is Decision
        self._waiting: tuple[int, _Message] | None = None
        """Number and content of the last message, whose neighbour behind it is not known yet..."""
        self._was: tuple[int, object, bool] = (0, None, False)
        """...its tick, what it says (None keeps it), and whether it follows one that says the same."""
        self._kept_log_ns = self._kept_publish_ns = 0
        self._passed = 0

    def take(self, number: int, message: _Message) -> DigestedMessage | None:
        """Take the next one. Returns one that is to be kept, if any is."""
        says_of = self._says
        if says_of is None:
            return self._kept(number, message)
        before, self._waiting = self._waiting, (number, message)
        sequence, log_ns, publish_ns, data = message
        was_tick, was_saying, was_following = self._was
        tick, says = 0, None
        if 0 <= log_ns - publish_ns <= LAG_NS:
            try:
                found = self._read(data)
            except DecodeError:
                pass
            else:
                tick, says = found.tick, says_of(found)
        if before is None:
            self._was = tick, says, False
            return None
        was_sequence, was_log_ns, was_publish_ns, _ = before[1]
        is_stream = self._is_stream
        follows = (
            says is not None
            and says == was_saying
            and sequence == was_sequence + 1
            and -is_stream < tick - was_tick < RUN_TICKS
            and log_ns - was_log_ns >= 0
            and publish_ns - was_publish_ns >= 0
            and (is_stream or (log_ns - was_log_ns <= NEXT_NS and publish_ns - was_publish_ns <= NEXT_NS))
        )
        self._was = tick, says, follows
        if follows and was_following:
            is_near = log_ns - self._kept_log_ns <= KEPT_NS and publish_ns - self._kept_publish_ns <= KEPT_NS
            if self._passed < PASSED_MAX if is_stream else is_near:
                self._passed += 1
                return None
        return self._keep(*before)

    def end(self) -> DigestedMessage | None:
        """Return the last one: nothing follows it."""
        return None if self._waiting is None else self._keep(*self._waiting)

    def _keep(self, number: int, message: _Message) -> DigestedMessage:
        _, self._kept_log_ns, self._kept_publish_ns, _ = message
        passed, self._passed = self._passed, 0
        return self._kept(number, message, passed if self._is_stream else 0)

    def _kept(self, number: int, message: _Message, passed: int = 0) -> DigestedMessage:
        sequence, log_ns, publish_ns, data = message
        return DigestedMessage(number, self._id, sequence, passed, log_ns, publish_ns, data)


def _state_says(state: Any) -> object:  # noqa: ANN401 - protobuf makes the class at run time
    latched = state.latched
    return state.state, state.lease_holder, tuple(latched) if latched else (), state.guarded


_ACCEPTED: Final = list(Verdict).index(Verdict.ACCEPTED)


def _decision_says(decision: Any) -> object:  # noqa: ANN401 - the same
    return True if decision.verdict == _ACCEPTED and decision.request in _STREAMED else None


_SAYS: Final[Mapping[type[msgspec.Struct], Callable[[Any], object]]] = {
    SafetyState: _state_says,
    Decision: _decision_says,
}
"""The part of a message that makes entries of ``events``; messages of other classes are all kept."""


class DigestUnreadableError(Exception):
    """It is no whole digest of the log."""


class Digest:
    """A digest that was read.

    Args:
        parts: the attachments, in the order of the file.
        messages: in the log, by its end.

    Attributes:
        messages: in the order of the file.
        channels: those of which it tells.

    Raises:
        DigestUnreadableError: it is damaged, not whole, or of another log.
    """

    def __init__(self, parts: Iterable[bytes], messages: int) -> None:
        self.messages: list[DigestedMessage] = []
        self.channels: set[int] = set()
        self._offsets: list[int] = []
        self._starts: list[int] = []
        self._ends: list[int] = []
        end: int | None = None
        try:
            for content in _blocks(parts):
                for entry in _entries(content):
                    if isinstance(entry, DigestedMessage):
                        self.messages.append(entry)
                    elif entry[0] == _PLACE_KIND:
                        self._offsets.append(entry[1])
                        self._starts.append(entry[2])
                        self._ends.append(entry[3])
                    elif entry[0] == _CHANNEL_KIND:
                        self.channels.add(entry[1])
                    else:
                        end = entry[1]
        except (struct.error, zstandard.ZstdError, ValueError, MemoryError) as error:
            raise DigestUnreadableError(str(error)) from error
        if end != messages or self._offsets != sorted(self._offsets):
            raise DigestUnreadableError("it is of another log")
        self.messages.sort(key=attrgetter("number"))
        # The earliest from each place to the end, and the latest from the beginning to each place: both rise.
        self._starts = list(accumulate(reversed(self._starts), min))[::-1]
        self._ends = list(accumulate(self._ends, max))

    def stretch(self, from_ns: int, to_ns: int) -> tuple[int, int | None] | None:
        """Return beginning and end of the part of the file that holds the messages of a time, in bytes.

        An end that is None is that of the data. None alone: there are none.
        """
        first, last = bisect_left(self._ends, from_ns), bisect_left(self._starts, to_ns)
        if first >= last:
            return None
        return self._offsets[first], self._offsets[last] if last < len(self._offsets) else None


def _blocks(parts: Iterable[bytes]) -> Iterator[bytes]:
    for part in parts:
        at = 0
        while at < len(part):
            length, crc = _BLOCK.unpack_from(part, at)
            at += _BLOCK.size
            packed = part[at : at + length]
            if len(packed) < length or not 0 <= zstandard.frame_content_size(packed) <= _UNPACKED_MAX:
                raise ValueError("a block is cut off")
            content = zstandard.decompress(packed)
            if zlib.crc32(content) != crc:
                raise ValueError("a checksum is wrong")
            yield content
            at += length


def _entries(content: bytes) -> Iterator[DigestedMessage | tuple[int, ...]]:
    at = 0
    while at < len(content):
        kind = content[at]
        if kind == _MESSAGE_KIND:
            _, number, channel_id, sequence, passed, log_ns, publish_ns, length = _MESSAGE.unpack_from(content, at)
            at += _MESSAGE.size
            data = content[at : at + length]
            if len(data) < length or passed > PASSED_MAX:
                raise ValueError("a message is cut off")
            at += length
            yield DigestedMessage(number, channel_id, sequence, passed, log_ns, publish_ns, data)
        elif kind in _FIXED:
            found: tuple[int, ...] = _FIXED[kind].unpack_from(content, at)
            at += _FIXED[kind].size
            yield found
        else:
            raise ValueError("an entry of no known kind")
