"""Makes questions of holes: few, and for little that is there already. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

import msgspec

from recorder.backfill.holes import ANY_TOPIC, Hole
from recorder.backfill.ranges import Range, merged, without

NEAR_NS: Final = 1_000_000_000
"""Holes of one topic that are no further apart than this are asked for together."""

WIDEN_NS: Final = 5_000_000_000
"""A question for all of a robot takes in what single topics lack so shortly before or after it."""

SHARE: Final = 0.5
"""From this share of a robot's topics on, over their common time, all of it is asked for at once."""


class BackfillQuestion(msgspec.Struct, frozen=True):
    """A question to a recorder: a topic or all that a robot says, and a publish time."""

    key: str
    from_ns: int
    to_ns: int

    def covers(self, topic: str) -> bool:
        """Report whether it asks for a topic, or for a hole of all that a robot says."""
        return topic == self.key or (
            self.key.endswith(ANY_TOPIC) and topic.startswith(self.key.removesuffix("**"))
        )

    def asks_for(self, hole: Hole) -> bool:
        """Report whether it asks for a part of a hole."""
        return self.covers(hole.topic) and self.from_ns < hole.to_ns and self.to_ns > hole.from_ns


def questions(holes: Iterable[Hole], topics: Mapping[str, set[str]]) -> list[BackfillQuestion]:
    """The questions that bring what is missing, in the order of time.

    Args:
        holes: the missing messages.
        topics: the known topics of each robot, by the beginning of its keys.
    """
    by_robot: dict[str, dict[str, list[Range]]] = {}
    for hole in holes:
        # Also of a key of the robot's that is no known subject; what is no robot's is asked for alone.
        prefix = next((prefix for prefix in topics if hole.topic.startswith(f"{prefix}/")), "")
        by_topic = by_robot.setdefault(prefix, {})
        by_topic.setdefault(hole.topic, []).append((hole.from_ns, hole.to_ns))
    asked = _single(by_robot.pop("", {}))
    for prefix, by_topic in by_robot.items():
        asked += _of_robot(prefix, by_topic, len(topics[prefix]))
    return sorted(asked, key=lambda one: (one.from_ns, one.key))


def _single(by_topic: Mapping[str, list[Range]]) -> list[BackfillQuestion]:
    return [BackfillQuestion(topic, *one) for topic, ranges in by_topic.items() for one in merged(ranges, NEAR_NS)]


def _of_robot(prefix: str, by_topic: dict[str, list[Range]], topic_count: int) -> list[BackfillQuestion]:
    everything = f"{prefix}{ANY_TOPIC}"
    silences = merged(by_topic.pop(everything, []))
    whole = merged([_widened(silence, by_topic) for silence in silences])
    rest = {topic: without(merged(ranges, NEAR_NS), whole) for topic, ranges in by_topic.items()}
    shared = _shared(rest, topic_count)
    rest = {topic: without(ranges, shared) for topic, ranges in rest.items()}
    found = [BackfillQuestion(everything, *one) for one in merged(whole + shared)]
    return found + [BackfillQuestion(topic, *one) for topic, ranges in rest.items() for one in ranges]


def _widened(silence: Range, by_topic: Mapping[str, list[Range]]) -> Range:
    from_ns, to_ns = silence
    for ranges in by_topic.values():
        for first_ns, end_ns in ranges:
            if first_ns < silence[1] and end_ns > silence[0]:
                from_ns = min(from_ns, max(first_ns, silence[0] - WIDEN_NS))
                to_ns = max(to_ns, min(end_ns, silence[1] + WIDEN_NS))
    return from_ns, to_ns


def _shared(by_topic: Mapping[str, list[Range]], topic_count: int) -> list[Range]:
    """The times in which much of a robot is missing at once."""
    every = sorted(one for ranges in by_topic.values() for one in ranges)
    shared, place = [], 0
    for from_ns, to_ns in merged(every):
        first = place
        while place < len(every) and every[place][0] < to_ns:
            place += 1
        asked_ns = sum(end_ns - first_ns for first_ns, end_ns in every[first:place])
        if place - first > 1 and asked_ns >= SHARE * topic_count * (to_ns - from_ns):
            shared.append((from_ns, to_ns))
    return shared
