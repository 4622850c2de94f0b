"""The layout of the Cruiser's frames, in either firmware variant."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from importlib import resources
from typing import Final

import msgspec

from gateway.chassis.layout import ChassisLayout
from schemas.cruiser import DBC_FILES, dbc_text
from schemas.messages import Variant

LAYOUTS: Final = "layouts.json"
"""The file of the layouts. To import cantools and read the DBC took a sixth of a gateway's start."""


class ReadLayout(msgspec.Struct, frozen=True):
    """A layout, and the SHA-256 of the DBC that it was read from."""

    dbc_sha256: str
    layout: ChassisLayout


def digest(variant: Variant) -> str:
    """Return the SHA-256 of a variant's DBC."""
    return sha256(dbc_text(variant).encode("ascii")).hexdigest()


@cache
def load(variant: Variant) -> ChassisLayout:
    """Return the layout of a variant.

    Raises:
        ValueError: it is not that of the DBC beside which it is installed.
    """
    text = resources.files(__package__).joinpath(LAYOUTS).read_bytes()
    read = msgspec.json.decode(text, type=dict[Variant, ReadLayout])[variant]
    if read.dbc_sha256 != digest(variant):
        raise ValueError(f"{LAYOUTS} was not made of this {DBC_FILES[variant]}; 'make generate' makes it anew")
    return read.layout
