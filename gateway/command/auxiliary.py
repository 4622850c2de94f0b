"""Lamps, horn and odometer: their frames are sent only while requested. Pure.

The chassis keeps the last command forever, so each ends with frames that switch it off.
"""

from __future__ import annotations

from typing import Final

from msgspec.structs import replace

from gateway.chassis.layout import Signals
from gateway.chassis.port import AuxiliaryFrame, Chassis
from schemas.settings import BLINK_NS, ODOMETER_TIMEOUT_NS, TAIL_NS

_NEVER: Final = -1

CLEARED_KM: Final = 0.0005
"""Below this the mileage, with 0.001 km a bit, reads zero."""


class Auxiliary:
    """The requested lamps, horn and odometer."""

    def __init__(self, chassis: Chassis) -> None:
        self._design = chassis
        self._lamps = chassis.light.values
        # Since a stop last switched them off. It does so even if they were switched off before.
        self._are_lamps_set = False
        self._horn = False
        self._light_until_ns = self._horn_until_ns = self._odometer_until_ns = self._blinks_until_ns = _NEVER
        self._clearing_until_ns: int | None = None

    @property
    def is_clearing(self) -> bool:
        return self._clearing_until_ns is not None

    def is_off(self, now_ns: int) -> bool:
        """Nothing is requested, and no off frame is left to send."""
        return not self.frames(now_ns)

    def set_light(self, *, headlamp: bool, left: bool, right: bool, now_ns: int) -> None:
        lit = dict(zip(self._design.lamps, (headlamp, left, right), strict=True))
        self._lamps = self._design.light.values | lit
        self._are_lamps_set = True
        self._light_until_ns = now_ns + TAIL_NS

    def blink(self, until_ns: int) -> None:
        """Blink both indicators until then; afterwards they are as set before."""
        self._blinks_until_ns, self._light_until_ns = until_ns, until_ns + TAIL_NS
        self._are_lamps_set = True

    def set_horn(self, *, on: bool, now_ns: int) -> None:
        self._horn = on
        self._horn_until_ns = now_ns + TAIL_NS

    def clear_odometer(self, now_ns: int) -> None:
        self._clearing_until_ns = now_ns + ODOMETER_TIMEOUT_NS

    def clearing_result(self, mileage_km: float | None, now_ns: int) -> bool | None:
        """Return once whether the mileage was cleared; None while that is open or not requested."""
        until_ns = self._clearing_until_ns
        if until_ns is None:
            return None
        cleared = mileage_km is not None and mileage_km < CLEARED_KM
        # Allow time for the frames to reach the chassis: the mileage may have been zero before.
        settled = now_ns >= until_ns - ODOMETER_TIMEOUT_NS + TAIL_NS
        if (cleared and settled) or now_ns >= until_ns:
            self._end_clearing(now_ns)
            return cleared
        return None

    def end(self, now_ns: int) -> None:
        """Switch everything off, because the robot stops."""
        self._blinks_until_ns = _NEVER
        if self._horn:
            self.set_horn(on=False, now_ns=now_ns)
        if self._are_lamps_set:
            self.set_light(headlamp=False, left=False, right=False, now_ns=now_ns)
            self._are_lamps_set = False
        if self.is_clearing:
            self._end_clearing(now_ns)

    def show_hazard(self) -> None:
        """Switch both indicators on, because the robot is latched; they stay on until it is engaged again."""
        self._lamps, self._are_lamps_set = self._design.hazard.values, True

    def leave(self, now_ns: int) -> None:
        """Leave the lamps as they are, because another party commands the chassis."""
        self._are_lamps_set = self._is_lit or now_ns < self._blinks_until_ns
        self._blinks_until_ns = _NEVER

    @property
    def is_sounding(self) -> bool:
        return self._horn

    def restore(self, lamps: Signals, *, horn: bool) -> None:
        """Continue with these, as left in the chassis: the next stop or engagement switches them off."""
        self._lamps, self._are_lamps_set = lamps or self._design.light.values, bool(lamps)
        self._horn = horn

    def frames(self, now_ns: int) -> list[AuxiliaryFrame]:
        chassis = self._design
        due: list[AuxiliaryFrame] = []
        left_ns = self._blinks_until_ns - now_ns
        if left_ns > 0:
            # The last phase is on.
            is_on = left_ns // BLINK_NS % 2 == 0
            due.append(replace(chassis.light, values=self._lamps | dict.fromkeys(chassis.indicators, is_on)))
        elif self._is_lit or now_ns < self._light_until_ns:
            due.append(replace(chassis.light, values=self._lamps))
        if self._horn or now_ns < self._horn_until_ns:
            due.append(chassis.horn[self._horn])
        if self.is_clearing or now_ns < self._odometer_until_ns:
            due.append(chassis.odometer[self.is_clearing])
        return due

    def _end_clearing(self, now_ns: int) -> None:
        self._clearing_until_ns = None
        self._odometer_until_ns = now_ns + TAIL_NS

    @property
    def _is_lit(self) -> bool:
        return self._lamps != self._design.light.values
