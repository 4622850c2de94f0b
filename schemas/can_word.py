"""Flags of CAN frames as in linux/can.h, names from the DBC, and losses by the alive counter.

Frames have these flags on Zenoh (``CanFrames.can_id`` and ``fd_flags``), so gateway and recorder share them.
"""

from __future__ import annotations

import re
from typing import Final


def snake_case(text: str) -> str:
    """``RearLeftSpeed`` to ``rear_left_speed``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text).lower()


EXTENDED: Final = 0x8000_0000
REMOTE: Final = 0x4000_0000
ERROR: Final = 0x2000_0000
IDENTIFIER_MASK: Final = 0x1FFF_FFFF
STANDARD_MASK: Final = 0x7FF

FD: Final = 0x4
BITRATE_SWITCH: Final = 0x1
ERROR_STATE_INDICATOR: Final = 0x2


COUNTER_SPAN: Final = 16
LATE_MAX_NS: Final = 10_000_000_000  # longest delay between the bus and its reader


class UnseenRounds:
    """Estimates how often the alive counter of one frame wrapped in a gap: the number that fits the period best.

    Attributes:
        window_ns: period of the counter. A gap of this length, or a step back of the clock, has to be followed,
            and every frame after it while ``is_waiting``.
        is_waiting: a gap is not judged yet, since late frames may still come.
        lost: frames lost in judged gaps, beyond the counter's own step: 16 for each wrap.
    """

    def __init__(self, period_ns: int) -> None:
        self.window_ns = COUNTER_SPAN * period_ns
        self.is_waiting = False
        self.lost = 0
        self._period_ns = period_ns
        # Delay of the frames against their counters, its minimum since the last gap, and the time until which late
        # frames may come.
        self._behind_ns = self._least_ns = self._until_ns = 0

    @property
    def lost_so_far(self) -> int:
        """``lost``, and the estimate so far for gaps that are not judged yet."""
        rounds = round(self._least_ns / self.window_ns) if self.is_waiting else 0
        return self.lost + max(0, rounds) * COUNTER_SPAN

    def follow(self, time_ns: int, elapsed_ns: int, steps: int) -> None:
        """Follow a frame that ends a gap, or comes while one is not judged yet.

        Args:
            steps: of the counter since the frame before; across a gap from 1 to 16.
        """
        is_gap = not 0 <= elapsed_ns < self.window_ns
        if elapsed_ns < 0 or (time_ns - elapsed_ns if is_gap else time_ns) > self._until_ns:
            self.judge()
        if elapsed_ns < 0 or not (is_gap or self.is_waiting):
            return
        self._behind_ns += elapsed_ns - steps * self._period_ns
        if is_gap:
            self.is_waiting = True
            self._until_ns = time_ns + min(self._behind_ns, LATE_MAX_NS)
            self._least_ns = self._behind_ns
        self._least_ns = min(self._least_ns, self._behind_ns)

    def judge(self) -> None:
        """Judge the gap: no more late frames can come."""
        self.lost = self.lost_so_far
        self.is_waiting = False
        self._behind_ns = 0
