"""The one odometry: pose, way and speeds from drive and steering feedback, by the kinematic bicycle model. Pure.

The pose is that of the middle of the rear axle. Axes are those of ISO 8855 and REP 103: x forward and y left as
the robot stood at the start or at the last reset, heading from x to y. The speed is signed, forward positive.

The variances grow with the way and with the turns. A gap in the feedback does not move the pose, but the way that
may have been driven in it is added to the variances. The wheel pulses are a check: if they count another way than
the drive feedback, the difference is added too. There is no separate flag, because fusion and planning read
variances. The number of pulses in a metre is in no manual; it is learned from the first metres.
"""

from __future__ import annotations

from math import cos, isfinite, pi, radians, remainder, sin, tan, tau
from typing import Final

from schemas import messages
from schemas.messages import SEQUENCE_MAX
from schemas.settings import STANDSTILL_MPS

GAP_NS: Final = 500_000_000
"""Longest gap that is integrated: ten periods of ``state``."""

WAY_ERROR: Final = 0.02
"""Standard deviation of a way of 1 m, in metres: tyres, load and rounding. It grows with the root of the way."""

TURN_ERROR: Final = 0.05
"""Standard deviation of a turn of 1 rad, in radians: tyres slip in a bend."""

STEERING_ERROR_RAD: Final = radians(1.0)
"""Accuracy of the steering feedback, independent from metre to metre."""

ACCELERATION_MPS2: Final = 2.0
"""Unseen change of the speed between two samples."""

UNSEEN_MPS: Final = 0.1
"""Possible mean speed in a gap of a robot that stands before and after it."""

PULSE_WAY_M: Final = 0.5
"""Way by drive feedback or pulses after which the two are compared."""

LEARNED_M: Final = 2.0
"""Way after which the pulses in a metre are known."""

SLIP: Final = 0.2
"""Share of the way that wheels may slip unnoticed..."""

SLIP_M: Final = 0.1
"""...and the way of one period of the pulses at full speed, for they come later."""

_HEADING_VARIANCE_MAX_RAD2: Final = pi**2 / 3
"""Variance of an unknown heading."""

_SPEED_ERROR_MPS, _TURN_RATE_ERROR_RADPS = 0.02, 0.01
"""Errors at standstill: rounding of the feedback."""


_DIRECTIONS: Final = {messages.GearPosition.DRIVE: 1, messages.GearPosition.REVERSE: -1}


def signed_speed_mps(
    drive: messages.Drive | None, wheels: messages.WheelSpeed | None, gear: messages.Gear | None
) -> float | None:
    """The speed of the drive feedback with the direction of the wheels if they turn, else of the gear.

    None if the robot moves and neither shows the direction.
    """
    if drive is None:
        return None
    if wheels is not None and wheels.valid:
        mean_mps = (wheels.rear_left_speed_mps + wheels.rear_right_speed_mps) / 2
        if abs(mean_mps) > STANDSTILL_MPS:
            return -drive.speed_mps if mean_mps < 0 else drive.speed_mps
    if drive.speed_mps <= STANDSTILL_MPS:
        return drive.speed_mps
    direction = 0 if gear is None else _DIRECTIONS.get(gear.gear_position, 0)
    return direction * drive.speed_mps if direction else None


def yaw_rate_radps(speed_mps: float, angle_deg: float, wheelbase_m: float) -> float:
    """The yaw rate of the bicycle model, left positive."""
    return speed_mps * tan(radians(angle_deg)) / wheelbase_m


