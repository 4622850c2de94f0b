"""The end of what logs hold of a robot: a gateway that fell silent before it, or one that was at work."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec

from recorder.review.timeline.entries import Entry, EntryKind, EntrySource
from recorder.review.timeline.robot_track import RobotTrack
from schemas.decisions import Severity

SILENT_NS: Final = 1_000_000_000
"""The arbiter's state comes 20 times a second; without it for so long, what happened meanwhile is not known."""


class LogEnding(msgspec.Struct, frozen=True):
    """The end of a robot's log.

    Attributes:
        entry: that in words.
        is_silent: the gateway fell silent, and the log continues; else the log ends.
        is_commanding: the chassis was under command in the gateway's last message.
    """

    entry: Entry
    is_silent: bool
    is_commanding: bool


def ending(robot: RobotTrack, spans: Sequence[tuple[int, int]], to_ns: int) -> LogEnding | None:
    """Return a notable end of a robot's log; None if it ended as it should.

    Args:
        robot: all that was read of it.
        spans: the first and the last log time of each log that holds it. Between two of them nobody was there to
            hear the gateway.
        to_ns: the first log time that was not read.
    """
    ends = [end_ns for start_ns, end_ns in spans if start_ns < to_ns]
    if robot.state is None or robot.is_ended or not ends:
        return None
    silent_ns = min(max(ends), to_ns) - robot.state_log_ns
    is_silent = silent_ns > SILENT_NS
    if is_silent:
        seconds = f"{silent_ns / 1e9:.1f} s"
        text = f"nothing of the arbiter for {seconds}, up to the end: the gateway fell silent, {robot.left}"
    elif robot.is_active and max(ends) < to_ns:
        text = f"the log ends here: {robot.left}"
    else:
        return None
    entry = Entry(
        time_ns=robot.state_ns,
        last_ns=robot.state_ns + (silent_ns if is_silent else 0),
        robot=robot.name,
        kind=EntryKind.GAP,
        severity=Severity.ERROR if is_silent and robot.is_active else Severity.WARNING,
        source=EntrySource.LOG,
        text=text,
    )
    return LogEnding(entry, is_silent, robot.is_active)
