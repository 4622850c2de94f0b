"""The layouts of the chosen chassis's frames. Apart from ``chassis``: to read a log takes no gate or tracker."""

from __future__ import annotations

from typing import Final

from gateway.chassis.cruiser.frames import PLAUSIBLE, load
from gateway.chassis.layout import ChassisLayout, Rule
from schemas.messages import Variant

RULES: Final[tuple[tuple[str, str, Rule], ...]] = PLAUSIBLE
"""The plausible values: feedback frame, signal, rule."""

COMMON: Final = load(Variant.COARSE)
"""The layout for all that does not depend on the variant: identifiers, names, periods."""


def layout(variant: Variant) -> ChassisLayout:
    """Return the layout of a firmware variant."""
    return load(variant)
