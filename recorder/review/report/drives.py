"""The drives of a robot, in memory that does not grow with them: times of being commanded, or of moving.

Between two drives the robot rested for longer than REST_NS, or nothing is known of it.
"""

from __future__ import annotations

from typing import Final

import msgspec

from recorder.review.entries import Entry
from recorder.review.report.findings import ReportedDrive
from schemas.decisions import Severity

REST_NS: Final = 600_000_000_000
"""A rest that is shorter belongs to the drive."""

MARGIN_NS: Final = 10_000_000_000
"""The time before and behind a drive that belongs to it: what led to it, and how its stop ended."""

DRIVES_MAX: Final = 500

_RANKS: Final = {Severity.INFO: 0, Severity.WARNING: 1, Severity.ERROR: 2}


class _Gathered(msgspec.Struct):
    """A drive so far."""

    start_ns: int
    end_ns: int
    log_start_ns: int
    log_end_ns: int
    distance_m: float = 0.0
    stops: int = 0
    worst: Severity = Severity.INFO
    worst_text: str = ""


class Drives:
    """Gathers the drives of a robot.

    Attributes:
        more: drives for which there was no room.
    """

    def __init__(self) -> None:
        self.more = 0
        self._found: list[_Gathered] = []
        self._now: _Gathered | None = None

    def add(self, time_ns: int, log_ns: int, grew_m: float = 0.0) -> None:
        """It was commanded or moved at this time of its clock, received at that log time, and went so far."""
        now = self._now
        if now is None or not now.start_ns - REST_NS <= time_ns <= now.end_ns + REST_NS:
            now = self._now = _Gathered(time_ns, time_ns, log_ns, log_ns)
            if len(self._found) < DRIVES_MAX:
                self._found.append(now)
            else:
                self.more += 1
        now.start_ns, now.end_ns = min(now.start_ns, time_ns), max(now.end_ns, time_ns)
        now.log_start_ns, now.log_end_ns = min(now.log_start_ns, log_ns), max(now.log_end_ns, log_ns)
        now.distance_m += grew_m

    def take_entry(self, entry: Entry) -> None:
        """An entry of the timeline: it belongs to the drive of its time, if any."""
        for one in reversed(self._found):
            if one.start_ns - MARGIN_NS <= entry.time_ns <= one.end_ns + MARGIN_NS:
                one.stops += entry.is_stop
                if _RANKS[entry.severity] > _RANKS[one.worst]:
                    one.worst, one.worst_text = entry.severity, entry.text
                return

    def drives(self) -> list[ReportedDrive]:
        """The drives, by time."""
        found = [
            ReportedDrive(
                start_ns=one.start_ns,
                end_ns=one.end_ns,
                log_start_ns=one.log_start_ns,
                log_end_ns=one.log_end_ns,
                distance_m=one.distance_m,
                stops=one.stops,
                severity=one.worst.value,
                worst=one.worst_text,
            )
            for one in self._found
        ]
        return sorted(found, key=lambda one: one.start_ns)
