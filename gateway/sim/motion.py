"""Motion of the chassis: a bicycle model on a slope, with a lagging drive, brakes and a steering motor. Pure.

Axes are those of ISO 8855. The pose is that of the middle of the rear axle.
"""

from __future__ import annotations

import math

import msgspec

from gateway.sim.parameters import (
    ACCELERATION_MPS2,
    BRAKING_DECELERATION_MPS2,
    DECELERATION_MPS2,
    NOMINAL,
    PARKING_DECELERATION_MPS2,
    PULSES_PER_TURN,
    ROLLING_DECELERATION_MPS2,
    SHIFT_SPEED_MPS,
    SPEED_LAG_S,
    SPEED_RESOLUTION_MPS,
    START_MILEAGE_M,
    STEERING_LIMIT_DEG,
    STEERING_RATE_DEGPS,
    TOP_SPEED_MPS,
    TRACK_M,
    TYRE_DIAMETER_M,
    Conditions,
)
from schemas.cruiser import WHEELBASE_M
from schemas.messages import GearPosition

_PULSES_PER_M = PULSES_PER_TURN / (math.pi * TYRE_DIAMETER_M)
_TIME_RESOLUTION_S = 1e-9
_DIRECTION = {GearPosition.DRIVE: 1.0, GearPosition.REVERSE: -1.0}


class Demand(msgspec.Struct, frozen=True):
    """The demand on the chassis by its present commander.

    Attributes:
        gear: drive, reverse or neutral.
        speed_mps: a magnitude; the gear gives the direction.
        angle_deg: left positive; None holds the angle.
        pedal_percent: brake pedal; where it has a gain, pressing it cuts the drive.
        parked: the parking brake is to be applied.
    """

    gear: GearPosition
    speed_mps: float
    angle_deg: float | None
    pedal_percent: float
    parked: bool


