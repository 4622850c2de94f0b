"""Frames lost on the way from the chassis, by the alive counters that they carry.

A counter of 4 bits cannot tell a loss of 16 frames from none, so it is believed only across gaps in time of
fewer than 16 periods; a longer gap is an outage, and what it cost is told by the period.
"""

from __future__ import annotations

from functools import cache, reduce
from operator import xor
from typing import Final

from schemas.can_word import IDENTIFIER_MASK
from schemas.dbc_files import DbcFrame, dbc_text, frames
from schemas.messages import Variant

COUNTER_SPAN: Final = 16
FRAME_BYTES: Final = 8


@cache
def feedback_frames() -> dict[int, DbcFrame]:
    """The chassis's periodic feedback frames by identifier; all are extended."""
    # Either variant would do: both have the same frames and cycle times.
    return {
        frame.can_id & IDENTIFIER_MASK: frame
        for frame in frames(dbc_text(Variant.COARSE))
        if frame.is_feedback and frame.period_ns
    }


class AliveCount:
    """Follows the alive counter of one identifier.

    Attributes:
        frames: frames seen.
        lost: frames that the counter passed over.
        repeated: frames with the counter of the one before.
        corrupt: frames with a wrong checksum; their counter is not read.
        outages: gaps in time too long for the counter.
        unseen: frames that the outages would have held, by the period.
    """

    def __init__(self, frame: DbcFrame) -> None:
        self.name = frame.name
        self.frames = self.lost = self.repeated = self.corrupt = self.outages = self.unseen = 0
        self._period_ns = frame.period_ns
        self._window_ns = COUNTER_SPAN * frame.period_ns
        self._counter = 0
        self._time_ns = 0

    def receive(self, time_ns: int, data: bytes) -> None:
        """The next frame: when it was received, and its eight bytes."""
        self.frames += 1
        is_corrupt = reduce(xor, data) != 0
        counter = (self._counter + 1) % COUNTER_SPAN if is_corrupt else data[6] >> 4
        self.corrupt += is_corrupt
        if self.frames > 1:
            if not 0 <= time_ns - self._time_ns < self._window_ns:
                self.outages += 1
                self.unseen += max(0, round((time_ns - self._time_ns) / self._period_ns) - 1)
            elif counter == self._counter:
                self.repeated += 1
            else:
                self.lost += (counter - self._counter - 1) % COUNTER_SPAN
        self._counter, self._time_ns = counter, time_ns
