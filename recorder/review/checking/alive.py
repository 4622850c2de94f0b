"""Frames lost on the way from the chassis, by the alive counters that they carry.

The counter decides. It has 4 bits, so in a gap of 16 periods or more it may have gone round unseen. How often is
judged by the period, and only when the frames that waited have come: a busy machine delivers late, and then all at
once.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from operator import sub, xor
from typing import Final

from schemas.can_word import IDENTIFIER_MASK
from schemas.dbc_files import DbcFrame, dbc_text, frames
from schemas.messages import Variant

COUNTER_SPAN: Final = 16
FRAME_BYTES: Final = 8

LATE_MAX_NS: Final = 10_000_000_000
"""Nothing waits for longer between the bus and the log."""

COUNTER_AT: Final = 6
"""The byte whose upper half is the counter."""

_UPPER_HALF: Final = bytes(byte >> 4 for byte in range(256))
_CYCLE: Final = bytes(range(COUNTER_SPAN))


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
        outages: gaps in time in which the counter may have gone round, and steps back of the clock.
        unseen: frames lost in outages beyond those that the counter passed over: 16 for each time that it went
            round. So often it did as fits the period best; frames that follow faster than it were only late.
        first_ns: when each of these was seen for the first time, by the name of the count.
    """

    def __init__(self, frame: DbcFrame) -> None:
        self.name = frame.name
        self.frames = self.lost = self.repeated = self.corrupt = self.outages = 0
        self.first_ns: dict[str, int] = {}
        self._period_ns = frame.period_ns
        self._window_ns = COUNTER_SPAN * frame.period_ns
        self._counter = 0
        self._time_ns = 0
        self._unseen = 0
        # Of outages that are not judged yet: by how much the frames came later than their counters say, the least
        # of that since the last of them, and until when frames may come that were only late.
        self._behind_ns: int | None = None
        self._least_ns = self._until_ns = 0

    @property
    def unseen(self) -> int:
        """As above; what is not judged yet counts by what has come so far."""
        return self._unseen + self._gone_round()

    def receive(self, time_ns: int, data: bytes) -> None:
        """The next frame: when it was received, and its eight bytes."""
        is_corrupt = reduce(xor, data) != 0
        if is_corrupt:
            self.corrupt += 1
            self.first_ns.setdefault("corrupt", time_ns)
        self._count(time_ns, (self._counter + 1) % COUNTER_SPAN if is_corrupt else data[COUNTER_AT] >> 4)

    def receive_many(self, times_ns: Sequence[int], counters: bytes) -> None:
        """The next frames, whose checksums are right: when they were received, and the byte with each counter."""
        halves = counters.translate(_UPPER_HALF)
        count, first = len(halves), (self._counter + 1) % COUNTER_SPAN
        gaps_ns = list(map(sub, times_ns, (self._time_ns, *times_ns[:-1])))
        is_regular = (
            self.frames > 0
            and self._behind_ns is None
            and min(gaps_ns) >= 0
            and max(gaps_ns) < self._window_ns
            and halves == (_CYCLE * (count // COUNTER_SPAN + 2))[first : first + count]
        )
        if is_regular:
            self.frames += count
            self._counter, self._time_ns = halves[-1], times_ns[-1]
            return
        for time_ns, counter in zip(times_ns, halves, strict=True):
            self._count(time_ns, counter)

    def _count(self, time_ns: int, counter: int) -> None:
        self.frames += 1
        if self.frames > 1:
            elapsed_ns = time_ns - self._time_ns
            is_outage = not 0 <= elapsed_ns < self._window_ns
            steps = (counter - self._counter) % COUNTER_SPAN
            if is_outage:
                self.outages += 1
                self.first_ns.setdefault("outages", time_ns)
                steps = steps or COUNTER_SPAN
            if not steps:
                self.repeated += 1
                self.first_ns.setdefault("repeated", time_ns)
            elif steps > 1 and elapsed_ns >= 0:
                self.lost += steps - 1
                self.first_ns.setdefault("lost", time_ns)
            if is_outage or self._behind_ns is not None:
                self._follow(time_ns, elapsed_ns, steps, is_outage=is_outage)
        self._counter, self._time_ns = counter, time_ns

    def _follow(self, time_ns: int, elapsed_ns: int, steps: int, *, is_outage: bool) -> None:
        """Wait for frames that are only late, and judge the outage when they have come."""
        if elapsed_ns < 0 or (self._time_ns if is_outage else time_ns) > self._until_ns:
            self._unseen, self._behind_ns = self.unseen, None
        if elapsed_ns < 0 or (self._behind_ns is None and not is_outage):
            return
        self._behind_ns = (self._behind_ns or 0) + elapsed_ns - steps * self._period_ns
        if is_outage:
            self._until_ns = time_ns + min(self._behind_ns, LATE_MAX_NS)
            self._least_ns = self._behind_ns
        self._least_ns = min(self._least_ns, self._behind_ns)

    def _gone_round(self) -> int:
        """Frames lost in the outages that are not judged yet, of which the counter shows nothing."""
        rounds = 0 if self._behind_ns is None else round(self._least_ns / self._window_ns)
        return max(0, rounds) * COUNTER_SPAN
