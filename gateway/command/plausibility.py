"""Plausibility of the motion: speeds against the command and each other, direction, steering, the limit.

A chassis whose firmware has the other scale moves 40 times as fast as commanded, or as slow; one on a slope or
pushed by somebody moves without a command. This notices both, and more.
"""

from __future__ import annotations

from typing import Final

from gateway.command.actuation import Actuation
from gateway.command.chassis_state import ChassisState
from schemas.cruiser import SCALE_RATIO
from schemas.reasons import Reason
from schemas.settings import (
    CREEPING_NS,
    DRIVE_LAG_S,
    FROZEN_BODY_M,
    IMPLAUSIBLE_MPS,
    IMPLAUSIBLE_NS,
    IMPLAUSIBLE_RATIO,
    OVERSPEED_MPS,
    OVERSPEED_NS,
    PULSES_REST_S,
    REFERENCE_DECELERATION_MPS2,
    ROLLING_MPS,
    ROLLING_NS,
    STANDSTILL_MPS,
    STEERING_DEVIATION_DEG,
    STEERING_DEVIATION_NS,
    STEERING_FOLLOWS_DEGPS,
    STEERING_LAG_S,
)

_HAIR: Final = 1e-9
"""So that a speed that is just on a bound is not below it by rounding."""


def exceeds(larger_mps: float, smaller_mps: float) -> bool:
    """The one is over the other by more than the difference and the factor that are allowed."""
    return larger_mps > smaller_mps + IMPLAUSIBLE_MPS and larger_mps > smaller_mps * IMPLAUSIBLE_RATIO


def fits(one_mps: float, other_mps: float) -> bool:
    """Neither is over the other."""
    return not exceeds(one_mps, other_mps) and not exceeds(other_mps, one_mps)


def fitting_scale(drive_mps: float, wheel_mps: float) -> str:
    """Return the scale of the drive frames in which their speed fits that of the wheels, in words; or nothing."""
    if fits(drive_mps, wheel_mps):
        return ""
    # A coarse bit that is taken for a fine one is worth a fortieth; and the other way round.
    for factor, words in ((SCALE_RATIO, "the coarse scale"), (1 / SCALE_RATIO, "the fine scale")):
        if fits(drive_mps * factor, wheel_mps):
            return f"; {words} of the drive frames would fit"
    return ""


class Envelope:
    """The speeds and angles that the robot may still have by its commands: a chassis lags behind.

    Attributes:
        forward_mps, backward_mps: the highest speed each way.
        forward_rest_s, backward_rest_s: for how long no speed that way was commanded, and that has been a robot's
            at rest; ``PULSES_REST_S`` at most.
        left_deg, right_deg: the furthest angles, left positive.
    """

    def __init__(self, speed_mps: float, angle_deg: float) -> None:
        self.forward_mps = max(0.0, speed_mps)
        self.backward_mps = max(0.0, -speed_mps)
        self.forward_rest_s = self.backward_rest_s = PULSES_REST_S
        self.left_deg = self.right_deg = angle_deg

    def follow(self, told: Actuation, elapsed_s: float) -> None:
        """Advance the expected motion by the time since the last call, under this command."""
        forward_mps, backward_mps = max(told.signed_speed_mps, 0.0), max(-told.signed_speed_mps, 0.0)
        self.forward_mps = _fallen(self.forward_mps, forward_mps, elapsed_s)
        self.backward_mps = _fallen(self.backward_mps, backward_mps, elapsed_s)
        self.forward_rest_s = _rested(self.forward_rest_s, forward_mps, self.forward_mps, elapsed_s)
        self.backward_rest_s = _rested(self.backward_rest_s, backward_mps, self.backward_mps, elapsed_s)
        self.left_deg = told.angle_deg + _turned(max(0.0, self.left_deg - told.angle_deg), elapsed_s)
        self.right_deg = told.angle_deg - _turned(max(0.0, told.angle_deg - self.right_deg), elapsed_s)


def _fallen(before_mps: float, told_mps: float, elapsed_s: float) -> float:
    """Return the speed that a slow chassis may still have, on its way down to the commanded one."""
    lag_mps = (before_mps - told_mps) * min(1.0, elapsed_s / DRIVE_LAG_S)
    return max(told_mps, before_mps - min(lag_mps, REFERENCE_DECELERATION_MPS2 * elapsed_s))


def _turned(off_deg: float, elapsed_s: float) -> float:
    """Return how far off slow wheels may still be, on their way to the commanded angle."""
    lag_deg = off_deg * min(1.0, elapsed_s / STEERING_LAG_S)
    return off_deg - min(lag_deg, STEERING_FOLLOWS_DEGPS * elapsed_s)


def _rested(before_s: float, told_mps: float, speed_mps: float, elapsed_s: float) -> float:
    """Return for how long it has been at rest, if it was for so long before. Told to creep, it never is."""
    return 0.0 if told_mps or speed_mps >= STANDSTILL_MPS else min(before_s + elapsed_s, PULSES_REST_S)


