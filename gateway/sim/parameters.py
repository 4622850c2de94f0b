"""The figures of the virtual chassis, each with its unit: the one file for them.

What the manual states is cited. What it leaves open is marked *chosen*: plausible for 116 kg on four wheels, and
nothing outside the simulation may rest on it. The wheelbase, which the gateway needs too, is in
``schemas.cruiser``.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Final

import msgspec

GRAVITY_MPS2: Final = 9.81

EMPTY_MASS_KG: Final = 116.0
"""Manual V2.0, 2.2."""

TOP_SPEED_MPS: Final = 8 / 3.6
"""8 km/h (manual V2.0, 2.2). It drives no faster, whatever the frame asks for; downhill it may roll faster."""

STEERING_LIMIT_DEG: Final = 24.0
"""The soft limit inside the chassis (manual V2.0, 5 (2))."""

TRACK_M: Final = 0.606
"""Distance between the rear wheels (manual V2.0, 2.2)."""

TYRE_DIAMETER_M: Final = 0.420
"""Manual V2.0, 2.2."""

PULSES_PER_TURN: Final = 1024
"""Encoder counts for one turn of a wheel. Chosen: the manual gives none."""

SPEED_LAG_S: Final = 0.15
"""Time constant of the drive's first-order lag. Chosen."""

ACCELERATION_MPS2: Final = 1.5
"""Most the drive can speed up. Chosen, above what the gateway will ever ask for."""

DECELERATION_MPS2: Final = 2.0
"""Most the drive alone can slow down. Chosen."""

MAX_DRIVE_FORCE_N: Final = 630.0
"""Most the motor can push or hold back. Chosen from what the chassis climbs (manual V2.0, 2.2).

20 deg empty take 424 N, 15 deg with full payload 613 N, each with rolling resistance. Holding 20 deg with full
payload would take 660 N.
"""

ROLLING_DECELERATION_MPS2: Final = 0.3
"""Rolling resistance, at any speed, load and slope. Chosen; in neutral it holds the robot up to 1.75 deg."""

BRAKING_DECELERATION_MPS2: Final = 3.0
"""The service brake at full pedal and a pedal gain of 1. Chosen."""

PARKING_DECELERATION_MPS2: Final = 7.0
"""The grip of the applied electromagnetic parking brake, standing or moving. Chosen; 20 deg need 3.4."""

FULL_PEDAL_PERCENT: Final = 99.0
"""From here on the brake reads fully braked; eight bits of 0.390625 % end at 99.6 %."""

STEERING_RATE_DEGPS: Final = 60.0
"""Chosen."""

SHIFT_SPEED_MPS: Final = 0.01
"""The gear of the other direction engages only below this speed. Chosen; the manual asks for zero."""

SPEED_RESOLUTION_MPS: Final = 0.0005
"""Nearer than this to its target, the lagging speed is at it: half of the finest bit on the wire."""

REBOOT_NS: Final = 2_000_000_000
"""The default time that the chassis's control unit takes to reboot. Chosen."""

BOUNCE_NS: Final = tuple(number * 1_000_000 for number in (30, 50, 10, 80, 20, 40))
"""The times for which a bouncing contact is closed, open, closed and so on, before it rests. Chosen."""

START_MILEAGE_M: Final = 12_345.0
"""Mileage at power-up: not zero, so that clearing it shows. Chosen."""

FOREIGN_PERIOD_NS: Final = 100_000_000
"""The default period of a foreign frame."""

MAX_RATE_MULTIPLIER: Final = 100.0
"""The feedback's rate may be raised to this multiple; 11.9 saturates a 1 Mbit/s bus (7,500 frames/s)."""

MIN_RATE_MULTIPLIER: Final = 0.1


class StopMode(Enum):
    """The chassis's behaviour in mode stop. The manual does not define it."""

    BRAKES = "brakes"
    COASTS = "coasts"
    PARKS = "parks"


class Conditions(msgspec.Struct, frozen=True):
    """Conditions that the manual leaves open, or that differ from place to place.

    Attributes:
        slope_deg: positive with the nose up, whichever way the robot turns.
        pedal_gain: share of the service brake that the brake pedal applies. The manual calls the pedal reserved.
        motor_strength: share of its greatest force that the motor has.
        parking_grip: share of its grip that the parking brake has; it reads applied all the same.
        parking_delay_s: time that the parking brake takes to apply, and to release. Chosen.
        stop_mode: the chassis's behaviour in mode stop.
    """

    slope_deg: float = 0.0
    payload_kg: float = 0.0
    pedal_gain: float = 0.0
    motor_strength: float = 1.0
    parking_delay_s: float = 0.05
    parking_grip: float = 1.0
    stop_mode: StopMode = StopMode.BRAKES

    @property
    def downhill_mps2(self) -> float:
        """The acceleration of the free robot by gravity: forward positive."""
        return -GRAVITY_MPS2 * math.sin(math.radians(self.slope_deg))

    @property
    def drive_mps2(self) -> float:
        """The acceleration by the motor's greatest force."""
        return self.motor_strength * MAX_DRIVE_FORCE_N / (EMPTY_MASS_KG + self.payload_kg)


NOMINAL: Final = Conditions()
"""On the flat, empty."""

CONDITION_BOUNDS: Final = {
    "slope_deg": (-30.0, 30.0),
    "payload_kg": (0.0, 100.0),
    "pedal_gain": (0.0, 1.0),
    "motor_strength": (0.0, 1.0),
    "parking_delay_s": (0.0, 1.0),
    "parking_grip": (0.0, 1.0),
}
"""Each condition with a number: from, to. The payload's is the manual's (V2.0, 2.2)."""
