"""Frames lost on the way from the chassis, by their alive counters; see ``schemas.alive_counter``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from operator import sub, xor
from typing import Final

import msgspec

from gateway.chassis.cruiser.layout import load
from gateway.chassis.layout import MessageLayout
from schemas.alive_counter import COUNTER_SPAN, UnseenRounds
from schemas.can_word import IDENTIFIER_MASK
from schemas.messages import Variant

FRAME_BYTES: Final = 8

COUNTER_AT: Final = 6
"""The byte whose upper half is the counter."""

FAR_NS: Final = 60_000_000_000
"""A gap of this length may be a step of the robot's clock."""

FAR_MAX: Final = 1000
"""Such gaps that are remembered; further ones count as gaps."""

_UPPER_HALF: Final = bytes(byte >> 4 for byte in range(256))
_CYCLE: Final = bytes(range(COUNTER_SPAN))


@cache
def feedback_frames() -> dict[int, MessageLayout]:
    """The chassis's periodic feedback frames by identifier; all are extended."""
    # Either variant would do: both have the same frames and cycle times.
    return {frame.can_id & IDENTIFIER_MASK: frame for frame in load(Variant.COARSE).feedback if frame.period_ns}


class ClockStep(msgspec.Struct, frozen=True):
    """The robot's wall clock was set between these two of its times."""

    before_ns: int
    after_ns: int

    def is_between(self, before_ns: int, after_ns: int) -> bool:
        """Report whether it may be what lies between two times of the same clock."""
        return max(before_ns, self.before_ns) < min(after_ns, self.after_ns)


class AliveCount:
    """Follows the alive counter of one identifier.

    Attributes:
        frames: frames seen.
        lost: frames that the counter passed over.
        repeated: frames with the counter of the one before.
        corrupt: frames with a wrong checksum; their counter is not read.
        outages: gaps in time in which the counter may have gone round, and steps back of the clock.
        unseen: frames lost in outages beyond those that the counter passed over: 16 for each time that it went
            round. Not those of outages that are left out.
        first_ns: when each of these was seen for the first time, by the name of the count.
    """

    def __init__(self, frame: MessageLayout) -> None:
        self.name = frame.name
        self.frames = self.lost = self.repeated = self.corrupt = self.outages = 0
        self.first_ns: dict[str, int] = {}
        self._period_ns = frame.period_ns
        self._rounds = UnseenRounds(frame.period_ns)
        self._unseen_before = 0
        # Of each far gap the times of the frames around it, and the judgement of it alone.
        self._far: list[tuple[int, int, UnseenRounds]] = []
        self._counter = 0
        self._time_ns = 0
        self._is_first = True

    @property
    def unseen(self) -> int:
        """As above; what is not judged yet counts by what has come so far."""
        return self._unseen_before + self._rounds.lost_so_far

    def leave_out(self, steps: Sequence[ClockStep]) -> int:
        """Take what seemed lost over steps of the robot's clock out of ``unseen``. Returns how many gaps."""
        gaps = [one for one in self._far if any(step.is_between(one[0], one[1]) for step in steps)]
        self._far = [one for one in self._far if one not in gaps]
        self._unseen_before -= sum(rounds.lost_so_far for _, _, rounds in gaps)
        return len(gaps)

    def _judge_apart(self) -> UnseenRounds:
        """Judge the frames from here on by themselves."""
        self._unseen_before += self._rounds.lost_so_far
        self._rounds = UnseenRounds(self._period_ns)
        return self._rounds

    def begin_anew(self) -> None:
        """Another gateway receives the frames from here on: what came between the two was not lost on the way."""
        self._rounds.judge()
        self._is_first = True

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
            not self._is_first
            and not self._rounds.is_waiting
            and min(gaps_ns) >= 0
            and max(gaps_ns) < self._rounds.window_ns
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
        if not self._is_first:
            elapsed_ns = time_ns - self._time_ns
            is_outage = not 0 <= elapsed_ns < self._rounds.window_ns
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
            if is_outage and elapsed_ns > FAR_NS and len(self._far) < FAR_MAX:
                self._far.append((self._time_ns, time_ns, self._judge_apart()))
            elif is_outage and self._far and self._rounds is self._far[-1][2]:
                self._judge_apart()
            if is_outage or self._rounds.is_waiting:
                self._rounds.follow(time_ns, elapsed_ns, steps)
        self._is_first = False
        self._counter, self._time_ns = counter, time_ns
