"""The charts of a robot, as plotly wants them: plain dictionaries, which a test holds to plotly's own rules.

Their layouts stand in ``charts.json``; ``page.js`` sets the colours of light and dark. Texts from the log are
escaped: plotly reads tags in them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from html import escape
from importlib.resources import files
from typing import Any, Final

import msgspec

from recorder.review.report.findings import Moment, RobotCharts
from recorder.review.report.odometry import Place
from recorder.review.report.words import moment_words, reason_words
from schemas.printable import plain

Figure = dict[str, Any]

BLUE: Final = "#3987e5"
ORANGE: Final = "#e08a1e"
GREEN: Final = "#199e70"
RED: Final = "#e0524d"
VIOLET: Final = "#9085e9"
GREY: Final = "#8a8f98"
OLIVE: Final = "#b5a000"

COLOURS: Final = {
    "auto": GREEN,
    "remote": VIOLET,
    "stop": GREY,
    "standby": GREY,
    "engaging": OLIVE,
    "engaged": GREEN,
    "stopping": RED,
}
"""Of the bands' values; others take their turns of PALETTE."""

PALETTE: Final = (BLUE, ORANGE, VIOLET, OLIVE, GREEN)

MARKS: Final = {
    "stop": ("square", RED),
    "latch": ("diamond-open", RED),
    "fault": ("x", ORANGE),
    "guard": ("star", RED),
    "takeover": ("triangle-up", VIOLET),
    "lease": ("circle-open", BLUE),
    "engaged": ("circle", GREEN),
    "stopped": ("square-open", GREY),
    "end": ("square", GREY),
    "reset": ("diamond-open", BLUE),
    "gateway": ("cross", RED),
    "gap": ("line-ns", RED),
    "clock": ("diamond-tall", ORANGE),
    "recorder": ("pentagon-open", GREY),
}
"""Symbol and colour of each kind of event; the symbols differ too, for people who cannot distinguish colours."""

ON_MAP: Final = frozenset({"stop", "latch", "fault", "guard", "takeover", "gateway", "gap"})

STOP_LINES_MAX: Final = 40
"""More lines across the charts would hide them: then there are none."""

LINES: Final = (
    ("y", "m/s", "speed_limit_mps", "limit", GREY, "dot"),
    ("y", "m/s", "target_speed_mps", "asked for", ORANGE, "dash"),
    ("y", "m/s", "output_speed_mps", "told to the chassis", GREEN, "solid"),
    ("y", "m/s", "speed_mps", "measured", BLUE, "solid"),
    ("y2", "deg", "steering_limit_deg", "limit", GREY, "dot"),
    ("y2", "deg", "target_angle_deg", "asked for", ORANGE, "dash"),
    ("y2", "deg", "output_angle_deg", "told to the chassis", GREEN, "solid"),
    ("y2", "deg", "angle_deg", "measured", BLUE, "solid"),
)
"""Axis, unit, name in the charts, name in the legend, colour and dashes of each line."""

_LAYOUTS: Final[dict[str, Figure]] = msgspec.json.decode((files(__package__) / "charts.json").read_bytes())


def shown(text: str) -> str:
    """A text of the log as plotly shows it: tags as text, no character that rules the page."""
    return escape(plain(text), quote=False)


