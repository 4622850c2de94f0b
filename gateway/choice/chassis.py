"""The chassis that this product drives. All others get it as a value."""

from __future__ import annotations

from typing import Final

from gateway.chassis.cruiser.profile import CRUISER
from gateway.chassis.port import Chassis

CHASSIS: Final[Chassis] = CRUISER
