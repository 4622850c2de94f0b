"""The Cruiser's command frames of a tick, with alive counters, which advance only with frames that were sent."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from gateway.chassis.cruiser.frames import (
    BRAKE_FIRST_FRAMES,
    DRIVE_COMMAND,
    MOTION_FRAMES,
    STEERING_COMMAND,
    TARGET_ANGLE,
    TARGET_SPEED,
    load,
    motion_signals,
)
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Encoder
from gateway.chassis.port import Actuation, AuxiliaryFrame, toward_zero
from schemas.can_word import COUNTER_SPAN
from schemas.messages import Variant


class FrameMaker:
    """Makes the frames of a tick."""

    def __init__(self) -> None:
        layouts = {variant: load(variant) for variant in (Variant.COARSE, Variant.FINE)}
        self._encoders = {variant: Encoder(layout) for variant, layout in layouts.items()}
        self._scales = {
            variant: layout.messages[DRIVE_COMMAND].signal(TARGET_SPEED).scale
            for variant, layout in layouts.items()
        }
        commands = layouts[Variant.COARSE].commands
        self._angle_scale_deg = layouts[Variant.COARSE].messages[STEERING_COMMAND].signal(TARGET_ANGLE).scale
        self.counters = {message.name: 0 for message in commands}
        self._names = {message.can_id: message.name for message in commands}
        self.is_torn = False

    def make(self, actuation: Actuation, auxiliary: list[AuxiliaryFrame], variant: Variant) -> list[Frame]:
        """Return the frames of this tick: the five motion frames, then the requested others.

        In an unknown variant the speed is zero, which is the same in both, so that a stop can always be sent.
        """
        known = variant if variant is not Variant.UNKNOWN else Variant.COARSE
        encode, counters = self._encoders[known].encode, self.counters
        if variant is Variant.UNKNOWN:
            actuation = msgspec.structs.replace(actuation, speed_mps=0.0)
        values = motion_signals(
            enabled=actuation.enabled,
            gear=actuation.gear,
            # Round down: the nearest bit could be above the limit.
            speed_mps=toward_zero(actuation.speed_mps, self._scales[known]),
            angle_deg=toward_zero(actuation.angle_deg, self._angle_scale_deg),
            parking=actuation.parking,
        )
        order = BRAKE_FIRST_FRAMES if self.is_torn and not values[DRIVE_COMMAND][TARGET_SPEED] else MOTION_FRAMES
        frames = [encode(name, values[name], counters[name]) for name in order]
        frames += [encode(extra.name, extra.values, counters[extra.name]) for extra in auxiliary]
        return frames

    def restore(self, sent: Mapping[int, int]) -> None:
        for can_id, counter in sent.items():
            self.counters[self._names[can_id]] = (counter + 1) % COUNTER_SPAN

    def sent(self, frames: list[Frame]) -> None:
        if frames:
            self.is_torn = len(frames) < len(MOTION_FRAMES)
        for frame in frames:
            name = self._names[frame.can_id]
            self.counters[name] = (self.counters[name] + 1) % COUNTER_SPAN
