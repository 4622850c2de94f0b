"""Schedules the contents of a log again. Pure: the time is an argument, and what is due comes out.

Every due time is counted from one anchor, so that nothing adds up: a replay of ten hours is as long as the log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Final

import msgspec

from recorder.replay.samples import ReplaySample

AS_FAST_AS_POSSIBLE: Final = 0.0
"""The speed that waits for nothing."""

FOR_EVER: Final = 0
"""The number of loops that never ends."""

SET_BACK_NS: Final = 1_000_000_000
"""A message that is further behind in the log's time is late, or the clock was set back."""

SET_BACK_AFTER: Final = 100
"""Messages in a row that are further behind before the clock counts as set back."""

SLIP_NS: Final = 1_000_000_000
"""A process that stood still for longer (Ctrl-Z, a machine that slept) resumes from there, without a burst."""

_BUCKET_NS: Final = 100_000
_LAST_BUCKET: Final = 20_000


class Pace:
    """From the log's time to the clock's. Due times never step back.

    Args:
        speed: so many times as fast as recorded; AS_FAST_AS_POSSIBLE makes everything due at once.
        longest_pause_ns: a pause of the log that is longer is cut to this, of the log's time.

    Attributes:
        cut: pauses that were cut.
    """

    def __init__(self, speed: float, longest_pause_ns: int) -> None:
        self._speed = speed
        self._longest_pause_ns = longest_pause_ns
        self._anchor_ns = self._anchor_time_ns = self._latest_ns = 0
        self._is_anchored = False
        self._behind = 0
        self.cut = 0

    @property
    def is_paced(self) -> bool:
        """True if anything has a due time at all."""
        return self._speed > 0

    def start(self, now_ns: int) -> None:
        """Make the next item due now."""
        self._anchor_ns = now_ns
        self._is_anchored = False

    def delay(self, duration_ns: int) -> None:
        """All that is not due yet is due so much later."""
        self._anchor_ns += duration_ns

    def due_ns(self, time_ns: int) -> int:
        """Return the due time of a log time. To be called in the order of the log, once for each item."""
        if not self._is_anchored:
            self._is_anchored = True
            self._anchor_time_ns = self._latest_ns = time_ns
        self._behind = self._behind + 1 if time_ns < self._latest_ns - SET_BACK_NS else 0
        if self._behind > SET_BACK_AFTER:
            self._behind = 0
            self._anchor_time_ns += time_ns - self._latest_ns
            self._latest_ns = time_ns
        pause_ns = time_ns - self._latest_ns
        if pause_ns > self._longest_pause_ns:
            self._anchor_time_ns += pause_ns - self._longest_pause_ns
            self.cut += 1
        self._latest_ns = max(self._latest_ns, time_ns)
        if not self.is_paced:
            return self._anchor_ns
        return self._anchor_ns + round((self._latest_ns - self._anchor_time_ns) / self._speed)


class Lateness:
    """The lateness of items, in buckets of 0.1 ms; the last one holds all that is later than 2 s."""

    def __init__(self) -> None:
        self._buckets: Counter[int] = Counter()
        self.max_ns = 0

    def add(self, late_ns: int) -> None:
        """One that was so late."""
        late_ns = max(0, late_ns)
        self._buckets[min(late_ns // _BUCKET_NS, _LAST_BUCKET)] += 1
        self.max_ns = max(self.max_ns, late_ns)

    def quantile_ns(self, part: float) -> int:
        """This part of them was no later; 0 if there were none."""
        left = part * self._buckets.total()
        for number in sorted(self._buckets):
            left -= self._buckets[number]
            if left <= 0:
                return self.max_ns if number == _LAST_BUCKET else min((number + 1) * _BUCKET_NS, self.max_ns)
        return 0


class Due(msgspec.Struct, frozen=True, gc=False):
    """A sample that is due, and its due time."""

    item: ReplaySample
    due_ns: int


class ReplayScheduler:
    """Plays what a log holds, once or several times.

    Args:
        read: returns the samples from the beginning on.
        pace: when it is due.
        loops: number of times; FOR_EVER does not end.

    Attributes:
        pace: as it was given.
        lateness: of what was handed out, if it is paced.
        slipped_ns: by how much the whole has been put off, as it could not keep up: see SLIP_NS.
        loop: the number of the present loop, from 1.
        is_ended: nothing more will come.
    """

    def __init__(self, read: Callable[[], Iterator[ReplaySample]], pace: Pace, loops: int = 1) -> None:
        self._read = read
        self.pace = pace
        self._loops = loops
        self._items: Iterator[ReplaySample] = iter(())
        self._next: Due | None = None
        self._last_due_ns = 0
        self._has_played = False
        self.lateness = Lateness()
        self.slipped_ns = 0
        self.loop = 1
        self.is_ended = False

    @property
    def next_ns(self) -> int | None:
        """The due time of the next sample; None at the end."""
        return None if self._next is None else self._next.due_ns

    def start(self, now_ns: int) -> None:
        """Begin."""
        self._items = self._read()
        self._last_due_ns = now_ns
        self.pace.start(now_ns)
        self._advance()

    def take(self, now_ns: int) -> Due | None:
        """The next one, if it is due."""
        due = self._next
        if due is None or due.due_ns > now_ns:
            return None
        if self.pace.is_paced:
            late_ns = now_ns - due.due_ns
            self.lateness.add(late_ns)
            if late_ns > SLIP_NS:
                due = Due(due.item, now_ns)
                self.pace.delay(late_ns)
                self.slipped_ns += late_ns
        self._last_due_ns = due.due_ns
        self._has_played = True
        self._advance()
        return due

    def hold(self, duration_ns: int) -> None:
        """All that is not due yet is due so much later."""
        self.pace.delay(duration_ns)
        if self._next is not None:
            self._next = Due(self._next.item, self._next.due_ns + duration_ns)

    def _advance(self) -> None:
        item = next(self._items, None)
        if item is None and self._has_played and (self._loops == FOR_EVER or self.loop < self._loops):
            self.loop += 1
            self._has_played = False
            self._items = self._read()
            # Not from now on: what was late does not make the next round late too.
            self.pace.start(self._last_due_ns)
            item = next(self._items, None)
        self._next = None if item is None else Due(item, self.pace.due_ns(item.time_ns))
        self.is_ended = item is None
