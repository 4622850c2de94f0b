"""Answers a backfill: the messages of some topics and a publish time out of logs, in pieces.

Messages stand in a log in the order of their receipt, and what was asked for later stands late, so the order of
publish times is made here: of a slice of time the messages are gathered out of all logs, and sorted. Only the
earliest GATHER_BYTES of them are held; where there are more, the slice is cut short, within an instant if need be,
and the rest comes with the next. So memory is bounded whatever the logs hold, no message is in two pieces, and
``next_ns`` is exact: every piece ends where the next one begins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from operator import itemgetter
from typing import BinaryIO, Final

import msgspec

from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import ChunkBuilder, record_size
from recorder.mcap.log_map import EARLY_NS, LATE_NS, LogMap
from recorder.mcap.writer import McapFile
from schemas.recording import Backfill, BackfillPiece

PIECE_BYTES: Final = 262_144
"""Bytes of message records in a piece, before compression. A message that is larger is a piece of its own."""

PIECE_NAME: Final = "cruiser.piece"
"""The metadata record of a piece: its ``number``, from 0, and ``from_ns``, where the piece before it ended.

A reply may be lost on the way; by these the asker sees it. The last piece has messages if any has.
"""

GATHER_BYTES: Final = 4_194_304
"""So much of a slice is held, the objects around each message included; while it is gathered, twice that."""

OBJECT_BYTES: Final = 250
"""About what a message costs in memory besides its data."""

SLICE_NS: Final = 10_000_000_000
"""Length of the first slice."""

SLICE_MAX_NS: Final = 600_000_000_000
"""Length of the longest slice: they grow where there is little, and shrink to what can be held."""

LOOK_EVERY: Final = 5000
"""Messages of a chunk between two looks at the time that is left."""

_LIBRARY: Final = "cruiser backfill"

Place = tuple[int, int, str, bytes]
"""The place of a message in the order of all: publish time, sequence, topic and data."""


class LogCopy(msgspec.Struct, frozen=True):
    """A log to read from.

    Attributes:
        name: for people.
        open: opens it.
        chart: its map.
    """

    name: str
    open: Callable[[], BinaryIO]
    chart: LogMap


class LoggedBytes(msgspec.Struct, frozen=True):
    """A message of a log, and its channel there."""

    channel: LogChannel
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes

    @property
    def size(self) -> int:
        """Bytes of its record."""
        return record_size(self.data)

    @property
    def place(self) -> Place:
        """Its place; two copies of a message have the same."""
        return self.publish_ns, self.sequence, self.channel.topic, self.data


class Excerpt:
    """Answers one request.

    Args:
        logs: the logs to search.
        is_wanted: a test of topics.
        request: the range; its key was turned into ``is_wanted``.
        is_expired: the time for this answer is over. What is then missing is to be asked for again.
    """

    def __init__(
        self,
        logs: Sequence[LogCopy],
        is_wanted: Callable[[str], bool],
        request: Backfill,
        is_expired: Callable[[], bool],
    ) -> None:
        self._logs = [log for log in logs if len(log.chart)]
        self._request = request
        self._is_expired = is_expired
        self._wanted = {
            id(log): {number: one for number, one in log.chart.channels.items() if is_wanted(one.topic)}
            for log in self._logs
        }
        self.faults: list[str] = []
        """Logs that could not be read."""

    def pieces(self) -> Iterator[BackfillPiece]:
        """The answer; the last piece says that it is."""
        request = self._request
        piece = _Piece(0, request.from_ns)
        answered_ns, used, is_late = request.from_ns, 0, False
        for message, up_to_ns in self._in_order():
            if message is None:
                answered_ns = up_to_ns
                continue
            # Messages of one instant stay together, so that to ask again from the next one always gets further,
            # unless there is no time for all of them.
            is_over = used + message.size > request.max_bytes and message.publish_ns > piece.last_ns
            if used and (is_over or is_late):
                yield piece.seal(message.publish_ns, self._detail(), is_last=True)
                return
            if not piece.fits(message):
                yield piece.seal(message.publish_ns, "", is_last=False)
                piece = _Piece(piece.number + 1, message.publish_ns)
                is_late = self._is_expired()
            piece.add(message)
            used += message.size
        yield piece.seal(answered_ns, self._detail(), is_last=True)

    def _detail(self) -> str:
        damaged = sum(log.chart.damaged for log in self._logs)
        parts = [f"{damaged} damaged places were skipped"] if damaged else []
        return "; ".join(parts + self.faults)

    def _in_order(self) -> Iterator[tuple[LoggedBytes | None, int]]:
        """Yield the messages by publish time, without repetitions, each with the time up to which all are out.

        The last message is None, with the time of the end.
        """
        request, width_ns = self._request, SLICE_NS
        self._logs = [log for log in self._logs if self._wanted[id(log)]]
        # Outside of these nothing can be: no need to look at every slice since 1970.
        first_ns = min((log.chart.start_ns for log in self._logs), default=0) - LATE_NS
        last_ns = max((log.chart.end_ns for log in self._logs), default=0) + EARLY_NS
        end_ns = min(request.to_ns, last_ns + 1)
        start = _before(max(request.from_ns, first_ns))
        while start[0] < end_ns:
            gathered = self._gather(start, min(start[0] + width_ns, end_ns))
            if gathered is None:
                yield None, max(start[0], request.from_ns)
                return
            found, end, held = gathered
            for message in found:
                yield message, message.publish_ns
            is_sparse = held <= GATHER_BYTES // 4
            width_ns = min(2 * width_ns, SLICE_MAX_NS) if is_sparse else max(1, end[0] - start[0])
            start = end
        yield None, request.to_ns

    def _gather(self, start: Place, to_ns: int) -> tuple[list[LoggedBytes], Place, int] | None:
        """The messages from a place on, in order; where they end; and what they take. None: no time is left."""
        if self._is_expired():
            return None
        found: list[LoggedBytes] = []
        held, end = 0, _before(to_ns)
        for log in list(self._logs):
            # The end may be a place within an instant.
            for message in self._read(log, start[0], end[0] + 1):
                if message is None:
                    return None
                if not start <= message.place < end:
                    continue
                found.append(message)
                held += len(message.data) + OBJECT_BYTES
                if held > 2 * GATHER_BYTES:
                    found, end, held = _earliest(found, end)
        return _earliest(found, end)

    def _read(self, log: LogCopy, from_ns: int, to_ns: int) -> Iterator[LoggedBytes | None]:
        """Yield the messages that a log has of a slice; None when the time is over."""
        numbers = log.chart.near(from_ns, to_ns)
        if not numbers:
            return
        channels = self._wanted[id(log)]
        try:
            with log.open() as stream:
                for number in numbers:
                    if self._is_expired():
                        yield None
                        return
                    for looks, one in enumerate(log.chart.read(stream, number), start=1):
                        channel = channels.get(one.channel_id)
                        if from_ns <= one.publish_ns < to_ns and channel is not None:
                            yield LoggedBytes(channel, one.sequence, one.log_ns, one.publish_ns, one.data)
                        if looks % LOOK_EVERY == 0 and self._is_expired():
                            yield None
                            return
        except OSError as error:
            self._logs.remove(log)
            self.faults.append(f"{log.name}: {error.strerror or error}")


def _before(publish_ns: int) -> Place:
    """The place before all messages of an instant: sequences begin at 0."""
    return publish_ns, -1, "", b""


def _earliest(found: list[LoggedBytes], end: Place) -> tuple[list[LoggedBytes], Place, int]:
    """As many messages as may be held, at least one, in order and each once; up to which place; what they take.

    What an incident's log holds is in the recorder's other log too.
    """
    kept: list[LoggedBytes] = []
    held, last = 0, None
    for place, message in sorted(((one.place, one) for one in found), key=itemgetter(0)):
        if place == last:
            continue
        if kept and held + len(message.data) + OBJECT_BYTES > GATHER_BYTES:
            return kept, place, held
        held += len(message.data) + OBJECT_BYTES
        kept.append(message)
        last = place
    return kept, end, held


class _Piece:
    """One piece, while it is put together."""

    def __init__(self, number: int, from_ns: int) -> None:
        self.number = number
        self.last_ns = -1
        self._from_ns = from_ns
        self._messages = 0
        self._chunk = ChunkBuilder()
        self._ids: dict[tuple[str, str], int] = {}
        self._channels: dict[str, LogChannel] = {}

    def fits(self, message: LoggedBytes) -> bool:
        """Report whether it may hold the message too. A schema of another version than its own does not fit."""
        if not self._messages:
            return True
        same = self._channels.get(message.channel.schema_name)
        if same is not None and same.schema_data != message.channel.schema_data:
            return False
        return len(self._chunk) + message.size <= PIECE_BYTES

    def add(self, message: LoggedBytes) -> None:
        channel = message.channel
        self._channels.setdefault(channel.schema_name, channel)
        number = self._ids.setdefault((channel.topic, channel.schema_name), len(self._ids) + 1)
        self._chunk.add(number, message.sequence, message.log_ns, message.publish_ns, message.data)
        self._messages += 1
        self.last_ns = message.publish_ns

    def seal(self, next_ns: int, detail: str, *, is_last: bool) -> BackfillPiece:
        return BackfillPiece(
            ok=True, detail=detail, mcap=self._mcap(), messages=self._messages, next_ns=next_ns, is_last=is_last
        )

    def _mcap(self) -> bytes:
        chunk = self._chunk.seal()
        if chunk is None:
            return b""
        stream = BytesIO()
        file = McapFile(stream, _LIBRARY)
        file.add_metadata(PIECE_NAME, {"number": str(self.number), "from_ns": str(self._from_ns)})
        for (topic, schema_name), number in self._ids.items():
            schema_data = self._channels[schema_name].schema_data
            file.add_channel(LogChannel(number, topic, schema_name, schema_data))
        file.write_chunk(chunk)
        file.finish()
        return stream.getvalue()