class Motion:
    """The moving chassis.

    Attributes:
        conditions: may change from step to step.
        parked: the parking brake is applied, and the drive is cut. It follows the demand with a delay.
        gear: the gear in force: that of the other direction engages only at standstill.
        speed_mps: signed, forward positive.
        angle_deg: steering angle, left positive.
        x_m: position; with ``y_m`` and ``yaw_rad`` (-pi to pi, left positive) the pose since the start.
        mileage_m: distance driven in either direction.
    """

    def __init__(self, conditions: Conditions = NOMINAL) -> None:
        self.conditions = conditions
        self.parked = False
        self._parking_s = 0.0
        self.gear = GearPosition.NEUTRAL
        self.speed_mps = 0.0
        self.angle_deg = 0.0
        self.x_m = 0.0
        self.y_m = 0.0
        self.yaw_rad = 0.0
        self.mileage_m = START_MILEAGE_M
        self._left_m = 0.0
        self._right_m = 0.0

    @property
    def yaw_rate_radps(self) -> float:
        """Turn rate by the bicycle model: left is positive, going forward."""
        return self.speed_mps * math.tan(math.radians(self.angle_deg)) / WHEELBASE_M

    @property
    def wheel_speeds_mps(self) -> tuple[float, float]:
        """Rear left and rear right, negative in reverse; the outer wheel of a bend is the faster one."""
        difference = self.yaw_rate_radps * TRACK_M / 2
        return self.speed_mps - difference, self.speed_mps + difference

    @property
    def wheel_pulses(self) -> tuple[int, int]:
        """Encoder counts, rear left and rear right, as signed 16-bit numbers that wrap."""
        return _wrap16(self._left_m), _wrap16(self._right_m)

    def adopt(self, *, speed_mps: float, angle_deg: float, gear: GearPosition, parked: bool) -> None:
        """From now on it moves so, as far as it can."""
        self.speed_mps = speed_mps
        self.angle_deg = _clamp(angle_deg, STEERING_LIMIT_DEG)
        self.gear = gear
        self.parked = parked
        self._parking_s = 0.0

    def step(self, demand: Demand, dt_s: float) -> None:
        """Moves on by a short time."""
        self._park(demand, dt_s)
        self._shift(demand.gear)
        self.speed_mps = self._next_speed_mps(demand, dt_s)
        if demand.angle_deg is not None:
            target_deg = _clamp(demand.angle_deg, STEERING_LIMIT_DEG)
            self.angle_deg += _clamp(target_deg - self.angle_deg, STEERING_RATE_DEGPS * dt_s)
        self._travel(dt_s)

    def _park(self, demand: Demand, dt_s: float) -> None:
        self._parking_s += dt_s
        if demand.parked is self.parked:
            self._parking_s = 0.0
        elif self._parking_s >= self.conditions.parking_delay_s - _TIME_RESOLUTION_S:
            self.parked, self._parking_s = demand.parked, 0.0

    def _shift(self, wanted: GearPosition) -> None:
        direction = _DIRECTION.get(wanted, 0.0)
        # Rolling the other way, the chassis keeps its gear and slows down first.
        if self.speed_mps * direction > -SHIFT_SPEED_MPS:
            self.gear = wanted

    def _next_speed_mps(self, demand: Demand, dt_s: float) -> float:
        if self.parked:
            grip_mps2 = PARKING_DECELERATION_MPS2 * self.conditions.parking_grip
            return self._pushed(0.0, max(grip_mps2, ROLLING_DECELERATION_MPS2), dt_s)
        pedal_mps2 = BRAKING_DECELERATION_MPS2 * self.conditions.pedal_gain * demand.pedal_percent / 100
        if pedal_mps2 or demand.gear is GearPosition.NEUTRAL:
            return self._pushed(0.0, ROLLING_DECELERATION_MPS2 + pedal_mps2, dt_s)
        # The motor follows its target, whatever the slope, as far as its force goes.
        most_mps2 = self.conditions.drive_mps2
        lowest_mps = self._pushed(-most_mps2, ROLLING_DECELERATION_MPS2, dt_s)
        highest_mps = self._pushed(most_mps2, ROLLING_DECELERATION_MPS2, dt_s)
        return max(lowest_mps, min(highest_mps, self._lagging_mps(demand, dt_s)))

    def _pushed(self, drive_mps2: float, resistance_mps2: float, dt_s: float) -> float:
        """The speed after a time of drive and gravity, and of a resistance that stops but never sets in motion."""
        free_mps = self.speed_mps + (drive_mps2 + self.conditions.downhill_mps2) * dt_s
        return free_mps - _clamp(free_mps, resistance_mps2 * dt_s)

    def _lagging_mps(self, demand: Demand, dt_s: float) -> float:
        in_gear = demand.gear is self.gear
        target_mps = min(demand.speed_mps, TOP_SPEED_MPS) * _DIRECTION[demand.gear] if in_gear else 0.0
        missing_mps = target_mps - self.speed_mps
        if abs(missing_mps) < SPEED_RESOLUTION_MPS:
            return target_mps
        slowing = missing_mps * self.speed_mps < 0
        limit_mps2 = DECELERATION_MPS2 if slowing else ACCELERATION_MPS2
        return self.speed_mps + _clamp(missing_mps * -math.expm1(-dt_s / SPEED_LAG_S), limit_mps2 * dt_s)

    def _travel(self, dt_s: float) -> None:
        left_mps, right_mps = self.wheel_speeds_mps
        self._left_m += left_mps * dt_s
        self._right_m += right_mps * dt_s
        self.mileage_m += abs(self.speed_mps) * dt_s
        turned_rad = self.yaw_rate_radps * dt_s
        heading_rad = self.yaw_rad + turned_rad / 2
        self.x_m += self.speed_mps * dt_s * math.cos(heading_rad)
        self.y_m += self.speed_mps * dt_s * math.sin(heading_rad)
        self.yaw_rad = math.remainder(self.yaw_rad + turned_rad, math.tau)


def _clamp(value: float, magnitude: float) -> float:
    return max(-magnitude, min(magnitude, value))


def _wrap16(distance_m: float) -> int:
    return (math.floor(distance_m * _PULSES_PER_M) + 0x8000) % 0x1_0000 - 0x8000
