"""The charts of a robot, as plotly wants them: plain dictionaries, which a test holds to plotly's own rules.

Texts from the log are escaped: plotly reads tags in them. The colours of light and dark are set by ``page.js``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from html import escape
from typing import Any, Final

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
    "reset": ("diamond-open", BLUE),
    "gateway": ("cross", RED),
    "gap": ("line-ns", RED),
    "clock": ("diamond-tall", ORANGE),
    "recorder": ("pentagon-open", GREY),
}
"""Symbol and colour of each kind of event; they differ in form too, for who cannot tell colours apart."""

ON_MAP: Final = frozenset({"stop", "latch", "fault", "guard", "takeover", "gateway", "gap"})

BAND_ROWS: Final = ("lease", "arbiter", "mode", "events")
"""From the bottom to the top."""

STOP_LINES_MAX: Final = 40
"""More lines across the charts would hide them: then there are none."""

SPEED_LINES: Final = (
    ("speed_limit_mps", "limit", GREY, "dot"),
    ("target_speed_mps", "asked for", ORANGE, "dash"),
    ("output_speed_mps", "told to the chassis", GREEN, "solid"),
    ("speed_mps", "measured", BLUE, "solid"),
)
ANGLE_LINES: Final = (
    ("steering_limit_deg", "limit", GREY, "dot"),
    ("target_angle_deg", "asked for", ORANGE, "dash"),
    ("output_angle_deg", "told to the chassis", GREEN, "solid"),
    ("angle_deg", "measured", BLUE, "solid"),
)

_AXIS_FONT: Final = {"size": 12}


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
    """Speed, angle, bands and events over one time axis."""
    data = [
        *_lines(charts, SPEED_LINES, "y", "m/s", is_named=True),
        *_lines(charts, ANGLE_LINES, "y2", "deg", is_named=False),
        *_bands(charts),
        *_event_rows(charts.moments),
    ]
    return {
        "data": data,
        "layout": {
            "autosize": True,
            "margin": {"l": 58, "r": 12, "t": 36, "b": 44},
            "hovermode": "x unified",
            "hoversubplots": "axis",
            "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0, "font": _AXIS_FONT},
            "legend2": {
                "orientation": "h",
                "y": -0.11,
                "yanchor": "top",
                "x": 0,
                "font": _AXIS_FONT,
                "itemsizing": "constant",
            },
            "barmode": "overlay",
            "bargap": 0.35,
            "uniformtext": {"minsize": 10, "mode": "hide"},
            "xaxis": {
                "type": "date",
                "anchor": "y3",
                "tickangle": 0,
                "title": {"text": "time, UTC", "font": _AXIS_FONT},
                "showspikes": True,
                "spikemode": "across",
                "spikesnap": "cursor",
                "spikethickness": 1,
                "spikedash": "solid",
                "hoverformat": "%Y-%m-%d %H:%M:%S.%L",
            },
            "yaxis": _axis("speed, m/s", (0.68, 1.0)),
            "yaxis2": _axis("angle, deg", (0.34, 0.62)),
            "yaxis3": {
                **_axis("", (0.0, 0.28)),
                "type": "category",
                "categoryorder": "array",
                "categoryarray": list(BAND_ROWS),
                "range": [-0.5, len(BAND_ROWS) - 0.5],
                "fixedrange": True,
                "zeroline": False,
            },
            "shapes": [
                *(
                    _across(
                        from_ns, to_ns, {"type": "rect", "fillcolor": RED, "opacity": 0.15, "line": {"width": 0}}
                    )
                    for from_ns, to_ns in outages(charts)
                ),
                *(
                    _across(stop_ns, stop_ns, {"type": "line", "line": {"color": RED, "width": 1, "dash": "dot"}})
                    for stop_ns in stop_lines(charts)
                ),
            ],
        },
    }


def stop_lines(charts: RobotCharts) -> list[int]:
    """When to draw a line across the charts."""
    stops = [moment.time_ns for moment in charts.moments if moment.kind == "stop"]
    return stops if len(stops) <= STOP_LINES_MAX else []


def outages(charts: RobotCharts) -> list[tuple[int, int]]:
    """From when to when to shade the charts, because the gateway was silent and another one began."""
    return charts.outages if len(charts.outages) <= STOP_LINES_MAX else []


def on_map(charts: RobotCharts) -> Figure:
    """The path, where it began and ended, and what happened on it. The last trace marks a place; it is empty."""
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
    data: list[Figure] = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": "path",
            "x": x,
            "y": y,
            "text": text,
            "hovertemplate": "%{text}<br>x %{x:.2f} m, y %{y:.2f} m<extra></extra>",
            "line": {"color": BLUE, "width": 3},
        }
    ]
    if places:
        data += [_end(places[0], "begin", "circle", GREEN), _end(places[-1], "end", "circle-open", GREEN)]
    for kind in sorted({moment.kind for moment in charts.moments} & ON_MAP):
        data.append(_on_path(kind, [moment for moment in charts.moments if moment.kind == kind]))
    data.append(
        {
            "type": "scatter",
            "mode": "markers",
            "name": "here",
            "x": [],
            "y": [],
            "showlegend": False,
            "hoverinfo": "skip",
            "marker": {"symbol": "circle-cross-open", "size": 18, "color": ORANGE, "line": {"width": 2}},
        }
    )
    return {
        "data": data,
        "layout": {
            "autosize": True,
            "margin": {"l": 58, "r": 12, "t": 36, "b": 44},
            "hovermode": "closest",
            "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0, "font": _AXIS_FONT},
            "xaxis": {
                "title": {"text": "x, m: forward as it stood at first", "font": _AXIS_FONT},
                "zeroline": True,
            },
            "yaxis": {
                "title": {"text": "y, m: left", "font": _AXIS_FONT},
                "scaleanchor": "x",
                "scaleratio": 1,
                "zeroline": True,
            },
        },
    }


def placed(places: Sequence[Place]) -> dict[str, list[float]]:
    """The places by time, for the page to find one."""
    ordered = sorted(places, key=lambda place: place.time_ns)
    return {
        "time_ms": [_ms(place.time_ns) for place in ordered],
        "x_m": [round(place.x_m, 3) for place in ordered],
        "y_m": [round(place.y_m, 3) for place in ordered],
    }


def band_colours(values: Iterable[str]) -> dict[str, str]:
    """A colour for each value of a band."""
    others = [value for value in dict.fromkeys(values) if value not in COLOURS]
    return COLOURS | {value: PALETTE[number % len(PALETTE)] for number, value in enumerate(others)}


def hover_text(moment: Moment) -> str:
    """What is to be known of an event, in plotly's lines."""
    parts = [f"<b>{shown(moment.kind)}</b> {clock(moment.time_ns)}", shown(moment_words(moment))]
    if moment.reason != "none":
        parts.append(f"reason: {shown(reason_words(moment.reason))}")
    if moment.operator:
        parts.append(f"operator: {shown(moment.operator)}")
    elif moment.holder:
        parts.append(f"holder of the lease: {shown(moment.holder)}")
    return "<br>".join(parts)


