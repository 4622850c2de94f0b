"""The Cruiser's figures (manual V2.0, 2.2 and 5) and its DBC files.

``make generate`` makes ``gateway/chassis/cruiser/layouts.json`` from the DBC files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from schemas.messages import Variant

WHEELBASE_M: Final = 0.660
TRACK_M: Final = 0.606  # between the middles of the wheels of an axle
WHEEL_RADIUS_M: Final = 0.210

SPEED_TOP_MPS: Final = 2.222  # the chassis drives no faster, either way: 8 km/h
STEERING_TOP_DEG: Final = 24.0  # the chassis steers no further, to either side

STEERING_PLAUSIBLE_DEG: Final = 25.0  # steering feedback beyond this is implausible: 24 deg, within 1 deg
SPEED_PLAUSIBLE_MPS: Final = 3.0  # so is speed feedback: at full lock the outer wheel has 2.68 m/s at top speed

SPEED_BIT_MPS: Final = {Variant.COARSE: 0.04, Variant.FINE: 0.001}  # resolution of the drive command (5 (3))
SCALE_RATIO: Final = 40.0  # between the speed scales of the two variants
TURNING_RAW_MIN: Final = 2  # in either scale, a raw drive feedback of this or more means motion

DBC_FILES: Final = {Variant.COARSE: "cruiser-coarse.dbc", Variant.FINE: "cruiser-fine.dbc"}


def dbc_text(variant: Variant) -> str:
    return Path(__file__).with_name(DBC_FILES[variant]).read_text(encoding="ascii")
