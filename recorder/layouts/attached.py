"""The layouts that a recorder attaches to each log.

They are files as the viewers save them, of the robot ``fleet/cruiser-1`` on the bus ``can0``: open one, change it
in the viewer, and save it here. ``foxglove.json`` is for Foxglove and Lichtblick.
"""

from __future__ import annotations

import re
from importlib import resources
from typing import Final

import msgspec

from schemas import keys

_KEY: Final = "fleet/cruiser-1/"
_BUS: Final = "/can/can0/"
_FILES: Final = {
    "layout.foxglove.json": ("foxglove.json", "application/json"),
    "layout.plotjuggler.xml": ("plotjuggler.xml", "application/xml"),
}
_TEMPLATES: Final = {
    name: resources.files("recorder.layouts").joinpath(file).read_text("utf-8")
    for name, (file, _) in _FILES.items()
}

COUNT: Final = len(_FILES)  # number of files that ``layouts`` returns


class RobotKeys(msgspec.Struct, frozen=True):
    """The robot of a log: the beginning of its keys, and the CAN bus's name, empty if unknown."""

    key: str
    bus: str = ""


class ViewerLayout(msgspec.Struct, frozen=True):
    """A layout as a file."""

    name: str
    media_type: str
    data: bytes


def layouts(robot: RobotKeys) -> list[ViewerLayout]:
    """The layouts of a robot's log that need no viewer's package."""
    # The bus's name is untrusted.
    bus = f"/can/{robot.bus}/" if re.fullmatch(keys.BUS_PATTERN, robot.bus) else _BUS
    return [
        ViewerLayout(name, media_type, _TEMPLATES[name].replace(_BUS, bus).replace(_KEY, f"{robot.key}/").encode())
        for name, (_, media_type) in _FILES.items()
    ]
