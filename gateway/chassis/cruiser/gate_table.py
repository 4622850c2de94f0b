"""The gate's table of the Cruiser's command frames: identifiers, bits, values, steps.

Written by hand, from the manual, and not from the DBC that the encoder uses, nor from the figures that others
share: one mistake must not pass both.
"""

from __future__ import annotations

from typing import Final

import msgspec

from gateway.chassis.frame import EXTENDED, Frame
from schemas.messages import Variant

_GEAR: Final = 0x18C4D1D0 | EXTENDED
_STEERING: Final = 0x18C4D2D0 | EXTENDED
DRIVE_ID: Final = 0x18C4D3D0 | EXTENDED
_BRAKING: Final = 0x18C4D4D0 | EXTENDED
_PARKING: Final = 0x18C4D5D0 | EXTENDED
_ODOMETER: Final = 0x18C4D6D0 | EXTENDED
_LIGHT: Final = 0x18C4D7D0 | EXTENDED
_SPEAKER: Final = 0x18C4D8D0 | EXTENDED

MOTION: Final = (DRIVE_ID, _GEAR, _STEERING, _BRAKING, _PARKING)
"""The five of a burst, in their order."""

BRAKE_FIRST: Final = (DRIVE_ID, _PARKING, _GEAR, _STEERING, _BRAKING)
"""Their order at zero speed, after a burst of which the bus took only a part."""

_ALIVE_BITS: Final = 0xF << 52

USED_BITS: Final[dict[int, int]] = {
    _GEAR: 0x1 | 0x7 << 8 | _ALIVE_BITS,
    _STEERING: 0x1 | 0xFFF << 8 | _ALIVE_BITS,
    DRIVE_ID: 0x1 | 0xFFFF << 8 | _ALIVE_BITS,
    _BRAKING: 0x1 | 0xFF << 8 | _ALIVE_BITS,
    _PARKING: 0x1 | 0x1 << 8 | _ALIVE_BITS,
    _ODOMETER: 0x1 | 0x1 << 16 | _ALIVE_BITS,
    _LIGHT: 0x1 | 0x1 << 8 | 0x1 << 16 | _ALIVE_BITS,
    _SPEAKER: 0x1 | _ALIVE_BITS,
}
"""The bits of bytes 0 to 6 that may be set, by identifier (manual V2.0, section 5)."""

UNUSED_BITS: Final = {can_id: (1 << 56) - 1 & ~bits for can_id, bits in USED_BITS.items()}

REVERSE, NEUTRAL, DRIVE = 2, 3, 4
"""Raw gears. Park, 1, is reserved."""

GEARS: Final = frozenset({REVERSE, NEUTRAL, DRIVE})

ENABLES: Final = frozenset({0, len(MOTION)})
"""None of the five, or all."""

ANGLE_RAW: Final = range(1502, 2595)
"""-24 to 24 deg at 0.043945 deg/bit from -90 deg."""

SPEED_RAW_MAX: Final = {Variant.COARSE: 55, Variant.FINE: 2222, Variant.UNKNOWN: 0}
"""2.222 m/s at 0.04 or 0.001 m/s a bit. In an unknown scale only zero is safe."""

SPEED_RISE_RAW: Final = {Variant.COARSE: 1, Variant.FINE: 16, Variant.UNKNOWN: 0}
"""Most that the speed may rise from one burst to the next: 1.6 m/s2, or one bit."""

ANGLE_STEP_RAW: Final = 15
"""Most that the angle may change from one burst to the next: 60 deg/s, and rounding."""


class MotionBurst(msgspec.Struct, frozen=True, gc=False):
    """The five frames of a burst, read back from their bytes.

    Attributes:
        enables: number of the five that are set.
        gear, angle_raw, speed_raw, pedal_raw: unscaled, as in the bytes.
        parking: the parking request.
    """

    enables: int
    gear: int
    angle_raw: int
    speed_raw: int
    pedal_raw: int
    parking: int


def read_motion(frames: list[Frame]) -> MotionBurst:
    """Read the five frames that a burst begins with, in whatever order."""
    words = {frame.can_id: int.from_bytes(frame.data, "little") for frame in frames[:5]}
    drive, gear, steering, braking, parking = (words[can_id] for can_id in MOTION)
    return MotionBurst(
        enables=(drive & 1) + (gear & 1) + (steering & 1) + (braking & 1) + (parking & 1),
        gear=gear >> 8 & 0x7,
        angle_raw=steering >> 8 & 0xFFF,
        speed_raw=drive >> 8 & 0xFFFF,
        pedal_raw=braking >> 8 & 0xFF,
        parking=parking >> 8 & 1,
    )
