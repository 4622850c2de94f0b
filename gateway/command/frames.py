"""From an actuation to CAN frames, with alive counters that advance only with frames that were sent."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor
from typing import Final

import msgspec

from gateway.chassis.decode import Value
from gateway.chassis.encode import Encoder
from gateway.chassis.frame import Frame
from gateway.chassis.layout import load
from gateway.command.actuation import Actuation
from gateway.command.auxiliary import AuxiliaryFrame
from schemas.messages import Variant

MOTION_FRAMES: Final = (
    "Auto_DriveCmd",
    "Auto_GearCmd",
    "Auto_SteeringCmd",
    "Auto_BrakingCmd",
    "Auto_ParkingCmd",
)
"""The five of a burst, in their order: where a bus takes but a part of it, the speed is heard first."""

COUNTER_MODULO: Final = 16
_HAIR: Final = 1e-6
"""Of a bit, so that a value that is a whole number of bits is not taken for the one below."""


class FrameMaker:
    """Makes the frames of a tick.

    Attributes:
        counters: the next alive counter of each command frame, by the frame's name.
    """

    def __init__(self) -> None:
        self._encoders = {variant: Encoder(load(variant)) for variant in (Variant.COARSE, Variant.FINE)}
        self._scales = {
            variant: load(variant).messages["Auto_DriveCmd"].signal("TargetVelocity").scale
            for variant in self._encoders
        }
        angle = load(Variant.COARSE).messages["Auto_SteeringCmd"].signal("TargetAngle")
        self._angle_scale_deg = angle.scale
        self.counters = {message.name: 0 for message in load(Variant.COARSE).commands}
        self._names = {message.can_id: message.name for message in load(Variant.COARSE).commands}

    def make(self, actuation: Actuation, auxiliary: list[AuxiliaryFrame], variant: Variant) -> list[Frame]:
        """The frames of this tick: the five motion frames, then what else is asked for.

        While the variant is not known the frames say zero speed, which is the same in both: a stop must go out
        all the same.
        """
        known = variant if variant is not Variant.UNKNOWN else Variant.COARSE
        encode, counters = self._encoders[known].encode, self.counters
        if variant is Variant.UNKNOWN:
            actuation = msgspec.structs.replace(actuation, speed_mps=0.0)
        values = self._motion_values(actuation, self._scales[known])
        frames = [encode(name, values[name], counters[name]) for name in MOTION_FRAMES]
        frames += [encode(extra.name, extra.values, counters[extra.name]) for extra in auxiliary]
        return frames

    def restore(self, sent: Mapping[int, int]) -> None:
        """These counters, by identifier, were sent last."""
        for can_id, counter in sent.items():
            self.counters[self._names[can_id]] = (counter + 1) % COUNTER_MODULO

    def sent(self, frames: list[Frame]) -> None:
        """These were sent: their counters advance."""
        for frame in frames:
            name = self._names[frame.can_id]
            self.counters[name] = (self.counters[name] + 1) % COUNTER_MODULO

    def _motion_values(self, actuation: Actuation, scale: float) -> dict[str, dict[str, Value]]:
        enable = actuation.enabled
        return {
            "Auto_GearCmd": {"Enable": enable, "TargetGear": actuation.gear.value},
            "Auto_SteeringCmd": {"Enable": enable, "TargetAngle": self._toward_zero(actuation.angle_deg)},
            # Down to the bit: to the nearest one it would be above the limit.
            "Auto_DriveCmd": {
                "Enable": enable,
                "TargetVelocity": floor(actuation.speed_mps / scale + _HAIR) * scale,
            },
            "Auto_BrakingCmd": {"Enable": enable, "BrakePedal": 0.0},
            "Auto_ParkingCmd": {"Enable": enable, "ParkingRequest": actuation.parking},
        }

    def _toward_zero(self, angle_deg: float) -> float:
        bits = floor(abs(angle_deg) / self._angle_scale_deg + _HAIR)
        return bits * self._angle_scale_deg * (-1 if angle_deg < 0 else 1)
