"""The robot's clock on the recorder's line of time.

What a robot says carries its own time. That is the better one, since it is that of the fact and not of the
receipt, as long as the two clocks agree. Where they do not, or where the robot's was set meanwhile, the arbiter's
tick tells what was before and what after.
"""

from __future__ import annotations

from typing import Final

from schemas.settings import TICK_NS

NEAR_NS: Final = 1_000_000_000
"""Clocks that differ by no more agree."""

FAR_NS: Final = 60_000_000_000
"""No sample is under way for so long: clocks that differ by more do so from the first sample on..."""

_SURE_AFTER: Final = 5
"""...and by less if so many say so: the first ones may have waited for the link."""

_TICKS_NEAR: Final = 500
"""Over so many ticks, 5 s, the tick tells time: later ones may have been late."""

RUN_TICKS: Final = 10**9
"""A run's ticks begin at a random number of 40 bits: a step of this much, a hundred days, is another run."""


class RobotClock:
    """The clock of one robot.

    Attributes:
        offset_ns: what is to be added to its times; 0 while it agrees with the recorder's.
    """

    def __init__(self) -> None:
        self.offset_ns = 0
        self._tick: int | None = None
        self._publish_ns = self._log_ns = 0
        self._first: list[int] | None = []
        """How far the first states of a run are off; None once that is settled."""

    def is_other_run(self, tick: int) -> bool:
        """The tick is not of the run that was heard last."""
        return self._tick is not None and abs(tick - self._tick) >= RUN_TICKS

    def hear(self, tick: int, publish_ns: int, log_ns: int) -> str:
        """A state of the arbiter, which is never asked for later, came.

        Returns:
            what it tells of the clock, in words; empty if nothing.
        """
        if self.is_other_run(tick):
            self._tick, self._first = None, []
        if self._tick is not None and tick <= self._tick:
            return ""
        said = ""
        if self._first is not None:
            said = self._settle(log_ns - publish_ns)
        elif self._tick is not None:
            offset_ns = _unless_near(self.place(publish_ns, log_ns, tick) - publish_ns)
            set_ns, self.offset_ns = self.offset_ns - offset_ns, offset_ns
            said = f"the robot's clock was set by {set_ns / 1e9:+.1f} s" if set_ns else ""
        self._tick, self._publish_ns, self._log_ns = tick, publish_ns, log_ns
        return said

    def _settle(self, off_ns: int) -> str:
        """How far is it from the recorder's? Told once that is sure."""
        first = self._first if self._first is not None else []
        first.append(off_ns)
        nearest_ns = min(first, key=abs)
        is_near, is_far = abs(nearest_ns) <= NEAR_NS, abs(nearest_ns) > FAR_NS
        if not is_near and not is_far and len(first) < _SURE_AFTER:
            return ""
        self._first = None
        before_ns, self.offset_ns = self.offset_ns, _unless_near(nearest_ns)
        if not self.offset_ns or abs(before_ns - self.offset_ns) <= NEAR_NS:
            return ""
        way = "behind" if self.offset_ns > 0 else "ahead of"
        seconds = abs(self.offset_ns) / 1e9
        return f"the robot's clock is {seconds:.1f} s {way} the recorder's; the times here are the recorder's"

    def place(self, publish_ns: int, log_ns: int, tick: int | None = None) -> int:
        """When something was that the robot says was at ``publish_ns``, and that was received at ``log_ns``."""
        by_clock_ns = publish_ns + self.offset_ns
        if tick is None or self._tick is None or abs(tick - self._tick) > _TICKS_NEAR:
            return by_clock_ns if by_clock_ns <= log_ns + NEAR_NS else log_ns
        expected_ns = self._publish_ns + (tick - self._tick) * TICK_NS
        if abs(publish_ns - expected_ns) <= NEAR_NS:
            return by_clock_ns
        # Either the clock was set, or the gateway made a pause, and then the receipt is as late as the clock says.
        by_tick_ns = expected_ns + self.offset_ns
        received_ns = log_ns - self._log_ns
        paused = abs((publish_ns - self._publish_ns) - received_ns) <= NEAR_NS
        return by_clock_ns if paused else by_tick_ns


def _unless_near(offset_ns: int) -> int:
    return offset_ns if abs(offset_ns) > NEAR_NS else 0
