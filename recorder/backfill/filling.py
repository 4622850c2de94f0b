"""Selection of the answered messages that one's own logs lack, and the holes that remain. Pure."""

from __future__ import annotations

import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from functools import cache

import msgspec

from recorder.backfill.excerpt import LoggedBytes
from recorder.backfill.holes import ANY_TOPIC, Hole, HoleKind, HoleTally
from recorder.backfill.questions import BackfillQuestion
from recorder.mcap.channel import LogChannel
from recorder.mcap.reader import LoggedMessage

Identity = tuple[str, int, int, int]
"""Topic, sequence, publish time, and CRC-32 of the data: no two messages of a log are the same in all of them."""


class Filled(msgspec.Struct, frozen=True):
    """The outcome for one hole.

    Attributes:
        missing: samples that were, or messages; None where nobody knew.
        filled: messages that came.
        still_missing: None where nobody knows of any.
        is_answered: somebody was asked for all of it, and answered.
    """

    topic: str
    kind: HoleKind
    from_ns: int
    to_ns: int
    missing: int | None
    filled: int
    still_missing: int | None
    is_answered: bool

    @property
    def is_whole(self) -> bool:
        """True if nothing more is known to be missing."""
        return self.is_answered and not self.still_missing


class _Holes:
    """The holes of one topic, or of one robot, in the order of time. They overlap seldom."""

    def __init__(self, tallies: Iterable[HoleTally]) -> None:
        self._tallies = sorted(tallies, key=lambda one: one.hole.from_ns)
        self._starts = [one.hole.from_ns for one in self._tallies]
        self._longest_ns = max(one.hole.to_ns - one.hole.from_ns for one in self._tallies)

    def at(self, publish_ns: int) -> list[HoleTally]:
        """Those that a message of this time may fill."""
        found = []
        place = bisect_right(self._starts, publish_ns)
        while place and self._starts[place - 1] > publish_ns - self._longest_ns - 1:
            place -= 1
            if publish_ns < self._tallies[place].hole.to_ns:
                found.append(self._tallies[place])
        return found


class Filling:
    """Judges answered messages against the holes of one's own logs.

    Args:
        holes: of one's own logs.
        is_recorded: True if one's own recorder records a topic; called for topics that no hole of their own
            reports missing.
    """

    def __init__(self, holes: Sequence[Hole], is_recorded: Callable[[str], bool] = lambda _: True) -> None:
        self._tallies = [HoleTally(hole) for hole in holes]
        self._is_recorded = cache(is_recorded)
        topics: dict[str, list[HoleTally]] = {}
        robots: dict[str, list[HoleTally]] = {}
        for tally in self._tallies:
            topic = tally.hole.topic
            if tally.hole.is_robots:
                robots.setdefault(topic.removesuffix(ANY_TOPIC[1:]), []).append(tally)
            else:
                topics.setdefault(topic, []).append(tally)
        self._topics = {topic: _Holes(same) for topic, same in topics.items()}
        self._robots = {prefix: _Holes(same) for prefix, same in robots.items()}
        self._held: set[Identity] = set()
        self._recent: set[Identity] = set()
        self._unanswered: list[BackfillQuestion] = []
        self.asked = 0
        """Messages that were answered; ``written`` of them were missing."""
        self.written = 0

    def hold(self, channels: dict[int, LogChannel], messages: Iterable[LoggedMessage]) -> None:
        """Learn which messages one's own logs have where something is missing."""
        for one in messages:
            topic = channels[one.channel_id].topic
            if self._holes_at(topic, one.publish_ns):
                self._held.add((topic, one.sequence, one.publish_ns, zlib.crc32(one.data)))

    def add(self, message: LoggedBytes) -> bool:
        """Add a message that was answered. Return True if it is missing, and is to be written."""
        self.asked += 1
        topic = message.channel.topic
        tallies = self._holes_at(topic, message.publish_ns)
        if not tallies:
            return False
        identity = topic, message.sequence, message.publish_ns, zlib.crc32(message.data)
        if identity in self._held or identity in self._recent:
            return False
        self._recent.add(identity)
        for tally in tallies:
            tally.add(message.sequence, message.publish_ns)
        self.written += 1
        return True

    def settle(self, next_ns: int) -> None:
        """All before this time has been answered, and does not come again."""
        self._recent = {identity for identity in self._recent if identity[2] >= next_ns}

    @property
    def open_holes(self) -> list[Hole]:
        """The holes to ask a recorder for: it may know of what nobody could count."""
        return [one.hole for one in self._tallies if not one.is_answered or one.still_missing != 0]

    def give_up(self, question: BackfillQuestion) -> None:
        """The recorder that is being asked did not answer this."""
        self._unanswered.append(question)

    def end_round(self) -> None:
        """The recorder was asked for all that was open."""
        for tally in self._tallies:
            if not any(question.asks_for(tally.hole) for question in self._unanswered):
                tally.is_answered = True
        self._unanswered.clear()
        self._recent.clear()

    def results(self) -> list[Filled]:
        """Return the outcome for each hole."""
        return [
            Filled(
                topic=tally.hole.topic,
                kind=tally.hole.kind,
                from_ns=tally.hole.from_ns,
                to_ns=tally.hole.to_ns,
                missing=tally.hole.missing,
                filled=tally.filled,
                still_missing=tally.still_missing,
                is_answered=tally.is_answered,
            )
            for tally in self._tallies
        ]

    def _holes_at(self, topic: str, publish_ns: int) -> list[HoleTally]:
        own = self._topics.get(topic)
        found = own.at(publish_ns) if own is not None else []
        for prefix, holes in self._robots.items():
            if topic.startswith(prefix) and (found or self._is_recorded(topic)):
                found = found + holes.at(publish_ns)
        return found
