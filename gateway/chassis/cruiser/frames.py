"""The Cruiser's frames: identifiers, layouts, plausible feedback, and the firmware variant.

The checksum is weak: eight zero bytes pass it. So a frame with one implausible value is rejected as a whole. Gear
and mode must have a name in their value table, because commands depend on them. The parking status need not: the
manual names 1 and 3 of eight bits, a moving brake may report 2, and a dropped frame would hide the brake. It and
the reserved braking frame are published as ``undefined``, which permits nothing.

A standing robot's wheel speed frame is evidence of the variant: about 200 raw in the coarse one, about 32768 in
the fine one; read in the wrong one it shows -8 m/s or -32.6 m/s (protocol notes, 'Two firmware variants').
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from importlib import resources
from typing import Final

import msgspec

from gateway.chassis.layout import (
    ChassisLayout,
    MessageLayout,
    Named,
    Requires,
    Rule,
    Signals,
    Within,
    compile_signals,
)
from schemas.cruiser import DBC_FILES, SPEED_PLAUSIBLE_MPS, STEERING_PLAUSIBLE_DEG, dbc_text
from schemas.messages import GearPosition, Variant
from schemas.settings import STANDSTILL_MPS

GEAR: Final = "Auto_GearFeedBack"
STEERING: Final = "Auto_SteeringFeedBack"
DRIVE: Final = "Auto_DriveFeedBack"
PARKING: Final = "Auto_ParkingFeedBack"
BODY: Final = "Auto_MileageAndBodyFeedback"
WHEEL_SPEED: Final = "Auto_WheelSpdFeedback"
WHEEL_PULSE: Final = "Auto_WheelPulseFeedback"

SCALED_BY_VARIANT: Final = (DRIVE, WHEEL_SPEED)
"""The feedback frames of speeds, whose layout depends on the variant. A test compares this with the DBCs."""

DRIVE_COMMAND: Final = "Auto_DriveCmd"
GEAR_COMMAND: Final = "Auto_GearCmd"
STEERING_COMMAND: Final = "Auto_SteeringCmd"
BRAKING_COMMAND: Final = "Auto_BrakingCmd"
PARKING_COMMAND: Final = "Auto_ParkingCmd"
LIGHT_COMMAND: Final = "Auto_LightCmd"
SPEAKER_COMMAND: Final = "Auto_SpeakerCmd"
ODOMETER_COMMAND: Final = "Auto_OdometerCmd"

MOTION_FRAMES: Final = (DRIVE_COMMAND, GEAR_COMMAND, STEERING_COMMAND, BRAKING_COMMAND, PARKING_COMMAND)
"""The five of a burst. The speed frame is sent first, so even a partly accepted burst stops the robot."""

BRAKE_FIRST_FRAMES: Final = (DRIVE_COMMAND, PARKING_COMMAND, GEAR_COMMAND, STEERING_COMMAND, BRAKING_COMMAND)
"""Their order at zero speed, after a partly accepted burst, so that the brake is sent too."""

TARGET_SPEED: Final = "TargetVelocity"
TARGET_ANGLE: Final = "TargetAngle"


def motion_signals(
    *, enabled: bool, gear: GearPosition, speed_mps: float, angle_deg: float, parking: bool
) -> dict[str, Signals]:
    """Return the signals of the five motion frames. The brake pedal is reserved, and never pressed."""
    return {
        GEAR_COMMAND: {"Enable": enabled, "TargetGear": gear.value},
        STEERING_COMMAND: {"Enable": enabled, TARGET_ANGLE: angle_deg},
        DRIVE_COMMAND: {"Enable": enabled, TARGET_SPEED: speed_mps},
        BRAKING_COMMAND: {"Enable": enabled, "BrakePedal": 0.0},
        PARKING_COMMAND: {"Enable": enabled, "ParkingRequest": parking},
    }


LAYOUTS: Final = "layouts.json"
"""The file of the layouts. Reading the DBC with cantools took a sixth of a gateway's start."""


class ReadLayout(msgspec.Struct, frozen=True):
    """A layout, and the SHA-256 of its DBC."""

    dbc_sha256: str
    layout: ChassisLayout


def digest(variant: Variant) -> str:
    """Return the SHA-256 of a variant's DBC."""
    return sha256(dbc_text(variant).encode("ascii")).hexdigest()


@cache
def load(variant: Variant) -> ChassisLayout:
    """Return the layout of a variant. Raises ValueError."""
    text = resources.files(__package__).joinpath(LAYOUTS).read_bytes()
    read = msgspec.json.decode(text, type=dict[Variant, ReadLayout])[variant]
    if read.dbc_sha256 != digest(variant):
        raise ValueError(f"{LAYOUTS} was not made from this {DBC_FILES[variant]}; run 'make generate'")
    return read.layout


PLAUSIBLE: Final[tuple[tuple[str, str, Rule], ...]] = (
    (GEAR, "GearPosition", Named()),
    (STEERING, "Angle", Within(-STEERING_PLAUSIBLE_DEG, STEERING_PLAUSIBLE_DEG)),
    (DRIVE, "Speed", Within(0, SPEED_PLAUSIBLE_MPS)),
    (WHEEL_SPEED, "RearLeftSpeed", Within(-SPEED_PLAUSIBLE_MPS, SPEED_PLAUSIBLE_MPS)),
    (WHEEL_SPEED, "RearRightSpeed", Within(-SPEED_PLAUSIBLE_MPS, SPEED_PLAUSIBLE_MPS)),
    (BODY, "Mode", Named()),
    # Auto is 0, as in eight zero bytes; and without valid bumpers a robot in auto must not be driven.
    (BODY, "Mode", Requires("auto", "Valid")),
)
"""Frame, signal, rule. Every rule of a frame must hold."""


_KNOWN: Final = (Variant.COARSE, Variant.FINE)


def _unused_bits(layout: MessageLayout) -> int:
    used = 0
    for signal in layout.signals:
        used |= ((1 << signal.length) - 1) << signal.start_bit
    return ~used & (1 << 8 * layout.length) - 1


class StandstillEvidence:
    """Evidence of the variant in a wheel speed frame."""

    def __init__(self) -> None:
        layouts = {variant: load(variant).messages[WHEEL_SPEED] for variant in _KNOWN}
        self._readers: dict[Variant, tuple[Callable[[bytes], Signals], int]] = {
            variant: (compile_signals(layout), _unused_bits(layout)) for variant, layout in layouts.items()
        }

    def of(self, data: bytes) -> Variant:
        """The variant in which these eight bytes show standstill; UNKNOWN if none."""
        word = int.from_bytes(data, "little")
        for variant, (read, unused_bits) in self._readers.items():
            signals = read(data)
            stands = all(
                abs(float(signals[wheel])) <= STANDSTILL_MPS for wheel in ("RearLeftSpeed", "RearRightSpeed")
            )
            if signals["Valid"] and stands and not word & unused_bits:
                return variant
        return Variant.UNKNOWN

    def turns(self, data: bytes) -> bool | None:
        """Return True if these eight bytes show motion in every variant; None if they are not valid."""
        read, _ = self._readers[Variant.COARSE]
        return self.of(data) is Variant.UNKNOWN if read(data)["Valid"] else None