def _across(from_ns: int, to_ns: int, look: Figure) -> Figure:
    """A shape across all charts."""
    place = {"xref": "x", "yref": "paper", "x0": _ms(from_ns), "x1": _ms(to_ns), "y0": 0, "y1": 1}
    return {**place, **look, "layer": "below"}


def _ms(time_ns: int) -> float:
    return round(time_ns / 1e6, 1)


def _axis(title: str, domain: tuple[float, float]) -> Figure:
    return {
        "title": {"text": title, "font": _AXIS_FONT},
        "domain": list(domain),
        "rangemode": "tozero",
        "showspikes": False,
    }


def _lines(
    charts: RobotCharts, about: Sequence[tuple[str, str, str, str]], axis: str, unit: str, *, is_named: bool
) -> list[Figure]:
    """One of each; a limit holds to both sides of an angle."""
    found: list[Figure] = []
    for line, name, colour, dash in about:
        points = charts.lines.get(line, [])
        is_measured = name == "measured"
        trace: Figure = {
            "type": "scatter",
            "mode": "lines",
            "name": name,
            "legendgroup": name,
            "showlegend": is_named,
            "xaxis": "x",
            "yaxis": axis,
            "x": [None if point is None else _ms(point[0]) for point in points],
            "y": [None if point is None else round(point[1], 4) for point in points],
            "connectgaps": False,
            "line": {
                "color": colour,
                "dash": dash,
                "width": 2 if is_measured else 1.5,
                "shape": "linear" if is_measured else "hv",
            },
            "hovertemplate": f"%{{y:.2f}} {unit}",
        }
        found.append(trace)
        if line == "steering_limit_deg":
            below = {key: value for key, value in trace.items() if key != "hovertemplate"}
            right = [None if value is None else -value for value in trace["y"]]
            found.append({**below, "y": right, "showlegend": False, "hoverinfo": "skip"})
    return found


def _bands(charts: RobotCharts) -> list[Figure]:
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
                    "x": [round((span.end_ns - span.start_ns) / 1e6, 1) for span in of_value],
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


def _event_rows(moments: Sequence[Moment]) -> list[Figure]:
    found = []
    for kind in dict.fromkeys(moment.kind for moment in moments):
        of_kind = [moment for moment in moments if moment.kind == kind]
        found.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": kind,
                "legend": "legend2",
                "showlegend": True,
                "xaxis": "x",
                "yaxis": "y3",
                "x": [_ms(moment.time_ns) for moment in of_kind],
                "y": ["events"] * len(of_kind),
                "text": [hover_text(moment) for moment in of_kind],
                "hovertemplate": "%{text}<extra></extra>",
                "marker": _mark(kind),
            }
        )
    return found


def _on_path(kind: str, moments: Sequence[Moment]) -> Figure:
    known = [moment for moment in moments if moment.x_m is not None and moment.y_m is not None]
    return {
        "type": "scatter",
        "mode": "markers",
        "name": kind,
        "x": [round(moment.x_m or 0.0, 3) for moment in known],
        "y": [round(moment.y_m or 0.0, 3) for moment in known],
        "text": [hover_text(moment) for moment in known],
        "hovertemplate": "%{text}<extra></extra>",
        "marker": _mark(kind),
    }


def _mark(kind: str) -> Figure:
    """A latch comes with a stop, and is drawn around it."""
    symbol, colour = MARKS.get(kind, ("circle", GREY))
    size = 18 if kind == "latch" else 11
    return {"symbol": symbol, "color": colour, "size": size, "line": {"width": 2, "color": colour}}


def _end(place: Place, name: str, symbol: str, colour: str) -> Figure:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": [round(place.x_m, 3)],
        "y": [round(place.y_m, 3)],
        "hovertemplate": f"{name} {clock(place.time_ns)}<extra></extra>",
        "marker": {"symbol": symbol, "color": colour, "size": 13, "line": {"width": 2, "color": colour}},
    }
