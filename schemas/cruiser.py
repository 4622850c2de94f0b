"""The Cruiser's figures (manual V2.0, 2.2 and 5) and its DBC files; a second chassis is a file beside it.

``make generate`` makes ``gateway/chassis/cruiser/layouts.json`` of the DBC files, from which frames are read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from schemas.messages import Variant

WHEELBASE_M: Final = 0.660

SPEED_TOP_MPS: Final = 2.222  # the chassis drives no faster, either way: 8 km/h
STEERING_TOP_DEG: Final = 24.0  # the chassis steers no further, to either side

STEERING_PLAUSIBLE_DEG: Final = 25.0
"""Steering feedback beyond this is implausible: 24 deg to either side, to within 1."""

SPEED_PLAUSIBLE_MPS: Final = 3.0
"""Speed feedback beyond this is implausible: 2.222 m/s is the top, 2.68 m/s for the outer wheel at full lock."""

SPEED_BIT_MPS: Final = {Variant.COARSE: 0.04, Variant.FINE: 0.001}
"""The smallest speed that the drive command can carry (5 (3))."""

SCALE_RATIO: Final = 40.0  # between the speed scales of the two variants

TURNING_RAW_MIN: Final = 2
"""A drive feedback of this raw value or more is one of a robot that moves, in either scale."""


DBC_FILES: Final = {Variant.COARSE: "cruiser-coarse.dbc", Variant.FINE: "cruiser-fine.dbc"}


def dbc_text(variant: Variant) -> str:
    return Path(__file__).with_name(DBC_FILES[variant]).read_text(encoding="ascii")
