"""Plausible values of the Cruiser's feedback. The checksum is weak: eight zero bytes pass it.

A frame with one value outside the table is not believed at all: a fault, never data. A frame whose scale is not
known is not published, so it is not judged either.

Rules are for what a robot is driven by. Gear and mode must have a name in their value table: the manual's lists of
them are whole, and commands will depend on them. The parking status need not: the manual names 1 and 3 of eight
bits, a brake on its way may well say 2, and a dropped frame would hide the brake. The braking frame is reserved.
Both are published as ``undefined``, which permits nothing, and counted. Lamps, horn and encoder counts have no
value that is wrong.
"""

from __future__ import annotations

from typing import Final

from gateway.chassis.cruiser.frames import BODY, DRIVE, GEAR, STEERING, WHEEL_SPEED
from gateway.chassis.decode import MessageDecoder, compile_message
from gateway.chassis.layout import MessageLayout
from gateway.chassis.value_rules import Named, Requires, Rule, Within
from schemas.cruiser import SPEED_PLAUSIBLE_MPS, STEERING_PLAUSIBLE_DEG

PLAUSIBLE: Final[tuple[tuple[str, str, Rule], ...]] = (
    (GEAR, "GearPosition", Named()),
    (STEERING, "Angle", Within(-STEERING_PLAUSIBLE_DEG, STEERING_PLAUSIBLE_DEG)),
    (DRIVE, "Speed", Within(0, SPEED_PLAUSIBLE_MPS)),
    (WHEEL_SPEED, "RearLeftSpeed", Within(-SPEED_PLAUSIBLE_MPS, SPEED_PLAUSIBLE_MPS)),
    (WHEEL_SPEED, "RearRightSpeed", Within(-SPEED_PLAUSIBLE_MPS, SPEED_PLAUSIBLE_MPS)),
    (BODY, "Mode", Named()),
    # Auto is 0, as in eight zero bytes. A robot in auto whose bumpers are not valid must not be driven either.
    (BODY, "Mode", Requires("auto", "Valid")),
)
"""Frame, signal, rule. Every rule of a frame must hold."""


def compile_feedback(layout: MessageLayout) -> MessageDecoder:
    """Return the decoder of a feedback frame, which rejects implausible values.

    Raises:
        KeyError: no subject is made from this frame.
        ValueError: the fields of the message class are not the signals of the frame.
    """
    return compile_message(layout, [(signal, rule) for name, signal, rule in PLAUSIBLE if name == layout.name])
