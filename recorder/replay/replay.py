"""Schedules the contents of a log again. Pure: the time is an argument, and what is due comes out.

Every due time is counted from one anchor, so that nothing adds up: a replay of ten hours is as long as the log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Final, Generic, Protocol, TypeVar

import msgspec

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


class Timed(Protocol):
    """An item of a replay."""

    @property
    def time_ns(self) -> int:
        """Its time in the log, in nanoseconds since 1970."""
        ...


T = TypeVar("T", bound=Timed)


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


class Due(msgspec.Struct, Generic[T], frozen=True, gc=False):
    """An item that is due, and its due time."""

    item: T
    due_ns: int


class ReplayScheduler(Generic[T]):
    """Plays what a log holds, from its beginning or from a time in it, once or several times.

    Args:
        read: returns the runs from a log time on; None is the beginning.
        pace: when it is due.
        loops: number of times; FOR_EVER does not end.

    Attributes:
        pace: as it was given.
        lateness: of what was handed out, if it is paced.
        slipped_ns: by how much the whole has been put off, as it could not keep up: see SLIP_NS.
        time_ns: the log's time of what was handed out last; None before.
        loop: the number of the present loop, from 1.
        is_ended: nothing more will come.
        is_paused: nothing is handed out.
    """

    def __init__(self, read: Callable[[int | None], Iterator[T]], pace: Pace, loops: int = 1) -> None:
        self._read = read
        self.pace = pace
        self._loops = loops
        self._items: Iterator[T] = iter(())
        self._next: Due[T] | None = None
        self._last_due_ns = 0
        self._paused_ns: int | None = None
        self._has_played = False
        self.lateness = Lateness()
        self.slipped_ns = 0
        self.time_ns: int | None = None
        self.loop = 1
        self.is_ended = False

    @property
    def is_paused(self) -> bool:
        """True if it stands still."""
        return self._paused_ns is not None

    @property
    def next_ns(self) -> int | None:
        """The due time of the next item; None at the end, and while it is paused."""
        return None if self._next is None or self.is_paused else self._next.due_ns

    def start(self, now_ns: int) -> None:
        """Begin."""
        self._begin(None, now_ns)

    def take(self, now_ns: int) -> Due[T] | None:
        """The next one, if it is due."""
        due = self._next
        if due is None or self.is_paused or due.due_ns > now_ns:
            return None
        if self.pace.is_paced:
            late_ns = now_ns - due.due_ns
            self.lateness.add(late_ns)
            if late_ns > SLIP_NS:
                due = Due(due.item, now_ns)
                self.pace.delay(late_ns)
                self.slipped_ns += late_ns
        self.time_ns = due.item.time_ns
        self._last_due_ns = due.due_ns
        self._has_played = True
        self._advance()
        return due

    def pause(self, now_ns: int) -> None:
        """Stand still."""
        if self._paused_ns is None:
            self._paused_ns = now_ns

    def resume(self, now_ns: int) -> None:
        """Go on where it stood still."""
        if self._paused_ns is None:
            return
        self.hold(now_ns - self._paused_ns)
        self._paused_ns = None

    def hold(self, duration_ns: int) -> None:
        """All that is not due yet is due so much later."""
        self.pace.delay(duration_ns)
        if self._next is not None:
            self._next = Due(self._next.item, self._next.due_ns + duration_ns)

    def seek(self, time_ns: int, now_ns: int) -> None:
        """Go on at this time of the log, or at the first thing after it."""
        if not self.is_ended:
            self._begin(time_ns, now_ns)
            self.time_ns = self._next.item.time_ns if self._next is not None else self.time_ns
            if self._paused_ns is not None:
                self._paused_ns = now_ns

    def _begin(self, from_ns: int | None, now_ns: int) -> None:
        self._items = self._read(from_ns)
        self._last_due_ns = now_ns
        self.pace.start(now_ns)
        self._advance()

    def _advance(self) -> None:
        item = next(self._items, None)
        if item is None and self._has_played and (self._loops == FOR_EVER or self.loop < self._loops):
            self.loop += 1
            self._has_played = False
            self._items = self._read(None)
            # Not from now on: what was late does not make the next round late too.
            self.pace.start(self._last_due_ns)
            item = next(self._items, None)
        self._next = None if item is None else Due(item, self.pace.due_ns(item.time_ns))
        self.is_ended = item is None
