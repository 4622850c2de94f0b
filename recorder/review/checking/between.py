"""Samples that are in none of several logs: lost between two of them, by the sequences at their ends.

The logs of one recorder follow each other, and so do those of recorders that share a fleet.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import msgspec

from recorder.encoding.key_counters import RESTART_STEP, SEQUENCE_SPAN
from schemas import keys


class ChannelEnds(msgspec.Struct, frozen=True):
    """The first and the last message of a channel in a log.

    Attributes:
        first, last: their sequences.
        first_ns, last_ns: their log times.
    """

    first: int
    last: int
    first_ns: int
    last_ns: int


class Between(msgspec.Struct, frozen=True):
    """Samples of a robot that are missing between two logs.

    Attributes:
        robot: the first chunks of its keys.
        samples: how many, on so many ``topics``.
        from_ns, to_ns: log times of the last message before, and of the first one after.
        before, after: the two logs.
    """

    robot: str
    samples: int
    topics: int
    from_ns: int
    to_ns: int
    before: str
    after: str


def between(logs: Iterable[tuple[str, dict[str, ChannelEnds]]]) -> list[Between]:
    """Find what is in none of the logs.

    Where a gateway began anew between two logs, nobody knows what it had still said, and nothing is counted.

    Args:
        logs: of each its path, and the ends of its channels by topic.
    """
    by_topic: dict[str, list[tuple[ChannelEnds, str]]] = {}
    for path, ends in logs:
        for topic, one in ends.items():
            by_topic.setdefault(topic, []).append((one, path))
    found: dict[tuple[str, str, str], list[Between]] = {}
    for topic, parts in by_topic.items():
        for missing in _of_topic(topic, sorted(parts, key=lambda part: part[0].first_ns)):
            found.setdefault((missing.robot, missing.before, missing.after), []).append(missing)
    return sorted(map(_together, found.values()), key=lambda one: (one.from_ns, one.robot))


def _of_topic(topic: str, parts: list[tuple[ChannelEnds, str]]) -> Iterator[Between]:
    parsed = keys.parse(topic)
    robot = f"{parsed.root}/{parsed.robot}" if parsed and parsed.robot else topic
    before, path = parts[0]
    for after, next_path in parts[1:]:
        step = (after.first - before.last - 1) % SEQUENCE_SPAN
        if after.first_ns >= before.last_ns and 0 < step < RESTART_STEP:
            yield Between(robot, step, 1, before.last_ns, after.first_ns, path, next_path)
        # An incident's log lies within another.
        if after.last_ns > before.last_ns:
            before, path = after, next_path


def _together(found: list[Between]) -> Between:
    return msgspec.structs.replace(
        found[0],
        samples=sum(one.samples for one in found),
        topics=len(found),
        from_ns=min(one.from_ns for one in found),
        to_ns=max(one.to_ns for one in found),
    )
