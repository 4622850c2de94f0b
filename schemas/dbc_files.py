"""The DBC files: their names and their text.

``make generate`` makes ``gateway/chassis/cruiser/layouts.json`` of them, from which the frames are read.
"""

from __future__ import annotations

from importlib import resources
from typing import Final

from schemas.messages import Variant

DBC_FILES: Final = {Variant.COARSE: "cruiser-coarse.dbc", Variant.FINE: "cruiser-fine.dbc"}


def dbc_text(variant: Variant) -> str:
    """The text of a variant's DBC.

    Raises:
        KeyError: the variant is unknown.
    """
    return resources.files("schemas").joinpath(DBC_FILES[variant]).read_text(encoding="ascii")
