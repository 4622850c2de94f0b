"""Ways through the page: from an event to its moment, a stop to its reason, a drive to its own report."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from typing import Final
from urllib.parse import quote

from recorder.reading.times import in_words
from recorder.review.report.drives import MARGIN_NS
from recorder.review.report.findings import Moment, Report, ReportedDrive, RobotSummary, Why
from recorder.review.report.markup import text

_SEVERAL: Final = 2
_MS: Final = 1_000_000

Whys = Mapping[tuple[str, int], Why]
"""The reasons of stops, by the key of the robot and the time of the stop."""


class PageLinks:
    """Leads from an event to its moment on the page, and from a stop to its reason.

    Args:
        report: all of it.
        whys: the reasons that are on the page.
        logs: the logs, as a shell has them.
    """

    def __init__(self, report: Report, whys: Whys, logs: str) -> None:
        self._whys = whys
        self._logs = logs
        self._is_alone = len({robot.summary.name for robot in report.robots}) < _SEVERAL
        self._drawn: dict[str, list[tuple[int, int]]] = {}
        for one in report.drawn:
            self._drawn.setdefault(one.summary.key, []).append(_axis(one.summary))

    def at(self, robot: RobotSummary, time_ns: int, words: str) -> str:
        """A link to a moment; the words alone where it is not drawn."""
        if not self.is_drawn(robot, time_ns):
            return text(words)
        named = "" if self._is_alone else f"&robot={quote(robot.name, safe='')}"
        return f'<a href="{text(f"#t={iso(time_ns)}{named}")}">{text(words)}</a>'

    def is_drawn(self, robot: RobotSummary, time_ns: int) -> bool:
        """Report whether a moment of a robot is on some time axis."""
        return any(from_ns <= time_ns <= to_ns for from_ns, to_ns in self._drawn.get(robot.key, ()))

    def command(self, robot: str, drive: ReportedDrive) -> str:
        """The command that makes the report of one drive."""
        from_ns, to_ns = max(0, drive.log_start_ns - MARGIN_NS), drive.log_end_ns + MARGIN_NS
        file = shlex.quote(f"{robot}-{re.sub('[-:]', '', iso(drive.start_ns)[:19])}Z.html".replace("/", "-"))
        period = f"--from {iso(from_ns)} --to {iso(to_ns)}"
        return f"cruiser review report {self._logs} --robot {shlex.quote(robot)} {period} -o {file}"

    def why(self, robot: RobotSummary, stop: Moment) -> Why | str:
        """The reason of a stop; the command that finds it where it was not looked for."""
        found = self._whys.get((robot.key, stop.time_ns))
        return (
            found or f"cruiser review why {self._logs} --robot {shlex.quote(robot.name)} --at {iso(stop.time_ns)}"
        )


def _axis(summary: RobotSummary) -> tuple[int, int]:
    """The first and the last time that its player reaches: whole milliseconds."""
    return summary.start_ns // _MS * _MS, -(-summary.end_ns // _MS) * _MS


def iso(time_ns: int) -> str:
    """A time in ISO 8601, with the precision that browsers know."""
    return in_words(time_ns).removesuffix(" UTC").replace(" ", "T") + "Z"
