"""When what a robot says is believed: anyone on its network can forge a sample. Pure."""

from __future__ import annotations

from collections import deque
from typing import Final

CONFIRM_NS: Final = 150_000_000
"""What is believed was said for so long..."""

CONFIRM_SAMPLES: Final = 3
"""...and in so many samples: anyone can put a false one between the robot's own."""

EVIDENCE_NS: Final = 1_000_000_000
"""Samples that are older prove nothing any more."""


class Evidence:
    """Samples that say the same, until there are enough of them to be believed."""

    def __init__(self) -> None:
        self._times_ns: deque[int] = deque()

    def add(self, now_ns: int) -> bool:
        """One more. Whether they are enough."""
        times_ns = self._times_ns
        times_ns.append(now_ns)
        while now_ns - times_ns[0] > EVIDENCE_NS:
            times_ns.popleft()
        return self.is_enough

    @property
    def is_enough(self) -> bool:
        """There are enough of them."""
        times_ns = self._times_ns
        return len(times_ns) >= CONFIRM_SAMPLES and times_ns[-1] - times_ns[0] >= CONFIRM_NS

    def clear(self) -> None:
        """A sample says otherwise."""
        self._times_ns.clear()
