"""A blueprint for rerun.

It can only be made with rerun's own package, which is large; so no recorder attaches it, and it is made from a
log when it is wanted. It tells by a selector which field of a message is the number or the state to draw; that is
younger than most of rerun, and may change with it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import rerun
import rerun.blueprint as blueprints
from msgspec import inspect
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from recorder.encoding.protobuf_schema import fields, schema_name
from recorder.layouts.charts import ANGLE, LATENESS, SPEED, STATES, SWITCHES, Chart, ChartLine, RobotKeys

NAME: Final = "layout.rerun.rbl"

_SCALARS: Final = "Scalars:scalars"
_STATE: Final = "StateChange:state"


def save_blueprint(robot: RobotKeys, application: str, path: Path) -> None:
    """Write the blueprint of a robot's log.

    Args:
        robot: whose log it is.
        application: the name under which rerun opens the log: blueprints are kept by it.
        path: where to.
    """
    rows = blueprints.Vertical(
        *(_plot(chart, robot) for chart in (SPEED, ANGLE, SWITCHES)),
        _states(robot),
        row_shares=[2.5, 2.5, 1.5, 3.5],
    )
    texts = blueprints.Vertical(
        blueprints.TextLogView(origin=f"/{robot.events}", name="events"),
        _plot(LATENESS, robot),
        row_shares=[3, 1],
    )
    layout = blueprints.Horizontal(rows, texts, column_shares=[3, 2])
    time_panel = blueprints.TimePanel(timeline="message_log_time", state="collapsed")
    made = blueprints.Blueprint(layout, time_panel, collapse_panels=True)
    made.save(application, path)


def _plot(chart: Chart, robot: RobotKeys) -> blueprints.TimeSeriesView:
    """Several lines of one topic are several visualisers of it."""
    overrides: dict[str, list[Any]] = {}
    for line in chart.lines:
        series = rerun.SeriesLines(names=line.label, colors=int(f"{line.colour[1:]}ff", 16))
        drawn = series.visualizer(mappings=[mapping_of(line, _SCALARS)])
        overrides.setdefault(f"/{robot.topic(line.kind)}", []).append(drawn)
    return blueprints.TimeSeriesView(origin="/", contents=list(overrides), name=chart.title, overrides=overrides)


def _states(robot: RobotKeys) -> blueprints.StateTimelineView:
    overrides: dict[str, list[Any]] = {}
    for line in STATES:
        drawn = rerun.StateChange.from_fields().visualizer(mappings=[mapping_of(line, _STATE)])
        overrides.setdefault(f"/{robot.topic(line.kind)}", []).append(drawn)
    return blueprints.StateTimelineView(origin="/", contents=list(overrides), name="states", overrides=overrides)


def mapping_of(line: ChartLine, target: str) -> VisualizerComponentMapping:
    """Where a visualiser finds what it draws; ``target`` is the name by which it asks for that."""
    # Of an enumeration rerun makes a struct with its name and its number.
    kinds = {name: kind for name, _, kind in fields(line.kind)}
    is_enum = isinstance(kinds[line.field], inspect.EnumType)
    return VisualizerComponentMapping(
        target,
        ComponentSourceKind.SourceComponent,
        source_component=f"{schema_name(line.kind)}:message",
        selector=f".{line.field}{'.name' if is_enum else ''}",
    )
