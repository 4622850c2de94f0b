"""The figures of the virtual chassis, each with its unit: the one file for them.

What the manual states is cited. What it leaves open is marked *chosen*: plausible for 116 kg on four wheels, and
nothing outside the simulation may rest on it. The wheelbase, which the gateway needs too, is in
``schemas.settings``.
"""

from __future__ import annotations

from typing import Final

TOP_SPEED_MPS: Final = 8 / 3.6
"""8 km/h (manual V2.0, 2.2). The chassis holds itself to it, whatever the frame asks for."""

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

ROLLING_DECELERATION_MPS2: Final = 0.3
"""What rolling resistance takes in neutral. Chosen."""

BRAKING_DECELERATION_MPS2: Final = 3.0
"""The service brake at full pedal. Chosen."""

PARKING_DECELERATION_MPS2: Final = 4.0
"""The electromagnetic parking brake, which locks the wheels. Chosen."""

FULL_PEDAL_PERCENT: Final = 99.0
"""From here on the brake reads fully braked; eight bits of 0.390625 % end at 99.6 %."""

STOP_MODE_PEDAL_PERCENT: Final = 60.0
"""How hard the chassis brakes by itself when it leaves auto mode while moving. Chosen."""

STEERING_RATE_DEGPS: Final = 60.0
"""Chosen."""

SHIFT_SPEED_MPS: Final = 0.01
"""The gear of the other direction engages only below this speed. Chosen; the manual asks for zero."""

SPEED_RESOLUTION_MPS: Final = 0.0005
"""Nearer than this to its target, the lagging speed is at it: half of the finest bit on the wire."""

TRANSMITTER_LOSS_NS: Final = 3_000_000_000
"""In remote mode the chassis stops when the hand transmitter is lost for 3 s (manual V2.0, 6.4)."""

START_MILEAGE_M: Final = 12_345.0
"""Mileage at power-up: not zero, so that clearing it shows. Chosen."""

FOREIGN_PERIOD_NS: Final = 100_000_000
"""How often a foreign frame is sent unless asked otherwise."""

SIBLING_PERIOD_NS: Final = 1_000_000_000
"""A sibling chassis's battery frames come once a second."""

MAX_RATE_MULTIPLIER: Final = 100.0
"""The feedback's rate may be raised to this multiple; 11.9 saturates a 1 Mbit/s bus (7,500 frames/s)."""

MIN_RATE_MULTIPLIER: Final = 0.1
