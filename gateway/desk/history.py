"""The last minutes of each robot: what was asked, told and measured, one point each period. Pure."""

from __future__ import annotations

import math
from array import array
from typing import Final

from gateway.client.fleet import RobotStatus
from gateway.desk.words import DeskHistory

PERIOD_NS: Final = 200_000_000

LENGTH: Final = 1500
"""Points of a robot: five minutes."""

FIELDS: Final = ("asked_mps", "told_mps", "speed_mps", "limit_mps", "asked_deg", "told_deg", "angle_deg")
"""The setpoint, the command to the chassis, the feedback and the limit; then the same of the steering angle."""

_KEPT: Final = LENGTH * len(FIELDS)


class Histories:
    """The newest points of each robot."""

    def __init__(self) -> None:
        # Single precision, six times as compact as tuples: a thousand robots take 84 MB at most.
        self._points: dict[str, array[float]] = {}
        self._newest_ns: dict[str, int] = {}

    def add(self, report: RobotStatus, now_ns: int) -> None:
        """Take in a robot as it is now."""
        state, safety = report.state, report.safety
        measured = (None, None) if state is None else (state.speed_mps, state.angle_deg)
        limit = None if safety is None else safety.travel_speed_limit_mps
        point = (
            *((None, None) if safety is None else (safety.target_speed_mps, safety.output_speed_mps)),
            measured[0],
            None if safety is None else min(safety.speed_limit_mps, limit or safety.speed_limit_mps),
            *((None, None) if safety is None else (safety.target_angle_deg, safety.output_angle_deg)),
            measured[1],
        )
        points = self._points.setdefault(report.robot, array("f"))
        points.extend(math.nan if value is None else value for value in point)
        if len(points) >= 2 * _KEPT:
            del points[:_KEPT]
        self._newest_ns[report.robot] = now_ns

    def keep(self, robots: list[str]) -> None:
        """Forget all but these."""
        for robot in self._points.keys() - set(robots):
            del self._points[robot], self._newest_ns[robot]

    def of(self, robot: str, now_ns: int) -> DeskHistory:
        """Return the points of a robot."""
        points = self._points.get(robot, array("f"))[-_KEPT:]
        age_s = (now_ns - self._newest_ns.get(robot, now_ns)) / 1e9
        return DeskHistory(
            robot,
            age_s,
            {
                name: [None if math.isnan(value) else value for value in points[at :: len(FIELDS)]]
                for at, name in enumerate(FIELDS)
            },
        )
