"""How old a drive command can be, without clocks in common.

The arbiter publishes its tick. A command carries the newest tick that its sender had seen, so it was made after
that tick went out: its age is at most the time since then. A stalled link, a replay and a sender whose clock is a
year off are all told apart by this alone.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from schemas.reasons import Reason

REMEMBERED_NS: Final = 4_000_000_000
"""Ticks published longer ago than this are forgotten; a command that echoes one is too old for any setting."""


class TickLog:
    """When each tick was published."""

    def __init__(self) -> None:
        self._published: deque[tuple[int, int]] = deque()
        self._times_ns: dict[int, int] = {}

    @property
    def published(self) -> list[tuple[int, int]]:
        """Number and time of those that are remembered."""
        return list(self._published)

    def recall(self, published: list[tuple[int, int]]) -> None:
        """Remember these, and no others."""
        self._published = deque(published)
        self._times_ns = dict(self._published)

    def publish(self, tick: int, now_ns: int) -> None:
        """This tick goes out now."""
        self._published.append((tick, now_ns))
        self._times_ns[tick] = now_ns
        while now_ns - self._published[0][1] > REMEMBERED_NS:
            self._times_ns.pop(self._published.popleft()[0], None)

    def age_ns(self, tick: int, now_ns: int) -> int | Reason:
        """The greatest age of a command that echoes this tick, or why it is not known."""
        published_ns = self._times_ns.get(tick)
        return Reason.TICK_UNKNOWN if published_ns is None else now_ns - published_ns
