"""Words of CAN: what describes a frame, as in linux/can.h, names from the DBC, and losses by the alive counter.

Frames are in this form on Zenoh (``CanFrames.can_id`` and ``fd_flags``), so gateway and recorder share it.
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

LATE_MAX_NS: Final = 10_000_000_000  # nothing waits for longer between the bus and its reader


class UnseenRounds:
    """Judges how often the counter of one frame went round unseen: as often as fits the period best.

    Attributes:
        window_ns: the counter goes round in so long. A gap of this length, or a step back of the clock, is to be
            followed, and every frame after it while ``is_waiting``.
        is_waiting: a gap is not judged yet, for frames that were only late may still come.
        lost: frames lost in the gaps that are judged beyond those that the counter passed over, 16 for each round.
    """

    def __init__(self, period_ns: int) -> None:
        self.window_ns = COUNTER_SPAN * period_ns
        self.is_waiting = False
        self.lost = 0
        self._period_ns = period_ns
        # By how much the frames came later than their counters say, the least of that since the last gap, and
        # until when frames may come that were only late.
        self._behind_ns = self._least_ns = self._until_ns = 0

    @property
    def lost_so_far(self) -> int:
        """``lost``, and of the gaps that are not judged yet, what they count by the frames that have come."""
        rounds = round(self._least_ns / self.window_ns) if self.is_waiting else 0
        return self.lost + max(0, rounds) * COUNTER_SPAN

    def follow(self, time_ns: int, elapsed_ns: int, steps: int) -> None:
        """A frame that ends a gap, or comes while one is not judged yet.

        Args:
            steps: of the counter since then; across a gap from 1 to 16.
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
        """No frame comes any more that was only late."""
        self.lost = self.lost_so_far
        self.is_waiting = False
        self._behind_ns = 0
