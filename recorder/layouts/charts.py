"""The lines that are worth seeing of a robot, for viewers whose layouts are made by code."""

from __future__ import annotations

from typing import Final

import msgspec

from recorder.encoding.foxglove_log import LOG_CHUNK
from schemas.decisions import SafetyEvent, SafetyState
from schemas.messages import GatewayHealth, Message, RobotState
from schemas.subjects import BY_TYPE

BLUE: Final = "#3987e5"
ORANGE: Final = "#e08a1e"
GREEN: Final = "#199e70"
RED: Final = "#e0524d"
GREY: Final = "#8a8f98"


class ChartLine(msgspec.Struct, frozen=True):
    """A field over time.

    Attributes:
        kind: of the message that has the field.
        is_mirrored: drawn below zero too, as a limit to both sides is.
    """

    kind: type[Message]
    field: str
    label: str
    colour: str
    is_mirrored: bool = False


class Chart(msgspec.Struct, frozen=True):
    """Lines that belong together."""

    title: str
    lines: tuple[ChartLine, ...]


SPEED: Final = Chart(
    "speed, m/s",
    (
        ChartLine(RobotState, "speed_mps", "measured", BLUE),
        ChartLine(SafetyState, "target_speed_mps", "asked for", ORANGE),
        ChartLine(SafetyState, "output_speed_mps", "told to the chassis", GREEN),
        ChartLine(SafetyState, "speed_limit_mps", "limit", GREY),
    ),
)
ANGLE: Final = Chart(
    "steering angle, deg",
    (
        ChartLine(RobotState, "angle_deg", "measured", BLUE),
        ChartLine(SafetyState, "target_angle_deg", "asked for", ORANGE),
        ChartLine(SafetyState, "output_angle_deg", "told to the chassis", GREEN),
        ChartLine(SafetyState, "steering_limit_deg", "limit", GREY, is_mirrored=True),
    ),
)
SWITCHES: Final = Chart(
    "engaged, bumpers, parking brake asked for",
    (
        ChartLine(SafetyState, "engaged", "engaged", GREEN),
        ChartLine(RobotState, "front_bumper", "front bumper", RED),
        ChartLine(RobotState, "rear_bumper", "rear bumper", ORANGE),
        ChartLine(SafetyState, "parking", "parking brake asked for", GREY),
    ),
)
LATENESS: Final = Chart(
    "tick lateness, ms",
    (
        ChartLine(GatewayHealth, "tick_lateness_p50_ms", "median", GREEN),
        ChartLine(GatewayHealth, "tick_lateness_p99_ms", "99 %", ORANGE),
        ChartLine(GatewayHealth, "tick_lateness_max_ms", "latest", RED),
    ),
)

STATES: Final = (
    ChartLine(RobotState, "mode", "mode", ""),
    ChartLine(RobotState, "gear_position", "gear", ""),
    ChartLine(SafetyState, "state", "arbiter", ""),
    ChartLine(SafetyState, "stop_phase", "stop", ""),
    ChartLine(SafetyState, "stop_reason", "why stopped", ""),
    ChartLine(SafetyState, "lease_holder", "lease", ""),
)
"""Fields that are no numbers."""


class RobotKeys(msgspec.Struct, frozen=True):
    """Whose log it is.

    Attributes:
        key: what its keys begin with: root and name.
        bus: the CAN bus's name; empty if it is not known.
    """

    key: str
    bus: str = ""

    def topic(self, kind: type[Message]) -> str:
        """The topic of the messages of this class, of which there is one for each robot."""
        return f"{self.key}/{BY_TYPE[kind].name}"

    @property
    def events(self) -> str:
        """The topic that lists events."""
        return f"{self.topic(SafetyEvent)}/{LOG_CHUNK}"
