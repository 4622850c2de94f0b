"""Finds the holes of one's own logs: per topic, the publish times between which messages are missing. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import Enum
from typing import Any, Final

import msgspec
from google.protobuf.message import DecodeError

from recorder.backfill.ranges import Range, merged, overlaps
from recorder.backfill.runs import Cover, SequenceLine
from recorder.encoding.protobuf_schema import message_class, schema_name
from recorder.mcap.channel import LogChannel
from recorder.mcap.reader import LoggedMessage
from schemas import keys
from schemas.messages import GatewayInfo, RawSample
from schemas.recording import RecordGap
from schemas.subjects import SCHEMA_PREFIX

SILENCE_NS: Final = 2_000_000_000
"""A robot that was silent for longer than this was cut off: it publishes something each second."""

MARGIN_NS: Final = 2_000_000_000
"""A recorder reports when it received a dropped message; it was published at most so long before or after."""

ANY_TOPIC: Final = "/**"
"""Ends the topic of a hole that is a whole robot's: a Zenoh key expression."""

_WITHOUT_SEQUENCE: Final = frozenset({schema_name(RawSample), schema_name(GatewayInfo)})
_GAP: Final = schema_name(RecordGap)
_GapMessage: Final[Any] = message_class(RecordGap)

Place = tuple[int, int]
"""Sequence and publish time of a message that is there."""


class HoleKind(Enum):
    """The evidence that something is missing."""

    SEQUENCE = "sequence"
    """Sequences are missing."""
    RESTART = "restart"
    """The sequence begins anew: nobody knows what the old gateway still said, and what the new one said first."""
    DROPPED = "dropped"
    """The recorder says that it dropped messages."""
    SILENCE = "silence"
    """Nothing at all was received from a robot, and some of its messages are known to be missing."""


class Hole(msgspec.Struct, frozen=True):
    """Messages of a topic that are missing.

    Attributes:
        topic: or, of a silence, the key expression of all that the robot says.
        from_ns: they were published at this time or later...
        to_ns: ...and before this one.
        missing: number of samples, or of dropped messages; None where nobody knows.
        before, after: the messages around it, if a sequence shows it.
    """

    topic: str
    kind: HoleKind
    from_ns: int
    to_ns: int
    missing: int | None
    before: Place | None = None
    after: Place | None = None

    @property
    def is_robots(self) -> bool:
        """True if it is one of all that a robot says."""
        return self.kind is HoleKind.SILENCE


class _Dropped(msgspec.Struct, frozen=True):
    """The part of a RecordGap that matters here."""

    key: str
    first_ns: int
    last_ns: int
    count: int


class _Topic:
    def __init__(self, prefix: str, cover: Cover) -> None:
        self.prefix = prefix
        self.line = SequenceLine()
        self.cover = cover
        self.lag_ns: int | None = None
        """The smallest delay from publishing to receipt: it shows the difference of the two clocks."""

    def add(self, sequence: int, log_ns: int, publish_ns: int) -> None:
        self.line.add(sequence, publish_ns)
        self.cover.add(publish_ns)
        lag_ns = log_ns - publish_ns
        if self.lag_ns is None or lag_ns < self.lag_ns:
            self.lag_ns = lag_ns


