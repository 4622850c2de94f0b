"""Physics of the virtual chassis: constants with units, and motion. Pure.

Values from the manual cite it. Values marked *chosen* are plausible for 116 kg on four wheels, and nothing outside
the simulation may rely on them. The model is a bicycle on a slope, with a lagging drive, brakes and a steering
motor; axes follow ISO 8855, and the pose is that of the middle of the rear axle.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Final

import msgspec

from schemas.messages import GearPosition

GRAVITY_MPS2: Final = 9.81

EMPTY_MASS_KG: Final = 116.0  # manual V2.0, 2.2

TOP_SPEED_MPS: Final = 8 / 3.6  # 8 km/h (manual V2.0, 2.2): the fastest drive speed; downhill it may roll faster
STEERING_LIMIT_DEG: Final = 24.0  # the soft limit inside the chassis (manual V2.0, 5 (2))
TRACK_M: Final = 0.606  # distance between the rear wheels (manual V2.0, 2.2)
TYRE_DIAMETER_M: Final = 0.420  # manual V2.0, 2.2

PULSES_PER_TURN: Final = 1024  # encoder counts for one turn of a wheel. Chosen: the manual gives none
SPEED_LAG_S: Final = 0.15  # time constant of the drive's first-order lag. Chosen
ACCELERATION_MPS2: Final = 1.5  # the drive's greatest acceleration. Chosen, above any command of the gateway
DECELERATION_MPS2: Final = 2.0  # the drive's greatest deceleration without brakes. Chosen
MAX_DRIVE_FORCE_N: Final = 630.0
"""The motor's greatest force, either way. Chosen by the slopes that the chassis climbs (manual V2.0, 2.2).

