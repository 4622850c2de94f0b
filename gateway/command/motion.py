"""The limits of motion, the profile that applies them, and the setpoint. Pure."""

from __future__ import annotations

from math import atan, copysign, degrees, inf, radians, sqrt, tan
from typing import Final, Self

import msgspec

from gateway.chassis.port import Actuation
from schemas.decisions import Bound
from schemas.messages import GearPosition, ParkingStatus
from schemas.requests import Drive
from schemas.settings import AUTO_HOLD_NS, FOLLOWING_MPS, FOLLOWING_S, SHIFT_TICKS, TICK_NS, CommandSettings


class MotionLimits(msgspec.Struct, frozen=True):
    """Limits of motion. At run time they can only be lowered."""

    speed_mps: float
    acceleration_mps2: float
    deceleration_mps2: float
    emergency_deceleration_mps2: float
    steering_deg: float
    steering_rate_degps: float
    lateral_acceleration_mps2: float

    @classmethod
    def of(cls, settings: CommandSettings) -> Self:
        return cls(
            speed_mps=settings.speed_limit_mps,
            acceleration_mps2=settings.acceleration_mps2,
            deceleration_mps2=settings.deceleration_mps2,
            emergency_deceleration_mps2=max(settings.emergency_deceleration_mps2, settings.deceleration_mps2),
            steering_deg=settings.steering_limit_deg,
            steering_rate_degps=settings.steering_rate_degps,
            lateral_acceleration_mps2=settings.lateral_acceleration_mps2,
        )

    def lowered(self, speed_mps: float | None) -> MotionLimits:
        """The limits with this speed limit, if it is lower."""
        if speed_mps is None or speed_mps >= self.speed_mps:
            return self
        return msgspec.structs.replace(self, speed_mps=max(0.0, speed_mps))

    def speed_at(self, angle_deg: float, wheelbase_m: float) -> float:
        """The highest speed, m/s, at this steering angle: v^2 tan(angle) / wheelbase within the lateral limit."""
        bend = tan(radians(abs(angle_deg)))
        if bend == 0:
            return self.speed_mps
        return min(self.speed_mps, sqrt(self.lateral_acceleration_mps2 * wheelbase_m / bend))

    def angle_at(self, speed_mps: float, wheelbase_m: float) -> float:
        """The largest steering angle, deg, at this speed, by the same rule."""
        square_m2ps2 = speed_mps * speed_mps
        if square_m2ps2 == 0:  # also if the speed is too small to be squared
            return self.steering_deg
        bend = self.lateral_acceleration_mps2 * wheelbase_m / square_m2ps2
        return min(self.steering_deg, degrees(atan(bend)))


def steering_angle_deg(drive: Drive, wheelbase_m: float) -> float | str:
    """The steering angle that a drive command requests, before any limit, or why the command is wrong.

    The bicycle model: curvature = tan(angle) / wheelbase, yaw rate = speed * curvature (ISO 8855: left positive).
    """
    given = [name for name in ("angle_deg", "curvature_1pm", "yaw_rate_radps") if getattr(drive, name) is not None]
    if len(given) != 1:
        return "exactly one of angle_deg, curvature_1pm and yaw_rate_radps is wanted"
    if drive.angle_deg is not None:
        return drive.angle_deg
    if drive.curvature_1pm is not None:
        return degrees(atan(drive.curvature_1pm * wheelbase_m))
    yaw_rate_radps = drive.yaw_rate_radps or 0.0
    if yaw_rate_radps == 0:
        return 0.0
    if drive.speed_mps == 0:
        return "the robot cannot turn on the spot: a yaw rate needs a speed"
    curvature_1pm = yaw_rate_radps / drive.speed_mps
    return degrees(atan(curvature_1pm * wheelbase_m)) if abs(curvature_1pm) < inf else "the curve is too tight"


AUTO_HOLD_TICKS: Final = AUTO_HOLD_NS // TICK_NS


class Target(msgspec.Struct, frozen=True):
    """Requested speed and angle. Forward and left are positive."""

    speed_mps: float = 0.0
    angle_deg: float = 0.0


