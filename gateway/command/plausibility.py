"""Do the speeds fit each other? Wheel speeds against the command, and against the drive feedback.

A chassis whose firmware has the other scale moves 40 times as fast as it is told, or as slow; this notices it.
"""

from __future__ import annotations

from typing import Final

from schemas.settings import (
    IMPLAUSIBLE_MPS,
    IMPLAUSIBLE_NS,
    IMPLAUSIBLE_RATIO,
    REFERENCE_DECELERATION_MPS2,
)

SCALE_RATIO: Final = 40.0
"""Between the coarse scale, 0.04 m/s a bit, and the fine one, 0.001 m/s a bit."""


def exceeds(larger_mps: float, smaller_mps: float) -> bool:
    """The one is over the other by more than the difference and the factor that are allowed."""
    return larger_mps > smaller_mps + IMPLAUSIBLE_MPS and larger_mps > smaller_mps * IMPLAUSIBLE_RATIO


def fits(one_mps: float, other_mps: float) -> bool:
    """Neither is over the other."""
    return not exceeds(one_mps, other_mps) and not exceeds(other_mps, one_mps)


def fitting_scale(drive_mps: float, wheel_mps: float) -> str:
    """Which scale of the drive frames would make their speed fit that of the wheels, in words; or empty."""
    if fits(drive_mps, wheel_mps):
        return ""
    # A coarse bit that is taken for a fine one is worth a fortieth; and the other way round.
    for factor, words in ((SCALE_RATIO, "the coarse scale"), (1 / SCALE_RATIO, "the fine scale")):
        if fits(drive_mps * factor, wheel_mps):
            return f"; {words} of the drive frames would fit"
    return ""


class Plausibility:
    """Watches the speeds while the robot is commanded.

    Attributes:
        detail: what does not fit, in words; empty while all does.
    """

    def __init__(self) -> None:
        self.detail = ""
        self.forget()

    def forget(self, speed_mps: float = 0.0) -> None:
        """Begin anew, with a robot that already has this signed speed."""
        self._forward_mps = max(0.0, speed_mps)
        self._backward_mps = max(0.0, -speed_mps)
        self._since_ns: int | None = None
        self._observed_ns: int | None = None

    def observe(self, wheel_mps: float | None, drive_mps: float | None, commanded_mps: float, now_ns: int) -> bool:
        """Whether the speeds have not fitted for too long.

        Args:
            wheel_mps: mean of the wheels, signed; None if not known.
            drive_mps: the drive feedback, a magnitude; None if not known.
            commanded_mps: what the chassis is told, signed: wheels that turn the other way do not fit either.
            now_ns: monotonic.
        """
        before_ns = self._observed_ns if self._observed_ns is not None else now_ns
        fallen_mps = REFERENCE_DECELERATION_MPS2 * (now_ns - before_ns) / 1e9
        self._forward_mps = max(commanded_mps, self._forward_mps - fallen_mps, 0.0)
        self._backward_mps = max(-commanded_mps, self._backward_mps - fallen_mps, 0.0)
        self._observed_ns = now_ns
        what = self._misfit(wheel_mps, drive_mps)
        if not what:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < IMPLAUSIBLE_NS:
            return False
        self.detail = what
        return True

    def _misfit(self, wheel_mps: float | None, drive_mps: float | None) -> str:
        if wheel_mps is None or drive_mps is None:
            return ""  # Missing feedback is a cause of its own.
        reference_mps = self._forward_mps if wheel_mps >= 0 else self._backward_mps
        way = "forward" if wheel_mps >= 0 else "backward"
        wheel_mps = abs(wheel_mps)
        fit = fitting_scale(drive_mps, wheel_mps) or fitting_scale(reference_mps, wheel_mps)
        if exceeds(wheel_mps, reference_mps):
            return f"the wheels turn {way} at {wheel_mps:.2f} m/s, commanded is {reference_mps:.2f} m/s{fit}"
        if not fits(wheel_mps, drive_mps):
            return f"the wheels turn at {wheel_mps:.2f} m/s, the drive feedback says {drive_mps:.2f} m/s{fit}"
        return ""