class HoleFinder:
    """Finds the holes in the messages of all logs there are, added in any order of the logs.

    Attributes:
        topics: the topics received from each robot, by the beginning of its keys.
    """

    def __init__(self) -> None:
        self.topics: dict[str, set[str]] = {}
        self._topics: dict[str, _Topic] = {}
        self._covers: dict[str, Cover] = {}
        self._gaps: list[_Dropped] = []

    def add(self, channels: dict[int, LogChannel], messages: Iterable[LoggedMessage]) -> None:
        """Add the messages of one log."""
        known = {number: self._topic(channel) for number, channel in channels.items()}
        gaps = {number for number, channel in channels.items() if channel.schema_name == _GAP}
        for one in messages:
            topic = known[one.channel_id]
            if topic is not None:
                topic.add(one.sequence, one.log_ns, one.publish_ns)
            elif one.channel_id in gaps:
                self._add_gap(one.data)

    def holes(self) -> list[Hole]:
        """Return the holes, by time and topic."""
        found = [hole for name, topic in self._topics.items() for hole in _between(name, topic.line)]
        found = list(self._with_dropped(found))
        found += self._silences(found)
        return sorted(found, key=lambda hole: (hole.from_ns, hole.topic))

    def _topic(self, channel: LogChannel) -> _Topic | None:
        """The topic of a robot whose sequence counts. What recorders say of themselves is not backfilled."""
        parts = keys.parse(channel.topic)
        if parts is None or not parts.robot:
            return None
        prefix = f"{parts.root}/{parts.robot}"
        self.topics.setdefault(prefix, set()).add(channel.topic)
        is_counted = channel.schema_name.startswith(f"{SCHEMA_PREFIX}.")
        if not is_counted or channel.schema_name in _WITHOUT_SEQUENCE:
            return None
        if channel.topic not in self._topics:
            cover = self._covers.setdefault(prefix, Cover(SILENCE_NS))
            self._topics[channel.topic] = _Topic(prefix, cover)
        return self._topics[channel.topic]

    def _add_gap(self, data: bytes) -> None:
        try:
            gap = _GapMessage.FromString(data)
        except DecodeError:
            return
        # Of keys that it did not count one by one it says no more than a wildcard.
        if "*" not in gap.key:
            self._gaps.append(_Dropped(gap.key, gap.first_ns, gap.last_ns, gap.count))

    def _with_dropped(self, holes: list[Hole]) -> Iterator[Hole]:
        """Yield the holes, and those that the recorder reports as dropped where sequences do not show them."""
        by_topic: dict[str, list[Hole]] = {}
        for hole in holes:
            by_topic.setdefault(hole.topic, []).append(hole)
        for gap in self._gaps:
            topic = self._topics.get(gap.key)
            lag_ns = 0 if topic is None or topic.lag_ns is None else topic.lag_ns
            from_ns = max(0, gap.first_ns - lag_ns - MARGIN_NS)
            to_ns = gap.last_ns - lag_ns + MARGIN_NS
            same = by_topic.setdefault(gap.key, [])
            told = [hole for hole in same if hole.from_ns < to_ns and hole.to_ns > from_ns]
            # Where the sequences run on, another recorder may have said it: nobody knows whether any is missing.
            missing = gap.count if topic is None and not told else None
            if not told or any(hole.from_ns > from_ns or hole.to_ns < to_ns for hole in told):
                same.append(Hole(gap.key, HoleKind.DROPPED, from_ns, to_ns, missing))
        for same in by_topic.values():
            yield from same

    def _silences(self, holes: list[Hole]) -> Iterator[Hole]:
        """Yield the times when nothing came from a robot; but only where something is missing there."""
        by_robot: dict[str, list[Range]] = {}
        for hole in holes:
            topic = self._topics.get(hole.topic)
            if topic is not None and hole.kind is not HoleKind.DROPPED:
                by_robot.setdefault(topic.prefix, []).append((hole.from_ns, hole.to_ns))
        for prefix, ranges in by_robot.items():
            missing = merged(ranges)
            for last_ns, first_ns in self._covers[prefix].silences():
                if overlaps(missing, last_ns, first_ns):
                    yield Hole(f"{prefix}{ANY_TOPIC}", HoleKind.SILENCE, last_ns, first_ns + 1, None)


def _between(topic: str, line: SequenceLine) -> Iterator[Hole]:
    for before, after, missing in line.gaps():
        # A source whose clock was set back has its messages in two places.
        from_ns, end_ns = sorted((before.last_ns, after.first_ns))
        if missing is None and from_ns != before.last_ns:
            continue
        kind = HoleKind.RESTART if missing is None else HoleKind.SEQUENCE
        places = (before.last, before.last_ns), (after.first, after.first_ns)
        # The frames of one batch have times of their own, and those of two batches may have the same.
        yield Hole(topic, kind, from_ns, end_ns + 1, missing, *places)


class HoleTally:
    """The messages that have filled a hole, and whether somebody answered for all of it."""

    def __init__(self, hole: Hole) -> None:
        self.hole = hole
        self.filled = 0
        self.is_answered = False
        self._line = SequenceLine()
        for place in (hole.before, hole.after):
            if place is not None:
                self._line.add(*place)

    def add(self, sequence: int, publish_ns: int) -> None:
        """Add a message that was missing."""
        self.filled += 1
        if self.hole.before is not None:
            self._line.add(sequence, publish_ns)

    @property
    def still_missing(self) -> int | None:
        """Samples that are missing still, or messages that were dropped; None where nobody knows of any."""
        if self.hole.before is None:
            return None if self.hole.missing is None else max(0, self.hole.missing - self.filled)
        # A gateway that began anew within the hole left fewer than its sequences seemed to say.
        known = sum(missing for _, _, missing in self._line.gaps() if missing is not None)
        return known if known or self.hole.missing is not None else None