20 deg empty take 424 N, 15 deg with full payload 613 N, each with rolling resistance. Holding 20 deg with full
payload would take 660 N.
"""

ROLLING_DECELERATION_MPS2: Final = 0.3
"""Rolling resistance, at any speed, load and slope. Chosen; in neutral it holds the robot up to 1.75 deg."""

BRAKING_DECELERATION_MPS2: Final = 3.0  # the service brake at full pedal and a pedal gain of 1. Chosen
PARKING_DECELERATION_MPS2: Final = 7.0
"""The grip of the applied electromagnetic parking brake, standing or moving. Chosen; 20 deg need 3.4."""

FULL_PEDAL_PERCENT: Final = 99.0
"""The brake reads fully braked from here on; eight bits of 0.390625 % end at 99.6 %."""

STEERING_RATE_DEGPS: Final = 60.0  # chosen

SHIFT_SPEED_MPS: Final = 0.01
"""The gear of the other direction engages only below this speed. Chosen; the manual asks for zero."""

SPEED_RESOLUTION_MPS: Final = 0.0005
"""The lagging speed snaps to its target within this: half of the finest bit on the wire."""

REBOOT_NS: Final = 2_000_000_000  # the default time that the chassis's control unit takes to reboot. Chosen
BOUNCE_NS: Final = tuple(number * 1_000_000 for number in (30, 50, 10, 80, 20, 40))
"""Times for which a bouncing contact is closed, open and so on, before it settles. Chosen."""

START_MILEAGE_M: Final = 12_345.0  # mileage at power-up, not zero, so that clearing it is visible. Chosen
FOREIGN_PERIOD_NS: Final = 100_000_000  # the default period of a foreign frame

MAX_RATE_MULTIPLIER: Final = 100.0
"""Greatest multiple of the feedback rate; 11.9 saturates a 1 Mbit/s bus (7,500 frames/s)."""

MIN_RATE_MULTIPLIER: Final = 0.1


class StopMode(Enum):
    """Behaviour in mode stop, which the manual does not define."""

    BRAKES = "brakes"
    COASTS = "coasts"
    PARKS = "parks"


class Conditions(msgspec.Struct, frozen=True):
    """Conditions that the manual leaves open, or that depend on the place.

    Attributes:
        pedal_gain: share of the service brake that the brake pedal applies. The manual calls the pedal reserved.
    """

    slope_deg: float = 0.0  # positive with the nose up, in every heading
    payload_kg: float = 0.0
    pedal_gain: float = 0.0
    motor_strength: float = 1.0  # share of the motor's greatest force
    parking_delay_s: float = 0.05  # time to apply or release the parking brake; chosen
    parking_grip: float = 1.0  # share of the parking brake's grip; its feedback reads applied all the same
    stop_mode: StopMode = StopMode.BRAKES

    @property
    def downhill_mps2(self) -> float:
        """The acceleration of the free robot by gravity: forward positive."""
        return -GRAVITY_MPS2 * math.sin(math.radians(self.slope_deg))

    @property
    def drive_mps2(self) -> float:
        return self.motor_strength * MAX_DRIVE_FORCE_N / (EMPTY_MASS_KG + self.payload_kg)


NOMINAL: Final = Conditions()  # level ground, no payload

CONDITION_BOUNDS: Final = {
    "slope_deg": (-30.0, 30.0),
    "payload_kg": (0.0, 100.0),
    "pedal_gain": (0.0, 1.0),
    "motor_strength": (0.0, 1.0),
    "parking_grip": (0.0, 1.0),
}
"""Bounds of the numeric conditions. The payload's is the manual's (V2.0, 2.2)."""


_PULSES_PER_M = PULSES_PER_TURN / (math.pi * TYRE_DIAMETER_M)
_TIME_RESOLUTION_S = 1e-9
_DIRECTION = {GearPosition.DRIVE: 1.0, GearPosition.REVERSE: -1.0}


class Demand(msgspec.Struct, frozen=True):
    """A command to the chassis, from CAN or from the remote control."""

    gear: GearPosition
    speed_mps: float  # magnitude; the gear gives the direction
    angle_deg: float | None  # left positive; None holds the angle
    pedal_percent: float  # brake pedal; with a pedal gain, it cuts the drive
    parked: bool


class Motion:
    """The moving chassis.

    Attributes:
        x_m: position; with ``y_m`` and ``yaw_rad`` (-pi to pi, left positive) the pose since the start.
    """

    def __init__(self, wheelbase_m: float, conditions: Conditions = NOMINAL) -> None:
        self._wheelbase_m = wheelbase_m
        self.conditions = conditions
        self.parked = False  # the parking brake is applied and the drive is cut; follows the demand with a delay
        self._parking_s = 0.0
        self.gear = GearPosition.NEUTRAL  # the engaged gear; the other direction engages only at standstill
        self.speed_mps = 0.0  # signed, forward positive
        self.angle_deg = 0.0  # steering angle, left positive
        self.x_m = 0.0
        self.y_m = 0.0
        self.yaw_rad = 0.0
        self.mileage_m = START_MILEAGE_M
        self._left_m = 0.0
        self._right_m = 0.0

    @property
    def yaw_rate_radps(self) -> float:
        """Yaw rate by the bicycle model; left positive."""
        return self.speed_mps * math.tan(math.radians(self.angle_deg)) / self._wheelbase_m

    @property
    def wheel_speeds_mps(self) -> tuple[float, float]:
        """Rear left and rear right, negative in reverse."""
        difference = self.yaw_rate_radps * TRACK_M / 2
        return self.speed_mps - difference, self.speed_mps + difference

    @property
    def wheel_pulses(self) -> tuple[int, int]:
        """Encoder counts, rear left and rear right, as signed 16-bit numbers that wrap."""
        return _wrap16(self._left_m), _wrap16(self._right_m)

    def adopt(self, *, speed_mps: float, angle_deg: float, gear: GearPosition, parked: bool) -> None:
        """Take over this motion, within the steering limit."""
        self.speed_mps = speed_mps
        self.angle_deg = _clamp(angle_deg, STEERING_LIMIT_DEG)
        self.gear = gear
        self.parked = parked
        self._parking_s = 0.0

    def step(self, demand: Demand, dt_s: float) -> None:
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
        # While it rolls the other way, the chassis keeps its gear.
        if self.speed_mps * direction > -SHIFT_SPEED_MPS:
            self.gear = wanted

    def _next_speed_mps(self, demand: Demand, dt_s: float) -> float:
        if self.parked:
            grip_mps2 = PARKING_DECELERATION_MPS2 * self.conditions.parking_grip
            return self._pushed(0.0, max(grip_mps2, ROLLING_DECELERATION_MPS2), dt_s)
        pedal_mps2 = BRAKING_DECELERATION_MPS2 * self.conditions.pedal_gain * demand.pedal_percent / 100
        if pedal_mps2 or demand.gear is GearPosition.NEUTRAL:
            return self._pushed(0.0, ROLLING_DECELERATION_MPS2 + pedal_mps2, dt_s)
        # The motor follows its target on any slope, within its force.
        most_mps2 = self.conditions.drive_mps2
        lowest_mps = self._pushed(-most_mps2, ROLLING_DECELERATION_MPS2, dt_s)
        highest_mps = self._pushed(most_mps2, ROLLING_DECELERATION_MPS2, dt_s)
        return max(lowest_mps, min(highest_mps, self._lagging_mps(demand, dt_s)))

    def _pushed(self, drive_mps2: float, resistance_mps2: float, dt_s: float) -> float:
        """Return the speed after drive, gravity, and a resistance that stops but never sets in motion."""
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
