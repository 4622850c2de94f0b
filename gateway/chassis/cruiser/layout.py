"""The layout of the Cruiser's frames, in either firmware variant."""

from __future__ import annotations

from functools import cache

from gateway.chassis.layout import ChassisLayout, read_layout
from schemas.dbc_files import CHASSIS_NODE, dbc_text
from schemas.messages import Variant


@cache
def load(variant: Variant) -> ChassisLayout:
    """Return the layout of a variant, from its DBC.

    Raises:
        ValueError: the DBC says something that is not implemented.
    """
    return read_layout(variant, dbc_text(variant), CHASSIS_NODE)
