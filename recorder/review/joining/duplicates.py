"""Messages that came by before, in memory that does not grow with the logs.

What two recorders heard, or a log and its incident, has nearly the same log time in both. What a recorder asked
for later may be minutes behind, but there is little of it: it is remembered by itself.
"""

from __future__ import annotations

from typing import Final

RECENT_MAX: Final = 400_000
"""Messages that are remembered at least; at most twice as many."""

LATE_MAX: Final = 100_000
"""As many of those that may come late: an hour of a robot's decisions, events and journal."""


class Recent:
    """Remembers messages.

    Args:
        limit: so many at least, twice as many at most.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._newer: set[int] = set()
        self._older: set[int] = set()

    def is_new(self, channel_id: int, sequence: int, publish_ns: int, data: bytes) -> bool:
        """Report whether no such message came by before; it is remembered."""
        # One number takes less memory than a tuple of four.
        identity = ((hash(data) << 16 | channel_id) << 64 | publish_ns) << 32 | sequence
        if identity in self._newer or identity in self._older:
            return False
        self._newer.add(identity)
        if len(self._newer) >= self._limit:
            self._newer, self._older = set(), self._newer
        return True
