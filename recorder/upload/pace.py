"""Bandwidth and hours of the day. Pure."""

from __future__ import annotations

from typing import Final

BURST_S: Final = 0.1
"""A pause is caught up by no more than this: nothing comes in a flood behind it."""


class RateLimit:
    """A rate that is not exceeded.

    Args:
        bytes_per_s: the rate; 0 is no limit.
    """

    def __init__(self, bytes_per_s: int) -> None:
        self.bytes_per_s = bytes_per_s
        self._free_s = 0.0
        """From when on more may go."""

    def delay_s(self, count: int, now_s: float) -> float:
        """Take so many bytes. Returns the time to wait behind them."""
        if not self.bytes_per_s:
            return 0.0
        self._free_s = max(self._free_s, now_s - BURST_S) + count / self.bytes_per_s
        return max(0.0, self._free_s - now_s)


def is_within(hours: str, minute: int) -> bool:
    """True if the minute of a day is within these hours, ``22:00-05:30``; each is, where none are given."""
    if not hours:
        return True
    start, end = (int(time[:2]) * 60 + int(time[3:]) for time in hours.split("-"))
    if start <= end:
        return start <= minute < end or start == end
    return minute >= start or minute < end
