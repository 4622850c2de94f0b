"""The robot's clock in relation to the recorder's.

Each message of a robot carries its own time. That is the better one, since it is that of the fact and not of the
receipt, as long as the two clocks agree. Where they do not, or where the robot's was set meanwhile, the arbiter's
tick gives the order of events.
"""

from __future__ import annotations

from typing import Final

from schemas.decisions import is_same_run
from schemas.settings import TICK_NS

NEAR_NS: Final = 1_000_000_000
"""Clocks that differ by no more agree."""

FAR_NS: Final = 60_000_000_000
"""No sample is under way for so long: clocks that differ by more do so from the first sample on."""

_SURE_AFTER: Final = 5
"""Samples that must agree before a clock counts as behind by less than ``FAR_NS``."""

SETTLE_NS: Final = 3_000_000_000
"""Time over which they must be received: what waited for the link or the recorder comes in one burst."""

_TICKS_NEAR: Final = 500
"""Over so many ticks, 5 s, the tick is a measure of time: later ones may have been late."""


class RobotClock:
    """The clock of one robot.

    Nothing is received before it is said, and much may be received late. So the smallest difference of receipt and
    robot's time is the nearest to that of the clocks, and a later one that is smaller proves the offset wrong.

    Attributes:
        offset_ns: to be added to its times; 0 while it agrees with the recorder's.
        corrected_ns: by how much the last received state proved the offset wrong: the times of those before
            it are wrong by so much, too. 0 where the clock was set, and they are right.
    """

    def __init__(self) -> None:
        self.offset_ns = 0
        self.corrected_ns = 0
        self._tick: int | None = None
        self._publish_ns = self._log_ns = 0
        self._told_ns = 0
        """The offset that was reported last."""
        self._begin(0)

    def _begin(self, log_ns: int) -> None:
        """Begin anew: the clock was set, or restarted, and earlier states say nothing about it."""
        self._least_ns: int | None = None
        self._since_ns = log_ns
        self._states = 0
        self._is_settled = False

    def is_other_run(self, tick: int) -> bool:
        """Return True if the tick is not of the last received run."""
        return self._tick is not None and not is_same_run(tick, self._tick)

    def hear(self, tick: int, publish_ns: int, log_ns: int) -> str:
        """Add a state of the arbiter; states are never queried later.

        Returns:
            a sentence about a change of the clock; empty if there is none.
        """
        self.corrected_ns = 0
        if self._tick is not None and tick <= self._tick and not self.is_other_run(tick):
            return ""
        said = ""
        before_ns = self.offset_ns
        is_near = self._is_near(tick)
        set_ns = self._set_by(publish_ns, log_ns, tick)
        if not is_near and not self._explains(log_ns - publish_ns):
            self._begin(log_ns)
        elif set_ns:
            said = f"the robot's clock was set by {set_ns / 1e9:+.1f} s"
            self._least_ns = self.offset_ns - set_ns
            self._is_settled = True
        self._weigh(log_ns - publish_ns, log_ns)
        if said:
            self._told_ns = self.offset_ns
        elif is_near:
            self.corrected_ns = self.offset_ns - before_ns
        self._tick, self._publish_ns, self._log_ns = tick, publish_ns, log_ns
        return said or self._news()

    def _explains(self, off_ns: int) -> bool:
        """Return True if the clock is as before the pause, as far as is known."""
        return self._is_settled and self._least_ns is not None and 0 <= off_ns - self._least_ns <= NEAR_NS

    def _weigh(self, off_ns: int, log_ns: int) -> None:
        """A state was received so long after the robot's time. The smallest such time counts, once it is sure."""
        self._states += 1
        self._least_ns = off_ns if self._least_ns is None else min(self._least_ns, off_ns)
        is_behind = NEAR_NS < self._least_ns <= FAR_NS
        is_sure = self._states >= _SURE_AFTER and log_ns - self._since_ns >= SETTLE_NS
        if is_behind and not is_sure and not self._is_settled:
            return
        self._is_settled = True
        self.offset_ns = 0 if 0 <= self._least_ns <= NEAR_NS else self._least_ns

    def _news(self) -> str:
        """Return a sentence on the offset from the recorder's clock; empty if it is as reported last."""
        if abs(self.offset_ns - self._told_ns) <= NEAR_NS:
            return ""
        self._told_ns = self.offset_ns
        if abs(self.offset_ns) <= NEAR_NS:
            return (
                "the robot's clock agrees with the recorder's; where an entry said otherwise, it no longer holds"
            )
        way = "behind" if self.offset_ns > 0 else "ahead of"
        seconds = abs(self.offset_ns) / 1e9
        return f"the robot's clock is {seconds:.1f} s {way} the recorder's; the times here are the recorder's"

    def place(self, publish_ns: int, log_ns: int, tick: int | None = None) -> int:
        """Return the recorder's time of an event that the robot dates ``publish_ns``, received at ``log_ns``.

        Never later than the receipt.
        """
        set_ns = 0 if tick is None else self._set_by(publish_ns, log_ns, tick)
        return min(publish_ns + self.offset_ns - set_ns, log_ns)

    def _is_near(self, tick: int) -> bool:
        """Return True if the tick is so near to the last state's that it is a measure of time."""
        return self._tick is not None and abs(tick - self._tick) <= _TICKS_NEAR

    def _set_by(self, publish_ns: int, log_ns: int, tick: int) -> int:
        """Return by how much the clock was set since the last state, nanoseconds, as far as the ticks show."""
        if self._tick is None or not self._is_near(tick):
            return 0
        set_ns = publish_ns - self._publish_ns - (tick - self._tick) * TICK_NS
        # Either the clock was set, or the gateway made a pause, and then the receipt is as late as the clock says.
        received_ns = log_ns - self._log_ns
        paused = abs((publish_ns - self._publish_ns) - received_ns) <= NEAR_NS
        return 0 if paused or abs(set_ns) <= NEAR_NS else set_ns
