"""What the recorder has to say in a log while no file of it is open, until one is. Pure.

Each gap is published when it is told; here those of one key and reason become one, so that a disk may be full for
as long as it likes.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from recorder.record.gaps import OTHER_KEYS
from schemas.messages import Message
from schemas.recording import GapReason, RecordGap

EVENTS_MAX: Final = 1000
"""Events that wait; beyond it the oldest go."""

KEYS_MAX: Final = 1000
"""Gaps that wait; those of further keys are one gap of the key ``OTHER_KEYS``."""

Said = tuple[str, Message]
"""A topic, and what is to be said there."""


class Unsaid:
    """Gathers it."""

    def __init__(self) -> None:
        self._events: deque[Said] = deque(maxlen=EVENTS_MAX)
        self._gaps: dict[tuple[str, str, GapReason], RecordGap] = {}

    def add(self, topic: str, message: Message) -> None:
        """This is to be said in the next file."""
        if not isinstance(message, RecordGap):
            self._events.append((topic, message))
            return
        key = message.key
        if (topic, key, message.reason) not in self._gaps and len(self._gaps) >= KEYS_MAX:
            key = OTHER_KEYS
        place = topic, key, message.reason
        self._gaps[place] = _merged(self._gaps.get(place), message, key)

    def take(self) -> list[Said]:
        """What is to be said now: the events in their order, then the gaps."""
        said = [*self._events, *((topic, gap) for (topic, _, _), gap in self._gaps.items())]
        self._events.clear()
        self._gaps.clear()
        return said


def _merged(before: RecordGap | None, gap: RecordGap, key: str) -> RecordGap:
    """Two gaps of a key and reason as one, told when the second was."""
    first_ns, last_ns, count = gap.first_ns, gap.last_ns, gap.count
    if before is not None:
        first_ns, last_ns = min(first_ns, before.first_ns), max(last_ns, before.last_ns)
        count += before.count
    return RecordGap(gap.time_ns, gap.sequence, key, gap.reason, first_ns, last_ns, count)