class DeadReckoning:
    """The pose since the start or the last reset.

    Attributes:
        heading_rad: from -pi to pi, left positive.
        distance_m: the way, forward and in reverse.
        last_ns: time of the newest sample with speed and angle; None before the first.
    """

    def __init__(self, wheelbase_m: float) -> None:
        self._wheelbase_m = wheelbase_m
        self.last_ns: int | None = None
        self._speed_mps = self._angle_deg = 0.0
        self._sequence = 0
        self._reported_ns = 0
        self._pulses: tuple[int, int, int] | None = None
        self._pulses_per_m = self._learned_m = self._learned_pulses = 0.0
        self.reset()

    def reset(self) -> None:
        """Set the pose to zero, and keep the learned number of pulses."""
        self.x_m = self.y_m = self.heading_rad = self.distance_m = 0.0
        self._xx = self._yy = self._xy = self._xh = self._yh = self._hh = 0.0
        self._way_m = self._counted = 0.0

    def move(self, time_ns: int, speed_mps: float | None, angle_deg: float | None) -> None:
        """Advance to a sample of signed speed and angle, None if unknown. One that is not later starts again."""
        if speed_mps is None or angle_deg is None or not isfinite(speed_mps) or not isfinite(angle_deg):
            return
        before_ns, before_mps, before_deg = self.last_ns, self._speed_mps, self._angle_deg
        self.last_ns, self._speed_mps, self._angle_deg = time_ns, speed_mps, angle_deg
        if before_ns is None:
            return
        span_ns = time_ns - before_ns
        if 0 < span_ns <= GAP_NS:
            mean_mps, span_s = (before_mps + speed_mps) / 2, span_ns / 1e9
            if before_mps or speed_mps:
                self._go(mean_mps * span_s, (before_deg + angle_deg) / 2, ACCELERATION_MPS2 * span_s**2 / 4)
            return
        # If the clock was set back, the time between is unknown.
        fastest_mps = max(abs(before_mps), abs(speed_mps), UNSEEN_MPS)
        self._doubt(fastest_mps * max(span_ns, GAP_NS) / 1e9)
        self._pulses = None

    def count(self, time_ns: int, left: int, right: int) -> None:
        """Check the way by the rear wheels' encoder counts, signed 16-bit numbers that wrap."""
        before, self._pulses = self._pulses, (time_ns, left, right)
        if before is None or not 0 < time_ns - before[0] <= GAP_NS:
            self._way_m = self._counted = 0.0
            return
        self._counted += (wrapped(left - before[1]) + wrapped(right - before[2])) / 2
        counted_m = self._counted / self._pulses_per_m if self._pulses_per_m else 0.0
        if max(abs(self._way_m), abs(counted_m)) < PULSE_WAY_M:
            return
        way_m, counted, self._way_m, self._counted = self._way_m, self._counted, 0.0, 0.0
        if not self._pulses_per_m:
            if counted * way_m > 0:
                self._learn(abs(way_m), abs(counted))
                return
            counted_m = 0.0
        if abs(counted_m - way_m) > SLIP * abs(way_m) + SLIP_M:
            self._doubt(abs(counted_m - way_m))

    def report(self) -> messages.Odometry | None:
        """The odometry of the newest sample; None if already reported."""
        if self.last_ns is None or self.last_ns == self._reported_ns:
            return None
        self._reported_ns = self.last_ns
        sequence, self._sequence = self._sequence, (self._sequence + 1) & SEQUENCE_MAX
        turn_radps = yaw_rate_radps(self._speed_mps, self._angle_deg, self._wheelbase_m)
        speed_error_mps = _SPEED_ERROR_MPS + WAY_ERROR * abs(self._speed_mps)
        turn_error_radps = (
            _TURN_RATE_ERROR_RADPS
            + TURN_ERROR * abs(turn_radps)
            + abs(self._speed_mps) * STEERING_ERROR_RAD / self._wheelbase_m
        )
        return messages.Odometry(
            time_ns=self.last_ns,
            sequence=sequence,
            x_m=self.x_m,
            y_m=self.y_m,
            heading_rad=self.heading_rad,
            speed_mps=self._speed_mps,
            yaw_rate_radps=turn_radps + 0.0,  # No -0.0.
            distance_m=self.distance_m,
            x_variance_m2=self._xx,
            y_variance_m2=self._yy,
            heading_variance_rad2=self._hh,
            speed_variance_m2ps2=speed_error_mps**2,
            yaw_rate_variance_rad2ps2=turn_error_radps**2,
        )

    def _go(self, way_m: float, angle_deg: float, unsure_m: float) -> None:
        """Move on an arc, with half of the turn before the way and half after it."""
        bend = tan(radians(angle_deg))
        turn_rad = way_m * bend / self._wheelbase_m
        mean_rad = self.heading_rad + turn_rad / 2
        ahead, aside = cos(mean_rad), sin(mean_rad)
        self.x_m += way_m * ahead
        self.y_m += way_m * aside
        self.heading_rad = remainder(self.heading_rad + turn_rad, tau)
        self.distance_m += abs(way_m)
        self._way_m += way_m
        # Propagate the covariance: an error of the heading becomes one of the place.
        x_by_heading, y_by_heading = -way_m * aside, way_m * ahead
        self._xx += x_by_heading * (2 * self._xh + x_by_heading * self._hh)
        self._yy += y_by_heading * (2 * self._yh + y_by_heading * self._hh)
        self._xy += x_by_heading * self._yh + y_by_heading * (self._xh + x_by_heading * self._hh)
        self._xh += x_by_heading * self._hh
        self._yh += y_by_heading * self._hh
        way_error_m2 = WAY_ERROR**2 * abs(way_m) + unsure_m**2
        self._xx += way_error_m2 * ahead**2
        self._yy += way_error_m2 * aside**2
        self._xy += way_error_m2 * ahead * aside
        bend_error_1pm = STEERING_ERROR_RAD * (1 + bend**2) / self._wheelbase_m
        turn_error_rad2 = bend_error_1pm**2 * abs(way_m) + TURN_ERROR**2 * abs(turn_rad)
        self._hh = min(self._hh + turn_error_rad2, _HEADING_VARIANCE_MAX_RAD2)

    def _doubt(self, way_m: float) -> None:
        """Add to the variances an unknown way of at most this length."""
        self._xx += way_m**2
        self._yy += way_m**2
        self._hh = min(self._hh + (way_m / self._wheelbase_m) ** 2, _HEADING_VARIANCE_MAX_RAD2)

    def _learn(self, way_m: float, counted: float) -> None:
        self._learned_m += way_m
        self._learned_pulses += counted
        if self._learned_m >= LEARNED_M:
            self._pulses_per_m = self._learned_pulses / self._learned_m


def wrapped(pulses: int) -> int:
    """A difference of encoder counts, which are signed 16-bit numbers that wrap."""
    return (pulses + 0x8000) % 0x1_0000 - 0x8000
