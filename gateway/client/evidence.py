"""Decides when samples of a robot are believed: anyone on its network can forge one. Pure.

A robot that is not so says otherwise many times a second. Whoever reads must see all of that: a sample that is
lost may be the one that contradicts. Samples may be read late and many at once. Each has the time when it is read:
what was delivered until then is read in the same batch, before anything is believed.
"""

from __future__ import annotations

from math import inf
from typing import Final

CONFIRM_NS: Final = 150_000_000
"""Time over which a robot's states must agree to be believed."""

CONFIRM_SAMPLES: Final = 3
"""Samples in which it must say so: anyone can put a false one between the robot's own."""


class Evidence:
    """Samples that say the same, until there are enough of them to be believed."""

    def __init__(self, pause_max_ns: float = inf) -> None:
        """Begin with none.

        Args:
            pause_max_ns: samples before a longer pause prove nothing any more.
        """
        self._pause_max_ns = pause_max_ns
        self._count = self._first_ns = self._last_ns = 0

    def add(self, now_ns: int) -> bool:
        """One more, read now. Whether they are enough."""
        if not self._count or now_ns - self._last_ns > self._pause_max_ns:
            self._count, self._first_ns = 0, now_ns
        self._count, self._last_ns = self._count + 1, now_ns
        return self.is_enough

    @property
    def is_enough(self) -> bool:
        """There are enough of them."""
        return self._count >= CONFIRM_SAMPLES and self._last_ns - self._first_ns >= CONFIRM_NS

    def clear(self) -> None:
        """A sample says otherwise, or some may be missing."""
        self._count = 0
