"""What a feedback frame may say. The checksum is weak (eight zero bytes pass it), so the values carry weight too.

One table; ``decode`` compiles it into the decoder of each frame. A frame with one value outside it is not believed
at all: a fault, never data. A frame whose scale is not known is not published, so it is not judged either.

Rules are for what a robot is driven by. Gear and mode must have a name in their value table: the manual's lists of
them are whole, and commands will depend on them. The parking status need not: the manual names 1 and 3 of eight
bits, a brake on its way may well say 2, and a dropped frame would hide the brake. The braking frame is reserved.
Both are published as ``undefined``, which permits nothing, and counted. Lamps, horn and encoder counts have no
value that is wrong.
"""

from __future__ import annotations

from typing import Final

import msgspec

from schemas.settings import SPEED_PLAUSIBLE_MPS, STEERING_PLAUSIBLE_DEG


class Within(msgspec.Struct, frozen=True):
    """The physical value, in the signal's unit, lies between these, both included."""

    minimum: float
    maximum: float


class Named(msgspec.Struct, frozen=True):
    """The value table has a name for the value."""


class Requires(msgspec.Struct, frozen=True):
    """This choice counts only where a flag of the same frame is set; any other choice needs none."""

    choice: str
    flag: str


Rule = Within | Named | Requires

PLAUSIBLE: Final[tuple[tuple[str, str, Rule], ...]] = (
    ("Auto_GearFeedBack", "GearPosition", Named()),
    ("Auto_SteeringFeedBack", "Angle", Within(-STEERING_PLAUSIBLE_DEG, STEERING_PLAUSIBLE_DEG)),
    ("Auto_DriveFeedBack", "Speed", Within(0, SPEED_PLAUSIBLE_MPS)),
    ("Auto_WheelSpdFeedback", "RearLeftSpeed", Within(-SPEED_PLAUSIBLE_MPS, SPEED_PLAUSIBLE_MPS)),
    ("Auto_WheelSpdFeedback", "RearRightSpeed", Within(-SPEED_PLAUSIBLE_MPS, SPEED_PLAUSIBLE_MPS)),
    ("Auto_MileageAndBodyFeedback", "Mode", Named()),
    # Auto is 0, as in eight zero bytes. A robot in auto whose bumpers are not valid must not be driven either.
    ("Auto_MileageAndBodyFeedback", "Mode", Requires("auto", "Valid")),
)
"""Frame, signal, rule. Every rule of a frame must hold."""


def rules(message_name: str) -> list[tuple[str, Rule]]:
    """The rules of a frame: signal and rule."""
    return [(signal, rule) for name, signal, rule in PLAUSIBLE if name == message_name]
