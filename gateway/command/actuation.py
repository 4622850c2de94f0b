"""The command to the chassis in one tick, in physical units."""

from __future__ import annotations

from typing import Final

import msgspec

from schemas.messages import GearPosition


class Actuation(msgspec.Struct, frozen=True):
    """The five command frames of a tick.

    Attributes:
        enabled: the enables of all five.
        gear: neutral, drive or reverse. Park is reserved and never commanded (manual V2.0, table of gears).
        speed_mps: a magnitude; the gear gives the direction.
        angle_deg: left is positive.
        parking: the parking brake is asked for.
    """

    enabled: bool = False
    gear: GearPosition = GearPosition.NEUTRAL
    speed_mps: float = 0.0
    angle_deg: float = 0.0
    parking: bool = True

    @property
    def signed_speed_mps(self) -> float:
        """Forward is positive."""
        return -self.speed_mps if self.gear is GearPosition.REVERSE else self.speed_mps


AT_REST: Final = Actuation()
"""Disabled, neutral, parked."""
