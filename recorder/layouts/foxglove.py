"""A layout for Foxglove and Lichtblick: both open the same JSON.

Its form is that of Lichtblick's source (packages/suite-base: LayoutData, and the configurations of the panels).
There is no map: the log holds no position, and neither viewer integrates one.
"""

from __future__ import annotations

from typing import Any, Final

import msgspec

from recorder.layouts.charts import ANGLE, LATENESS, SPEED, STATES, Chart, Line, Robot
from schemas.messages import GatewayHealth, RobotState

NAME: Final = "layout.foxglove.json"
MEDIA_TYPE: Final = "application/json"

Panel = dict[str, Any]


def foxglove_layout(robot: Robot) -> bytes:
    """The layout of a robot's log, as JSON."""
    panels: dict[str, Panel] = {
        "Plot!speed": _plot(SPEED, robot),
        "Plot!angle": _plot(ANGLE, robot),
        "Plot!lateness": _plot(LATENESS, robot),
        "StateTransitions!states": _states(robot),
        "RosOut!events": {"searchTerms": [], "minLogLevel": 1, "topicToRender": robot.events},
        "RawMessages!state": _raw(_path(robot.topic(RobotState))),
        "RawMessages!safety": _raw(_path(robot.topic(STATES[2].kind))),
        "Table!health": {"topicPath": f"{_path(robot.topic(GatewayHealth))}.feedback[:]"},
    }
    right = _split("column", "RawMessages!state", "RawMessages!safety", 50)
    if robot.frames:
        panels["RawMessages!frames"] = _raw(_path(robot.frames))
        right = _split("column", right, "RawMessages!frames", 70)
    left = _split(
        "column",
        _split("column", "Plot!speed", "Plot!angle", 50),
        _split("column", "StateTransitions!states", "RosOut!events", 50),
        55,
    )
    right = _split("column", right, _split("column", "Table!health", "Plot!lateness", 50), 60)
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", left, right, 68),
    }
    return msgspec.json.format(msgspec.json.encode(layout), indent=1) + b"\n"


def _path(topic: str, field: str = "", modifier: str = "") -> str:
    """A message path. The topic is quoted: a root or a bus may hold a point, which would end it."""
    return f'"{topic}"{f".{field}" if field else ""}{modifier}'


def _plot(chart: Chart, robot: Robot) -> Panel:
    return {
        "foxglovePanelTitle": chart.title,
        "paths": [
            _series(line, robot, modifier)
            for line in chart.lines
            for modifier in (("", ".@negative") if line.is_mirrored else ("",))
        ],
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def _series(line: Line, robot: Robot, modifier: str) -> Panel:
    return {
        "value": _path(robot.topic(line.kind), line.field, modifier),
        "enabled": True,
        "label": line.label,
        "color": line.colour,
        "timestampMethod": "receiveTime",
    }


def _states(robot: Robot) -> Panel:
    return {
        "foxglovePanelTitle": "states",
        "isSynced": True,
        "paths": [
            {
                "value": _path(robot.topic(line.kind), line.field),
                "label": line.label,
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for line in STATES
        ],
    }


def _raw(path: str) -> Panel:
    return {"topicPath": path, "diffEnabled": False, "diffTopicPath": "", "showFullMessageForDiff": False}


def _split(direction: str, first: Any, second: Any, percentage: int) -> Panel:  # noqa: ANN401 - panel or split
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}
