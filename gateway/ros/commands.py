"""Which messages of a ROS graph may become drive commands. Pure: the time is an argument.

A command exists only because a message arrived just now. It is passed on once, and never again: if the sender
hangs, the arbiter's deadman stops the robot. The graph is not authenticated, so the checks are against mistakes.
"""

from __future__ import annotations

from collections.abc import Collection
from math import degrees, isfinite
from typing import Any, Final

from gateway.client.link import SetPoint
from gateway.telemetry.samples import Received
from schemas.command_line import short
from schemas.ros import types
from schemas.ros.cdr import CdrError, decode
from schemas.ros.face import time_of
from schemas.ros.wire import Attachment, read_attachment, type_of

AGE_MAX_NS: Final = 300_000_000
"""A message is dropped if it waited longer here, or if its stamp is further from this computer's clock."""

RECENT_NS: Final = 300_000_000  # commands arrive: the last one came within this time

DRIFT: Final = 1000
"""One part in so many by which a publisher's clock may run off ours before its messages count as late.

NTP changes a clock's rate by 1 in 2000 at most; a queue that grows faster than this is found.
"""

TOPICS: Final = {
    "cmd_vel": (types.TWIST, types.TWIST_STAMPED),
    "ackermann_cmd": (types.ACKERMANN,),
}
"""The topics of drive commands, below a robot's namespace, with the types that are understood."""


class CommandReader:
    """The drive commands of a robot's topics.

    Attributes:
        note: what is wrong with the newest message, or what was left out of it; empty if it was taken as it is.
        foreign: another publisher than the one for which the robot was engaged, which sent something since.
    """

    def __init__(self) -> None:
        self.note = ""
        self.foreign = ""
        self._gid = b""
        self._sequence = 0
        self._fastest: tuple[bytes, int, int] | None = None
        self._engaged_gid: bytes | None = None
        self._is_confirmed = False
        self._last_ns = -RECENT_NS
        self._is_zero = True

    def read(
        self, command: Received, arrived_ns: int, now_ns: int, wall_ns: int, angle_deg: float
    ) -> SetPoint | None:
        """The set point that a message of TOPICS asks for; None if it is dropped, and ``note`` says why.

        Args:
            arrived_ns, now_ns: by a clock of this computer that also runs while it is suspended.
            wall_ns: by this computer's clock, since 1970.
            angle_deg: the steering angle that is commanded now, which a turn on the spot keeps.
        """
        set_point, self.note = self._judge(command, arrived_ns, now_ns, wall_ns, angle_deg)
        if set_point is not None:
            self._last_ns, self._is_zero = now_ns, not set_point.speed_mps
        return set_point

    def _judge(
        self, command: Received, arrived_ns: int, now_ns: int, wall_ns: int, angle_deg: float
    ) -> tuple[SetPoint | None, str]:
        attachment = read_attachment(command.attachment)
        if attachment is not None and self._engaged_gid not in {None, attachment.gid}:
            self.foreign = attachment.gid.hex()
            return None, "dropped: it comes from a second publisher"
        if now_ns - arrived_ns > AGE_MAX_NS:
            return None, f"dropped: it waited {(now_ns - arrived_ns) / 1e9:.1f} s"
        try:
            type_name = type_of(command.key)
            if type_name not in TOPICS.get(command.key.split("/")[-3], ()):
                # Not decoded: it may be long.
                return None, f"dropped: {type_name} is not taken on this topic"
            message = decode(type_name, command.payload)
        except (ValueError, CdrError) as error:
            return None, f"dropped: {short(str(error))}"
        if attachment is None:
            return None, "dropped: it has no attachment of rmw_zenoh, which names its publisher"
        if wrong := _stamp_fault(message, wall_ns) or self._repeat_or_late(attachment, arrived_ns):
            return None, wrong
        set_point, note = _set_point(type_name, message, angle_deg)
        if set_point is not None:
            self._gid, self._sequence = attachment.gid, attachment.sequence
        return set_point, note

    def _repeat_or_late(self, attachment: Attachment, arrived_ns: int) -> str:
        """A message that came before, or that waited in a queue while the router or this process hung."""
        gid = attachment.gid
        if gid == self._gid and attachment.sequence <= self._sequence and self.arrives(arrived_ns):
            return f"dropped: message {attachment.sequence} of its publisher again"
        if attachment.time_ns <= 0:
            return "dropped: its attachment has no time"
        # The clocks need not agree: the fastest message of the same publisher is the measure.
        offset_ns = least_ns = arrived_ns - attachment.time_ns
        if self._fastest is not None and self._fastest[0] == gid:
            _, before_ns, seen_ns = self._fastest
            least_ns = min(offset_ns, before_ns + (arrived_ns - seen_ns) // DRIFT)
        self._fastest = gid, least_ns, arrived_ns
        late_ns = offset_ns - least_ns
        if late_ns <= AGE_MAX_NS:
            return ""
        return (
            f"dropped: it was {late_ns / 1e9:.1f} s on its way; if its clock was set back, restart the publisher"
        )

    def why_not_engage(self, publishers: Collection[str], now_ns: int) -> str:
        """Why the robot may not be engaged for this topic's publisher now; empty if it may.

        Args:
            publishers: the nodes that publish drive commands, by their tokens, each as often as it does.
        """
        if len(publishers) > 1:
            names = short(", ".join(sorted(publishers)))
            return f"{len(publishers)} publishers send drive commands ({names}): leave one"
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

    def begin(self, publishers: Collection[str], now_ns: int) -> str:
        """Begin to engage the robot for the present publisher. Returns why it may not be; empty if it may."""
        gid = self._gid
        why = self.why_not_engage(publishers, now_ns)
        if not why:
            self._is_confirmed, self._engaged_gid, self.foreign = False, gid, ""
        return why

    def confirm(self, publishers: Collection[str], now_ns: int) -> str:
        """Let all commands pass, since the robot is engaged now. Returns why they may not; empty if they may."""
        if self._engaged_gid is None:
            return "it was stopped meanwhile"
        if self.foreign:
            return f"a second publisher sends drive commands ({self.foreign})"
        why = self.why_not_engage(publishers, now_ns)
        self._is_confirmed = not why
        return why

    def end(self) -> None:
        """Let no command pass until the robot is engaged again."""
        self._engaged_gid, self.foreign = None, ""

    def admit(self, set_point: SetPoint, angle_deg: float) -> SetPoint | None:
        """The set point as it may pass; while the robot is being engaged, zero speed with the wheels kept."""
        if self._engaged_gid is None or not (self._is_confirmed or not set_point.speed_mps):
            return None
        return set_point if self._is_confirmed else SetPoint(0.0, angle_deg=angle_deg)


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
