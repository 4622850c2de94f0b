"""Which messages of a ROS graph may become drive commands. Pure: the time is an argument.

A command exists only because a message arrived just now. It is passed on once, and never again: if the sender
hangs, the arbiter's deadman stops the robot. The graph is not authenticated, so the checks are against mistakes.
"""

from __future__ import annotations

from collections.abc import Collection
from math import degrees, isfinite
from typing import Any, Final

import msgspec

from gateway.client.link import SetPoint
from schemas.ros import types
from schemas.ros.cdr import CdrError, decode
from schemas.ros.face import time_of
from schemas.ros.wire import read_attachment, type_of

AGE_MAX_NS: Final = 300_000_000
"""A message is dropped if it waited longer here, or if its stamp is further from this computer's clock."""

RECENT_NS: Final = 300_000_000  # commands arrive: the last one came within this time

TOPICS: Final = {
    "cmd_vel": (types.TWIST, types.TWIST_STAMPED),
    "ackermann_cmd": (types.ACKERMANN,),
}
"""The topics of drive commands, below a robot's namespace, with the types that are understood."""


class RosCommand(msgspec.Struct, frozen=True):
    """A message on one of these topics, not yet read.

    Attributes:
        attachment: rmw_zenoh's; it names the publisher.
        arrived_ns: by this computer's monotonic clock.
    """

    key: str
    payload: bytes
    attachment: bytes
    arrived_ns: int


class CommandReader:
    """The drive commands of a robot's topics.

    Attributes:
        note: what is wrong with the newest message, or what was left out of it; empty if it was taken as it is.
    """

    def __init__(self) -> None:
        self.note = ""
        self._gid = b""
        self._engaged_gid: bytes | None = None
        self._last_ns = -RECENT_NS
        self._is_zero = True

    def read(self, command: RosCommand, now_ns: int, wall_ns: int, angle_deg: float) -> SetPoint | None:
        """The set point that a message asks for; None if it is dropped, and ``note`` says why.

        Args:
            now_ns: by the clock of ``arrived_ns``.
            wall_ns: by this computer's clock, since 1970.
            angle_deg: the steering angle that is commanded now, which a turn on the spot keeps.
        """
        if now_ns - command.arrived_ns > AGE_MAX_NS:
            self.note = f"dropped: it waited {(now_ns - command.arrived_ns) / 1e9:.1f} s"
            return None
        try:
            type_name = type_of(command.key)
            message = decode(type_name, command.payload)
        except (ValueError, CdrError) as error:
            self.note = f"dropped: {error}"
            return None
        attachment = read_attachment(command.attachment)
        if attachment is None:
            self.note = "dropped: it has no attachment of rmw_zenoh, which names its publisher"
            return None
        if wrong := _stamp_fault(message, wall_ns):
            self.note = wrong
            return None
        set_point, self.note = _set_point(type_name, message, angle_deg)
        if set_point is None:
            return None
        self._gid, self._last_ns, self._is_zero = attachment.gid, now_ns, not set_point.speed_mps
        return set_point

    def why_not_engage(self, publishers: Collection[str], now_ns: int) -> str:
        """Why the robot may not be engaged for this topic's publisher now; empty if it may.

        Args:
            publishers: the nodes that publish drive commands, by their tokens, each as often as it does.
        """
        if len(publishers) > 1:
            return f"{len(publishers)} publishers send drive commands ({', '.join(sorted(publishers))}): leave one"
        if not self.arrives(now_ns):
            return "no drive command arrives: publish zero speed at 10 Hz or faster, then engage"
        if not self._is_zero:
            return "drive commands that are not zero arrive: publish zero speed, then engage"
        return ""

    def arrives(self, now_ns: int) -> bool:
        return now_ns - self._last_ns <= RECENT_NS

    def moves(self, now_ns: int) -> bool:
        """Commands that are not zero arrive."""
        return self.arrives(now_ns) and not self._is_zero

    def begin(self) -> None:
        """The robot is being engaged: from now on commands of the present publisher alone count."""
        self._engaged_gid = self._gid

    def end(self) -> None:
        self._engaged_gid = None

    @property
    def is_foreign(self) -> bool:
        """Another publisher than the one for which the robot was engaged has sent the newest command."""
        return self._engaged_gid is not None and self._gid != self._engaged_gid

    @property
    def publisher(self) -> str:
        """The identifier of the publisher of the newest command."""
        return self._gid.hex()


def _stamp_fault(message: dict[str, Any], wall_ns: int) -> str:
    """The fault of a message's stamp; empty without one."""
    stamp_ns = time_of(message["header"]) if "header" in message else 0
    late_ns = wall_ns - stamp_ns
    if not stamp_ns or abs(late_ns) <= AGE_MAX_NS:
        return ""
    where = "old" if late_ns > 0 else "ahead of this computer's clock"
    return f"dropped: its stamp is {abs(late_ns) / 1e9:.1f} s {where}; set the clocks, or publish without a stamp"


def _set_point(type_name: str, message: dict[str, Any], angle_deg: float) -> tuple[SetPoint | None, str]:
    """The set point that a message asks for, and a note on it."""
    if type_name == types.ACKERMANN:
        drive = message["drive"]
        speed_mps, turn = drive["speed"], degrees(drive["steering_angle"])
    else:
        twist = message["twist"] if type_name == types.TWIST_STAMPED else message
        speed_mps, turn = twist["linear"]["x"], twist["angular"]["z"]
    if not isfinite(speed_mps) or not isfinite(turn):
        return None, f"dropped: speed {speed_mps}, turn {turn}: not finite"
    if type_name == types.ACKERMANN:
        return SetPoint(speed_mps, angle_deg=turn), ""
    if not speed_mps:
        # At rest wheels are left as they are: a planner that stops shall not turn them.
        note = "it cannot turn on the spot: the steering is kept" if turn else ""
        return SetPoint(0.0, angle_deg=angle_deg), note
    return SetPoint(speed_mps, yaw_rate_radps=turn), ""
