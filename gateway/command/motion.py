"""From what is asked to what the chassis is told: every limit, and the way through standstill to reverse."""

from __future__ import annotations

from math import copysign
from typing import Final

import msgspec

from gateway.command.actuation import Actuation
from gateway.command.limits import Limits
from schemas.decisions import Bound
from schemas.messages import GearPosition

_SIGN: Final = {GearPosition.DRIVE: 1.0, GearPosition.REVERSE: -1.0, GearPosition.NEUTRAL: 0.0}
_GEAR: Final = {1.0: GearPosition.DRIVE, -1.0: GearPosition.REVERSE, 0.0: GearPosition.NEUTRAL}


class Target(msgspec.Struct, frozen=True):
    """What a drive command asks for. Forward and left are positive."""

    speed_mps: float = 0.0
    angle_deg: float = 0.0


class Surroundings(msgspec.Struct, frozen=True):
    """What besides the limits bounds the motion in a tick.

    Attributes:
        stands: the measured speed is that of a standing robot.
        gear: the gear feedback.
        parked: the parking brake is asked for.
        forward, backward: whether motion in this direction is allowed; a bumper that is still pressed forbids it.
    """

    stands: bool
    gear: GearPosition
    parked: bool
    forward: bool = True
    backward: bool = True


class Motion:
    """What the chassis is being told, tick by tick.

    Attributes:
        speed_mps: signed.
        angle_deg: left is positive.
        gear: neutral while nothing is asked and the robot stands.
        bounds: the limits that changed what was asked in the last tick.
    """

    def __init__(self, pedal_percent: float, angle_deg: float = 0.0) -> None:
        self.speed_mps = 0.0
        self.angle_deg = angle_deg
        self.gear = GearPosition.NEUTRAL
        self.bounds: list[Bound] = []
        self._pedal_percent = pedal_percent

    def __copy__(self) -> Motion:
        # Taken in every tick; copy's own way costs ten times as much.
        other = object.__new__(Motion)
        other.__dict__.update(self.__dict__)
        return other

    def tick(self, target: Target, limits: Limits, surroundings: Surroundings, dt_s: float) -> Actuation:
        """What the chassis is told in this tick, on the way to the target."""
        self.bounds = []
        angle_deg = self._within(target.angle_deg, limits.steering_deg, Bound.STEERING)
        speed_mps = self._wanted_speed(target.speed_mps, angle_deg, limits, surroundings)
        self._step_speed(self._through_standstill(speed_mps, surroundings), limits, dt_s)
        self._step_angle(angle_deg, limits, dt_s)
        holds = self.speed_mps == 0 and self.gear is GearPosition.NEUTRAL
        return Actuation(
            enabled=True,
            gear=self.gear,
            speed_mps=abs(self.speed_mps),
            angle_deg=self.angle_deg,
            pedal_percent=self._pedal_percent if holds else 0.0,
            parking=surroundings.parked,
        )

    def _wanted_speed(
        self, speed_mps: float, angle_deg: float, limits: Limits, surroundings: Surroundings
    ) -> float:
        """The target speed within the limits that do not depend on the way there."""
        if (speed_mps > 0 and not surroundings.forward) or (speed_mps < 0 and not surroundings.backward):
            self._bound(Bound.BUMPER)
            return 0.0
        if surroundings.parked and speed_mps:
            self._bound(Bound.PARKING)
            return 0.0
        speed_mps = self._within(speed_mps, limits.speed_mps, Bound.SPEED)
        # The wheels may still be turned further than they shall be.
        furthest_deg = max(abs(angle_deg), abs(self.angle_deg))
        return self._within(speed_mps, limits.speed_at(furthest_deg), Bound.LATERAL_ACCELERATION)

    def _through_standstill(self, speed_mps: float, surroundings: Surroundings) -> float:
        """The speed to go to now: zero until the gear of the wanted direction is in, and confirmed."""
        wanted = copysign(1.0, speed_mps) if speed_mps else 0.0
        engaged = _SIGN[self.gear]
        if wanted == engaged:
            if surroundings.gear is self.gear or not speed_mps:
                return speed_mps
            self._bound(Bound.GEAR)
            return 0.0
        if wanted and engaged:
            self._bound(Bound.REVERSAL)
        elif wanted:
            self._bound(Bound.GEAR)
        if self.speed_mps == 0 and surroundings.stands:
            if engaged:
                self.gear = GearPosition.NEUTRAL
            elif surroundings.gear is GearPosition.NEUTRAL:
                self.gear = _GEAR[wanted]
        return 0.0

    def _step_speed(self, speed_mps: float, limits: Limits, dt_s: float) -> None:
        before_mps = self.speed_mps
        if abs(speed_mps) > abs(before_mps):
            bound, most_mps = Bound.ACCELERATION, limits.acceleration_mps2 * dt_s
        else:
            bound, most_mps = Bound.DECELERATION, limits.deceleration_mps2 * dt_s
        change_mps = speed_mps - before_mps
        if abs(change_mps) > most_mps:
            self._bound(bound)
            self.speed_mps = before_mps + copysign(most_mps, change_mps)
        else:
            self.speed_mps = speed_mps

    def _step_angle(self, angle_deg: float, limits: Limits, dt_s: float) -> None:
        most_deg = limits.steering_rate_degps * dt_s
        change_deg = angle_deg - self.angle_deg
        if abs(change_deg) > most_deg:
            self._bound(Bound.STEERING_RATE)
            angle_deg = self.angle_deg + copysign(most_deg, change_deg)
        # While the speed is still on its way down to what the angle allows, the steering waits for it.
        self.angle_deg = self._within(angle_deg, limits.angle_at(self.speed_mps), Bound.LATERAL_ACCELERATION)

    def _within(self, value: float, magnitude: float, bound: Bound) -> float:
        if abs(value) <= magnitude:
            return value
        self._bound(bound)
        return copysign(magnitude, value)

    def _bound(self, bound: Bound) -> None:
        if bound not in self.bounds:
            self.bounds.append(bound)
