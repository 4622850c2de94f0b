"""The chassis that this product drives. One line, since this is the one place where it is chosen.

All others get it as a value. Where there are two, a setting chooses here, and a log's own words for the review.
"""

from __future__ import annotations

from typing import Final

from gateway.chassis.cruiser.profile import CRUISER
from gateway.chassis.port import Chassis

CHASSIS: Final[Chassis] = CRUISER