def clock(time_ns: int) -> str:
    """The time of day, UTC."""
    try:
        return f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%H:%M:%S}.{time_ns % 10**9 // 10**6:03d}"
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"


def over_time(charts: RobotCharts) -> Figure:
    """Speed, angle, bands and events over one time axis; stops and outages of the gateway across all of it."""
    stops = [(moment.time_ns, moment.time_ns) for moment in charts.moments if moment.kind == "stop"]
    shaded = {"type": "rect", "fillcolor": RED, "opacity": 0.15, "line": {"width": 0}}
    dotted = {"type": "line", "line": {"color": RED, "width": 1, "dash": "dot"}}
    shapes = [
        {
            "xref": "x",
            "yref": "paper",
            "x0": _ms(from_ns),
            "x1": _ms(to_ns),
            "y0": 0,
            "y1": 1,
            **look,
            "layer": "below",
        }
        for spans, look in ((charts.outages, shaded), (stops, dotted))
        for from_ns, to_ns in (spans if len(spans) <= STOP_LINES_MAX else [])
    ]
    data = [*_lines(charts), *_bands(charts), *_events(charts.moments)]
    return {"data": data, "layout": {**_LAYOUTS["time"], "shapes": shapes}}


def on_map(charts: RobotCharts) -> Figure:
    """The path, where it began and ended, and what happened on it."""
    places = charts.places
    x: list[float | None] = []
    y: list[float | None] = []
    text: list[str] = []
    for place in places:
        if place.begins and x:
            x.append(None)
            y.append(None)
            text.append("")
        x.append(round(place.x_m, 3))
        y.append(round(place.y_m, 3))
        text.append(clock(place.time_ns))
    path = {
        "type": "scatter",
        "mode": "lines",
        "name": "path",
        "x": x,
        "y": y,
        "text": text,
        "hovertemplate": "%{text}<br>x %{x:.2f} m, y %{y:.2f} m<extra></extra>",
        "line": {"color": BLUE, "width": 3},
    }
    ends = (
        [
            _marks(
                name,
                [round(place.x_m, 3)],
                [round(place.y_m, 3)],
                {"symbol": symbol, "color": GREEN, "size": 13, "line": {"width": 2, "color": GREEN}},
                hovertemplate=f"{name} {clock(place.time_ns)}<extra></extra>",
            )
            for name, symbol, place in (("begin", "circle", places[0]), ("end", "circle-open", places[-1]))
        ]
        if places
        else []
    )
    events = []
    for kind in sorted({moment.kind for moment in charts.moments} & ON_MAP):
        known = [one for one in charts.moments if one.kind == kind and one.x_m is not None and one.y_m is not None]
        x_m, y_m = ([round(getattr(one, axis), 3) for one in known] for axis in ("x_m", "y_m"))
        events.append(_marks_of(kind, known, x_m, y_m))
    return {"data": [path, *ends, *events], "layout": _LAYOUTS["map"]}


def placed(places: Sequence[Place]) -> dict[str, Sequence[float]]:
    """The places by time, for the page to find one; before those of the numbers ``begins`` the path breaks off."""
    ordered = sorted(places, key=lambda place: place.time_ns)
    return {
        "time_ms": [_ms(place.time_ns) for place in ordered],
        "x_m": [round(place.x_m, 3) for place in ordered],
        "y_m": [round(place.y_m, 3) for place in ordered],
        "heading_deg": [round(place.heading_deg, 1) for place in ordered],
        "begins": [number for number, place in enumerate(ordered) if place.begins],
    }


def band_colours(values: Iterable[str]) -> dict[str, str]:
    """A colour for each value of a band."""
    others = [value for value in dict.fromkeys(values) if value not in COLOURS]
    return COLOURS | {value: PALETTE[number % len(PALETTE)] for number, value in enumerate(others)}


def hover_text(moment: Moment) -> str:
    """An event in words, in plotly's lines."""
    parts = [f"<b>{shown(moment.kind)}</b> {clock(moment.time_ns)}", shown(moment_words(moment))]
    if moment.reason != "none":
        parts.append(f"reason: {shown(reason_words(moment.reason))}")
    if moment.operator:
        parts.append(f"operator: {shown(moment.operator)}")
    elif moment.holder:
        parts.append(f"holder of the lease: {shown(moment.holder)}")
    return "<br>".join(parts)


def _ms(time_ns: int) -> float:
    return round(time_ns / 1e6, 1)


def _lines(charts: RobotCharts) -> list[Figure]:
    """One trace for each of LINES, named in the legend once; a limit holds to both sides of an angle."""
    found: list[Figure] = []
    for axis, unit, line, name, colour, dash in LINES:
        points = charts.lines.get(line, [])
        is_measured = name == "measured"
        shape = "linear" if is_measured else "hv"
        trace: Figure = {
            "type": "scatter",
            "mode": "lines",
            "name": name,
            "legendgroup": name,
            "showlegend": axis == "y",
            "xaxis": "x",
            "yaxis": axis,
            "x": [None if point is None else _ms(point[0]) for point in points],
            "y": [None if point is None else round(point[1], 4) for point in points],
            "connectgaps": False,
            "line": {"color": colour, "dash": dash, "width": 2 if is_measured else 1.5, "shape": shape},
        }
        found.append({**trace, "hovertemplate": f"%{{y:.2f}} {unit}"})
        if line == "steering_limit_deg":
            right = [None if value is None else -value for value in trace["y"]]
            found.append({**trace, "y": right, "showlegend": False, "hoverinfo": "skip"})
    return found


def _bands(charts: RobotCharts) -> list[Figure]:
    """One trace for each value of each band."""
    found = []
    for row, spans in charts.bands.items():
        colours = band_colours(span.value for span in spans)
        for value in dict.fromkeys(span.value for span in spans):
            of_value = [span for span in spans if span.value == value]
            found.append(
                {
                    "type": "bar",
                    "orientation": "h",
                    "name": f"{row}: {shown(value)}",
                    "showlegend": False,
                    "xaxis": "x",
                    "yaxis": "y3",
                    "y": [row] * len(of_value),
                    "base": [_ms(span.start_ns) for span in of_value],
                    "x": [_ms(span.end_ns - span.start_ns) for span in of_value],
                    "text": [shown(value)] * len(of_value),
                    "textposition": "inside",
                    "insidetextanchor": "middle",
                    "textangle": 0,
                    "textfont": {"color": "#ffffff", "size": 11},
                    "marker": {"color": colours[value], "line": {"width": 0}},
                    # A template would be filled in; what it is filled with is not.
                    "hovertext": [f"{row}: {shown(value)}"] * len(of_value),
                    "hovertemplate": "%{hovertext}<extra></extra>",
                }
            )
    return found


def _events(moments: Sequence[Moment]) -> list[Figure]:
    """One trace for each kind of event, in the row of the events."""
    found = []
    for kind in dict.fromkeys(moment.kind for moment in moments):
        of_kind = [moment for moment in moments if moment.kind == kind]
        x = [_ms(moment.time_ns) for moment in of_kind]
        place = {"legend": "legend2", "showlegend": True, "xaxis": "x", "yaxis": "y3"}
        found.append(_marks_of(kind, of_kind, x, ["events"] * len(of_kind), **place))
    return found


def _marks_of(
    kind: str, moments: Sequence[Moment], x: Sequence[float], y: Sequence[float | str], **more: object
) -> Figure:
    """Events of a kind. A latch comes with a stop, and is drawn around it."""
    symbol, colour = MARKS.get(kind, ("circle", GREY))
    size = 18 if kind == "latch" else 11
    mark = {"symbol": symbol, "color": colour, "size": size, "line": {"width": 2, "color": colour}}
    text = [hover_text(moment) for moment in moments]
    return _marks(kind, x, y, mark, text=text, hovertemplate="%{text}<extra></extra>", **more)


def _marks(name: str, x: Sequence[float], y: Sequence[float | str], mark: Figure, **more: object) -> Figure:
    return {"type": "scatter", "mode": "markers", "name": name, "x": x, "y": y, "marker": mark, **more}
