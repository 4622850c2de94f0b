"""The layouts that a recorder attaches to each log."""

from __future__ import annotations

from typing import Final

import msgspec

from recorder.layouts import foxglove, plotjuggler
from recorder.layouts.charts import Robot


class Layout(msgspec.Struct, frozen=True):
    """A layout as a file.

    Attributes:
        name: of the file.
    """

    name: str
    media_type: str
    data: bytes


COUNT: Final = 2
"""So many does ``layouts`` make."""


def layouts(robot: Robot) -> list[Layout]:
    """The layouts of a robot's log that need no viewer's own code to be made."""
    return [
        Layout(foxglove.NAME, foxglove.MEDIA_TYPE, foxglove.foxglove_layout(robot)),
        Layout(plotjuggler.NAME, plotjuggler.MEDIA_TYPE, plotjuggler.plotjuggler_layout(robot)),
    ]
