"""The chassis that this product drives. One line, since this is the one place where it is chosen.

All others get it as a value. With a second chassis, a setting chooses here; the review then has to go by what a
log says of itself.
"""

from __future__ import annotations

from typing import Final

from gateway.chassis.cruiser.profile import CRUISER
from gateway.chassis.port import Chassis

CHASSIS: Final[Chassis] = CRUISER