class Plausibility:
    """Watches a robot that is being commanded.

    Attributes:
        details: the contradictions, in words, by reason.
    """

    def __init__(self) -> None:
        # How far it was driven since the mileage has changed outlasts an engagement.
        self._mileage_km: float | None = None
        self._driven_m = 0.0
        self.forget()

    def forget(self, speed_mps: float = 0.0, angle_deg: float = 0.0) -> None:
        """Begin anew, with a robot that already has this signed speed and this angle."""
        self.details: dict[Reason, str] = {}
        self._envelope = Envelope(speed_mps, angle_deg)
        self._since_ns: dict[str, int] = {}
        self._checked_ns: int | None = None

    def check(self, chassis: ChassisState, told: Actuation, limit_mps: float, now_ns: int) -> list[Reason]:
        """Return the reasons why the motion has been implausible for too long.

        Args:
            chassis: the chassis now.
            told: its last command.
            limit_mps: the speed limit in force.
            now_ns: monotonic.
        """
        elapsed_s = 0.0 if self._checked_ns is None else (now_ns - self._checked_ns) / 1e9
        self._checked_ns = now_ns
        self._envelope.follow(told, elapsed_s)
        self._count_way(chassis, elapsed_s)
        frozen = f"for {self._driven_m:.1f} m" if self._driven_m > FROZEN_BODY_M else ""
        found = (
            ("speeds", Reason.IMPLAUSIBLE_SPEED, IMPLAUSIBLE_NS, self._misfit(chassis)),
            ("rolls", Reason.ROLLING, ROLLING_NS, self._rolling(chassis, told, ROLLING_MPS)),
            ("creeps", Reason.ROLLING, CREEPING_NS, self._rolling(chassis, told, STANDSTILL_MPS)),
            ("overspeed", Reason.OVERSPEED, OVERSPEED_NS, self._overspeed(chassis, limit_mps)),
            ("steering", Reason.STEERING, STEERING_DEVIATION_NS, self._deviation(chassis)),
            ("frozen", Reason.FEEDBACK_FROZEN, 0, frozen),
        )
        lasting = [
            reason
            for check, reason, least_ns, detail in found
            if self._lasts(check, reason, detail, now_ns) >= least_ns
        ]
        return list(dict.fromkeys(lasting))

    def _lasts(self, check: str, reason: Reason, detail: str, now_ns: int) -> int:
        """For how long, in nanoseconds; -1 if it does not hold."""
        if not detail:
            self._since_ns.pop(check, None)
            return -1
        self.details[reason] = detail
        return now_ns - self._since_ns.setdefault(check, now_ns)

    def _misfit(self, chassis: ChassisState) -> str:
        wheel_mps, drive_mps = chassis.wheel_speed_mps, chassis.speed_mps
        if wheel_mps is None or drive_mps is None:
            return ""  # Missing feedback is a cause of its own.
        envelope = self._envelope
        reference_mps = envelope.forward_mps if wheel_mps >= 0 else envelope.backward_mps
        way = "forward" if wheel_mps >= 0 else "backward"
        wheel_mps = abs(wheel_mps)
        fit = fitting_scale(drive_mps, wheel_mps) or fitting_scale(reference_mps, wheel_mps)
        if exceeds(wheel_mps, reference_mps):
            return f"the wheels turn {way} at {wheel_mps:.2f} m/s, commanded is {reference_mps:.2f} m/s{fit}"
        if not fits(wheel_mps, drive_mps):
            return f"the wheels turn at {wheel_mps:.2f} m/s, the drive feedback says {drive_mps:.2f} m/s{fit}"
        return ""

    def _rolling(self, chassis: ChassisState, told: Actuation, bound_mps: float) -> str:
        """Moves a way that is not commanded, faster than the bound beyond what is left of a ramp."""
        told_mps, wheels_mps = told.signed_speed_mps, chassis.wheel_speed_mps or 0.0
        envelope = self._envelope
        for sign, way, left_mps, rest_s in (
            (1, "forward", envelope.forward_mps, envelope.forward_rest_s),
            (-1, "backward", envelope.backward_mps, envelope.backward_rest_s),
        ):
            if told_mps * sign > 0:
                continue
            if wheels_mps * sign > left_mps + bound_mps:
                return f"{way} at {abs(wheels_mps):.2f} m/s by the wheels"
            # Before that, half of them may be of the ramp up and the other half of the ramp down, and seem steady.
            if chassis.pulses == sign and rest_s >= PULSES_REST_S:
                return f"{way} by the wheel pulses"
        fastest_mps = chassis.fastest_mps or 0.0
        if not told_mps and fastest_mps > max(envelope.forward_mps, envelope.backward_mps) + bound_mps:
            return f"at {fastest_mps:.2f} m/s"
        return ""

    def _overspeed(self, chassis: ChassisState, limit_mps: float) -> str:
        """Over the limit; one that has just been lowered has to be reached first."""
        speeds = (chassis.speed_mps or 0.0, abs(chassis.wheel_speed_mps or 0.0))
        bound_mps = max(limit_mps, self._envelope.forward_mps, self._envelope.backward_mps)
        if max(speeds) < bound_mps + OVERSPEED_MPS - _HAIR:
            return ""
        return f"{max(speeds):.2f} m/s, the limit is {limit_mps:.2f} m/s"

    def _deviation(self, chassis: ChassisState) -> str:
        angle_deg = chassis.angle_deg
        if angle_deg is None:
            return ""
        envelope = self._envelope
        off_deg = max(angle_deg - envelope.left_deg, envelope.right_deg - angle_deg)
        return f"off by {off_deg:.1f} deg, at {angle_deg:.1f} deg" if off_deg > STEERING_DEVIATION_DEG else ""

    def _count_way(self, chassis: ChassisState, elapsed_s: float) -> None:
        """Count the way that the robot has driven, at the least, since the mileage has changed."""
        if chassis.total_mileage_km != self._mileage_km or chassis.total_mileage_km is None:
            self._mileage_km = chassis.total_mileage_km
            self._driven_m = 0.0
        self._driven_m += chassis.slowest_mps * elapsed_s