class MotionConstraints(msgspec.Struct, frozen=True):
    """Bounds of the motion in a tick besides the limits.

    Attributes:
        gear, brake: feedback of gear and parking brake.
        parked: the parking brake must be applied, whatever is requested.
        speed_mps, angle_deg: as measured; the speed is the greatest one, a magnitude. Zero if unknown.
        forward, backward: motion in this direction is allowed; a pressed bumper forbids it.
    """

    wheelbase_m: float
    stands: bool
    gear: GearPosition
    brake: ParkingStatus
    parked: bool
    speed_mps: float = 0.0
    angle_deg: float = 0.0
    forward: bool = True
    backward: bool = True


class MotionProfile:
    """The commands to the chassis, tick by tick, towards a target.

    The robot never stands in neutral unbraked: in gear the motor holds it, and the gear is changed behind the
    applied parking brake.

    Attributes:
        speed_mps: signed.
        angle_deg: left is positive.
        gear: neutral until the first gear is wanted.
        held_ticks: ticks since the parking brake read applied on a robot that the motor held, 1 until it does;
            0 if the motor did not hold it.
        bounds: the limits that changed the request in the last tick.
    """

    def __init__(self, angle_deg: float = 0.0, gear: GearPosition = GearPosition.NEUTRAL) -> None:
        self.speed_mps = 0.0
        self.angle_deg = angle_deg
        self.gear = gear
        self.parking = True
        self.bounds: list[Bound] = []
        self.held_ticks = 0
        self._stood_ticks = 0
        self._gear_ticks = SHIFT_TICKS

    def __copy__(self) -> MotionProfile:
        # Copied in every tick; the default way takes ten times as long.
        other = object.__new__(MotionProfile)
        other.__dict__.update(self.__dict__)
        return other

    def tick(
        self,
        target: Target,
        limits: MotionLimits,
        constraints: MotionConstraints,
        dt_s: float,
        elapsed_s: float | None = None,
    ) -> Actuation:
        """Return the command of this tick. The speed falls by the elapsed time, and rises by one tick."""
        self.bounds = []
        angle_deg = self._within(target.angle_deg, limits.steering_deg, Bound.STEERING)
        speed_mps = self._wanted_speed(target.speed_mps, angle_deg, limits, constraints)
        self._stood_ticks = self._stood_ticks + 1 if constraints.stands and not self.speed_mps else 0
        self._gear_ticks += 1
        is_awaited = self.parking and constraints.brake is not ParkingStatus.APPLIED
        self.held_ticks += self.held_ticks > 0 and not is_awaited
        speed_mps = self._drive_off(speed_mps, constraints) if speed_mps else self._stand(constraints)
        self._step_speed(speed_mps, limits, constraints.speed_mps, dt_s, dt_s if elapsed_s is None else elapsed_s)
        # The steering waits until the speed is as low as the angle requires.
        fastest_mps = max(abs(self.speed_mps), constraints.speed_mps)
        angle_deg = self._within(
            angle_deg, limits.angle_at(fastest_mps, constraints.wheelbase_m), Bound.LATERAL_ACCELERATION
        )
        self._step_angle(angle_deg, limits, dt_s)
        return Actuation(
            enabled=True,
            gear=self.gear,
            speed_mps=abs(self.speed_mps),
            angle_deg=self.angle_deg,
            parking=self.parking,
        )

    def _wanted_speed(
        self, speed_mps: float, angle_deg: float, limits: MotionLimits, constraints: MotionConstraints
    ) -> float:
        """The target speed within the limits that do not depend on the ramp."""
        if (speed_mps > 0 and not constraints.forward) or (speed_mps < 0 and not constraints.backward):
            self._bound(Bound.BUMPER)
            return 0.0
        if constraints.parked and speed_mps:
            self._bound(Bound.PARKING)
            return 0.0
        speed_mps = self._within(speed_mps, limits.speed_mps, Bound.SPEED)
        # The wheels may still be turned further than requested.
        furthest_deg = max(abs(angle_deg), abs(self.angle_deg), abs(constraints.angle_deg))
        return self._within(
            speed_mps, limits.speed_at(furthest_deg, constraints.wheelbase_m), Bound.LATERAL_ACCELERATION
        )

    def _stand(self, constraints: MotionConstraints) -> float:
        """Go to zero speed in gear; the parking brake follows if requested, or after a time at standstill."""
        if not self.parking and (constraints.parked or self._stood_ticks > AUTO_HOLD_TICKS):
            # The next step waits until this brake is seen to hold.
            self.parking, self._gear_ticks, self.held_ticks = True, 0, int(constraints.stands)
        if self.parking:
            self.speed_mps = 0.0
        return 0.0

    def _drive_off(self, speed_mps: float, constraints: MotionConstraints) -> float:
        """The speed to go to now: zero until the gear is engaged and the brake is released."""
        wanted = GearPosition.DRIVE if speed_mps > 0 else GearPosition.REVERSE
        if self.gear is not wanted:
            self._bound(Bound.GEAR if self.gear is GearPosition.NEUTRAL else Bound.REVERSAL)
            self._shift(wanted, constraints)
            return 0.0
        if self.parking:
            self._bound(Bound.PARKING)
            self.parking = self._gear_ticks < SHIFT_TICKS
            return 0.0
        if constraints.stands:
            # The brake held the robot until its release.
            self.held_ticks = 0
        if constraints.brake is not ParkingStatus.RELEASED:
            self._bound(Bound.PARKING)
            return 0.0
        if constraints.gear is not self.gear:
            self._bound(Bound.GEAR)
            return 0.0
        return speed_mps

    def _shift(self, wanted: GearPosition, constraints: MotionConstraints) -> None:
        """One step of a gear change: standstill, parking brake, neutral, gear."""
        if not self.parking:
            self.parking = self.speed_mps == 0 and constraints.stands
            self._gear_ticks, self.held_ticks = 0, int(self.parking)
        elif constraints.brake is not ParkingStatus.APPLIED:
            # A slow brake must be seen to hold, too.
            self._gear_ticks = 0
        elif constraints.stands and self._gear_ticks >= SHIFT_TICKS:
            self.gear = wanted if self.gear is GearPosition.NEUTRAL else GearPosition.NEUTRAL
            self._gear_ticks = 0

    def _step_speed(
        self, speed_mps: float, limits: MotionLimits, seen_mps: float, dt_s: float, elapsed_s: float
    ) -> None:
        before_mps = self.speed_mps
        if abs(speed_mps) > abs(before_mps):
            bound, most_mps = Bound.ACCELERATION, limits.acceleration_mps2 * dt_s
            # A blocked robot must not leave at a high speed once it comes free.
            ahead_mps = max(FOLLOWING_MPS, limits.acceleration_mps2 * FOLLOWING_S)
            room_mps = max(0.0, seen_mps + ahead_mps - abs(before_mps))
            if room_mps < most_mps:
                bound, most_mps = Bound.FOLLOWING, room_mps
        else:
            bound, most_mps = Bound.DECELERATION, limits.deceleration_mps2 * elapsed_s
        change_mps = speed_mps - before_mps
        if abs(change_mps) > most_mps:
            self._bound(bound)
            self.speed_mps = before_mps + copysign(most_mps, change_mps)
        else:
            self.speed_mps = speed_mps

    def _step_angle(self, angle_deg: float, limits: MotionLimits, dt_s: float) -> None:
        most_deg = limits.steering_rate_degps * dt_s
        change_deg = angle_deg - self.angle_deg
        if abs(change_deg) > most_deg:
            self._bound(Bound.STEERING_RATE)
            angle_deg = self.angle_deg + copysign(most_deg, change_deg)
        self.angle_deg = angle_deg

    def _within(self, value: float, magnitude: float, bound: Bound) -> float:
        if abs(value) <= magnitude:
            return value
        self._bound(bound)
        return copysign(magnitude, value)

    def _bound(self, bound: Bound) -> None:
        if bound not in self.bounds:
            self.bounds.append(bound)


class Setpoint:
    """The target of the motion, and its limits.

    Attributes:
        target: of the last accepted drive command.
        parked: the parking brake stays applied until ``unpark``, whatever speed is requested.
        configured_limits: the highest limits allowed.
    """

    def __init__(self, settings: CommandSettings) -> None:
        self.configured_limits = MotionLimits.of(settings)
        self.reset(self.configured_limits)

    def reset(self, limits: MotionLimits) -> None:
        """Stand, parked, under these limits."""
        self.limits = limits
        self.target = Target()
        self.parked = True
