"""A rate that is kept to: of bytes, of messages, of connections. Pure."""

from __future__ import annotations

from typing import Final

BURST_S: Final = 0.1
"""A pause is caught up by no more than this: nothing comes in a flood behind it."""


class RateLimit:
    """A rate that is not exceeded.

    Args:
        per_s: the rate; 0 is no limit.
        burst_s: the pause that may be caught up.
    """

    def __init__(self, per_s: float, burst_s: float = BURST_S) -> None:
        self.per_s = per_s
        self._burst_s = burst_s
        self._free_s = 0.0
        """From when on more may go."""

    def delay_s(self, count: float, now_s: float) -> float:
        """Take so many. Returns the time to wait behind them."""
        if not self.per_s:
            return 0.0
        self._free_s = max(self._free_s, now_s - self._burst_s) + count / self.per_s
        return max(0.0, self._free_s - now_s)
