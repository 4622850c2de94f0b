"""The Cruiser's command frames of a tick: motion, and what goes beside it.

From an actuation to CAN frames, with alive counters that advance only with frames that were sent.

Lamps, horn and odometer: frames that go out only while they are asked for.

The chassis keeps the last command for ever, so each ends with frames that say off.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import floor
from typing import Final

import msgspec

from gateway.chassis.cruiser.frames import (
    BRAKE_FIRST_FRAMES,
    DRIVE_COMMAND,
    LIGHT_COMMAND,
    MOTION_FRAMES,
    ODOMETER_COMMAND,
    SPEAKER_COMMAND,
    STEERING_COMMAND,
    TARGET_ANGLE,
    TARGET_SPEED,
    light_signals,
    load,
    motion_signals,
    odometer_signals,
    speaker_signals,
)
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Encoder, Signals
from gateway.chassis.port import Actuation
from schemas.can_word import COUNTER_SPAN
from schemas.messages import Variant
from schemas.settings import BLINK_NS, ODOMETER_TIMEOUT_NS, TAIL_NS

_NEVER: Final = -1
_DARK: Final = light_signals()
_INDICATORS: Final = ("LeftIndicator", "RightIndicator")
HAZARD: Final = light_signals(left=True, right=True)
"""Both indicators, by which a robot says that it is latched."""

CLEARED_KM: Final = 0.0005
"""Below this the mileage, 0.001 km a bit, reads zero."""


class AuxiliaryFrame(msgspec.Struct, frozen=True):
    """A frame to send, by its name in the DBC, with its signals."""

    name: str
    values: Signals


class Auxiliary:
    """The lamps, the horn and the odometer, as asked for."""

    def __init__(self) -> None:
        self._lamps = _DARK
        # Since they were last told off by a stop. That repeats the off of whoever put them out before.
        self._are_lamps_set = False
        self._horn = False
        self._light_until_ns = self._horn_until_ns = self._odometer_until_ns = self._blinks_until_ns = _NEVER
        self._clearing_until_ns: int | None = None

    @property
    def is_clearing(self) -> bool:
        """The odometer is being cleared."""
        return self._clearing_until_ns is not None

    def is_off(self, now_ns: int) -> bool:
        """Nothing is asked for, and no frame is left to say off."""
        return not self.frames(now_ns)

    def set_light(self, *, headlamp: bool, left: bool, right: bool, now_ns: int) -> None:
        """Set the lamps."""
        self._lamps = light_signals(headlamp=headlamp, left=left, right=right)
        self._are_lamps_set = True
        self._light_until_ns = now_ns + TAIL_NS

    def blink(self, until_ns: int) -> None:
        """Both indicators blink until then; afterwards they are as they were set."""
        self._blinks_until_ns, self._light_until_ns = until_ns, until_ns + TAIL_NS
        self._are_lamps_set = True

    def set_horn(self, *, on: bool, now_ns: int) -> None:
        """Sound the horn, or end it."""
        self._horn = on
        self._horn_until_ns = now_ns + TAIL_NS

    def clear_odometer(self, now_ns: int) -> None:
        """Begin to clear the mileage."""
        self._clearing_until_ns = now_ns + ODOMETER_TIMEOUT_NS

    def clearing_result(self, mileage_km: float | None, now_ns: int) -> bool | None:
        """Return, once, whether the mileage was cleared; None while that is open, or nothing is being cleared."""
        until_ns = self._clearing_until_ns
        if until_ns is None:
            return None
        cleared = mileage_km is not None and mileage_km < CLEARED_KM
        # The first frames must have reached the chassis: a mileage that was zero before proves nothing.
        settled = now_ns >= until_ns - ODOMETER_TIMEOUT_NS + TAIL_NS
        if (cleared and settled) or now_ns >= until_ns:
            self._end_clearing(now_ns)
            return cleared
        return None

    def end(self, now_ns: int) -> None:
        """The robot stops: all of it ends, each with its frames that say off."""
        self._blinks_until_ns = _NEVER
        if self._horn:
            self.set_horn(on=False, now_ns=now_ns)
        if self._are_lamps_set:
            self.set_light(headlamp=False, left=False, right=False, now_ns=now_ns)
            self._are_lamps_set = False
        if self.is_clearing:
            self._end_clearing(now_ns)

    def show_hazard(self) -> None:
        """The robot is latched: both indicators are switched on, and left on until it is engaged again."""
        self._lamps, self._are_lamps_set = HAZARD, True

    def leave(self) -> None:
        """Leave the lamps as they are: somebody else commands the chassis. Dark ones need no clearing frame."""
        self._are_lamps_set = self._lamps != _DARK

    @property
    def left(self) -> tuple[Signals, bool]:
        """The lamps and the horn as they were set last; of lamps that are out no signals."""
        return self._lamps if self._lamps != _DARK else {}, self._horn

    @property
    def is_sounding(self) -> bool:
        """The horn was set last."""
        return self._horn

    def restore(self, lamps: Signals, *, horn: bool) -> None:
        """The chassis was left with these: the next stop, or engagement, puts them out."""
        self._lamps, self._are_lamps_set, self._horn = lamps or _DARK, bool(lamps), horn

    def frames(self, now_ns: int) -> list[AuxiliaryFrame]:
        """The frames of this tick."""
        due: list[AuxiliaryFrame] = []
        left_ns = self._blinks_until_ns - now_ns
        if left_ns > 0:
            # On at last, and before that as often as there is time.
            is_on = left_ns // BLINK_NS % 2 == 0
            due.append(AuxiliaryFrame(LIGHT_COMMAND, self._lamps | dict.fromkeys(_INDICATORS, is_on)))
        elif self._lamps != _DARK or now_ns < self._light_until_ns:
            due.append(AuxiliaryFrame(LIGHT_COMMAND, self._lamps))
        if self._horn or now_ns < self._horn_until_ns:
            due.append(AuxiliaryFrame(SPEAKER_COMMAND, speaker_signals(horn=self._horn)))
        if self.is_clearing or now_ns < self._odometer_until_ns:
            due.append(AuxiliaryFrame(ODOMETER_COMMAND, odometer_signals(clears=self.is_clearing)))
        return due

    def _end_clearing(self, now_ns: int) -> None:
        self._clearing_until_ns = None
        self._odometer_until_ns = now_ns + TAIL_NS


_HAIR: Final = 1e-6
"""Of a bit, so that a value that is a whole number of bits is not taken for the one below."""


class FrameMaker:
    """Makes the frames of a tick.

    Attributes:
        counters: the next alive counter of each command frame, by the frame's name.
        is_torn: the bus took only a part of the last burst that it took anything of.
    """

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
        """Return the frames of this tick: the five motion frames, then others that were requested.

        While the variant is not known the frames say zero speed, which is the same in both: a stop must go out
        all the same.
        """
        known = variant if variant is not Variant.UNKNOWN else Variant.COARSE
        encode, counters = self._encoders[known].encode, self.counters
        if variant is Variant.UNKNOWN:
            actuation = msgspec.structs.replace(actuation, speed_mps=0.0)
        values = motion_signals(
            enabled=actuation.enabled,
            gear=actuation.gear,
            # Down to the bit: to the nearest one it would be above the limit.
            speed_mps=toward_zero(actuation.speed_mps, self._scales[known]),
            angle_deg=toward_zero(actuation.angle_deg, self._angle_scale_deg),
            parking=actuation.parking,
        )
        order = BRAKE_FIRST_FRAMES if self.is_torn and not values[DRIVE_COMMAND][TARGET_SPEED] else MOTION_FRAMES
        frames = [encode(name, values[name], counters[name]) for name in order]
        frames += [encode(extra.name, extra.values, counters[extra.name]) for extra in auxiliary]
        return frames

    def restore(self, sent: Mapping[int, int]) -> None:
        """These counters, by identifier, were sent last."""
        for can_id, counter in sent.items():
            self.counters[self._names[can_id]] = (counter + 1) % COUNTER_SPAN

    def sent(self, frames: list[Frame]) -> None:
        """These were sent, the first of a burst: their counters advance."""
        if frames:
            self.is_torn = len(frames) < len(MOTION_FRAMES)
        for frame in frames:
            name = self._names[frame.can_id]
            self.counters[name] = (self.counters[name] + 1) % COUNTER_SPAN


def toward_zero(value: float, scale: float) -> float:
    """Return the value of the nearest whole number of bits that is not beyond it."""
    return floor(abs(value) / scale + _HAIR) * scale * (-1 if value < 0 else 1)
