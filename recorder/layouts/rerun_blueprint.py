"""A blueprint for rerun: the panels of the layout for Foxglove, and the switches.

It needs rerun's package, which is large: so it is made on demand, and recorders do not attach it. It selects the
fields to draw by a new interface of rerun, which may change.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import rerun
import rerun.blueprint as blueprints
from msgspec import inspect
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from recorder.encoding.protobuf import fields, schema_name
from recorder.layouts.attached import RobotKeys, layouts
from schemas import keys

NAME: Final = "layout.rerun.rbl"

PANELS: Final = {
    "speed": "Plot!speed",
    "angle": "Plot!angle",
    "lateness": "Plot!lateness",
    "states": "StateTransitions!states",
}
"""Views of the blueprint, and the panels of Foxglove's layout that they show."""

_PATH: Final = re.compile(r'"([^"]+)"\.(\w+)')  # topic and field of a Foxglove message path without a modifier

_EYE_M: Final = (-4, -3.2, 3.2)  # the camera's place, 6 m away: behind the robot, right and above

_SCALARS: Final = "Scalars:scalars"
_STATE: Final = "StateChange:state"


class ChartLine(msgspec.Struct, frozen=True):
    """A field of a topic over time."""

    topic: str
    field: str
    label: str
    colour: str = ""


def chart_lines(robot: RobotKeys) -> dict[str, list[ChartLine]]:
    """Return the lines of each view of a robot's log."""
    panels = json.loads(layouts(robot)[0].data)["configById"]
    return {view: _lines(panels[panel]) for view, panel in PANELS.items()} | {
        "switches": [
            ChartLine(f"{robot.key}/safety/state", "engaged", "engaged", "#199e70"),
            ChartLine(f"{robot.key}/state", "front_bumper", "front bumper", "#e0524d"),
            ChartLine(f"{robot.key}/state", "rear_bumper", "rear bumper", "#e08a1e"),
            ChartLine(f"{robot.key}/safety/state", "parking", "parking brake asked for", "#8a8f98"),
        ]
    }


def _lines(panel: dict[str, Any]) -> list[ChartLine]:
    matches = ((path, _PATH.fullmatch(path["value"])) for path in panel["paths"])
    return [ChartLine(one[1], one[2], path["label"], path.get("color", "")) for path, one in matches if one]


def save_blueprint(robot: RobotKeys, application: str, path: Path) -> None:
    """Write the blueprint of a robot's log; ``application`` is the name under which rerun opens it."""
    lines = chart_lines(robot)
    rows = blueprints.Vertical(
        _plot("speed, m/s", lines["speed"]),
        _plot("steering angle, deg", lines["angle"]),
        _plot("engaged, bumpers, parking brake asked for", lines["switches"]),
        _states(lines["states"]),
        row_shares=[2.5, 2.5, 1.5, 3.5],
    )
    texts = blueprints.Vertical(
        _scene(robot),
        blueprints.TextLogView(origin=f"/{robot.key}/safety/event/log", name="events"),
        _plot("tick lateness, ms", lines["lateness"]),
        row_shares=[3, 3, 1],
    )
    layout = blueprints.Horizontal(rows, texts, column_shares=[3, 2])
    time_panel = blueprints.TimePanel(timeline="message_log_time", state="collapsed")
    made = blueprints.Blueprint(layout, time_panel, collapse_panels=True)
    made.save(application, path)


def _scene(robot: RobotKeys) -> blueprints.Spatial3DView:
    """The robot's frame as axes, x forward: rerun draws no outline of ours."""
    frames = f"/{robot.key}/chassis/odometry/tf"
    axes = rerun.TransformAxes3D(1.0).visualizer()
    return blueprints.Spatial3DView(
        origin="/",
        contents=[frames],
        name="the robot by its odometry; x (red) is forward",
        overrides={frames: axes},
        spatial_information=blueprints.SpatialInformation(f"{robot.key}/odom"),
        eye_controls=blueprints.EyeControls3D(position=_EYE_M, look_target=(0, 0, 0), tracking_entity=frames),
    )


def _plot(title: str, lines: Sequence[ChartLine]) -> blueprints.TimeSeriesView:
    """A plot with one visualiser for each line of a topic."""
    overrides: dict[str, list[Any]] = {}
    for line in lines:
        series = rerun.SeriesLines(names=line.label, colors=int(f"{line.colour[1:]}ff", 16))
        drawn = series.visualizer(mappings=[mapping_of(line, _SCALARS)])
        overrides.setdefault(f"/{line.topic}", []).append(drawn)
    return blueprints.TimeSeriesView(origin="/", contents=list(overrides), name=title, overrides=overrides)


def _states(lines: Sequence[ChartLine]) -> blueprints.StateTimelineView:
    overrides: dict[str, list[Any]] = {}
    for line in lines:
        drawn = rerun.StateChange.from_fields().visualizer(mappings=[mapping_of(line, _STATE)])
        overrides.setdefault(f"/{line.topic}", []).append(drawn)
    return blueprints.StateTimelineView(origin="/", contents=list(overrides), name="states", overrides=overrides)


def mapping_of(line: ChartLine, target: str) -> VisualizerComponentMapping:
    """Map a line's field to the component ``target`` of a visualiser."""
    parts = keys.parse(line.topic)
    if parts is None:
        raise AssertionError(f"the layout has a path to {line.topic}, which is no topic of a robot")
    kind = parts.subject.type
    # rerun turns an enumeration into a struct of name and number.
    is_enum = any(name == line.field and isinstance(one, inspect.EnumType) for name, _, one in fields(kind))
    return VisualizerComponentMapping(
        target,
        ComponentSourceKind.SourceComponent,
        source_component=f"{schema_name(kind)}:message",
        selector=f".{line.field}{'.name' if is_enum else ''}",
    )
