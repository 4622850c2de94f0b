"""The charts of a robot as data, which ``page.js`` draws: lines by uPlot, path, bands and marks as SVG.

Times are whole milliseconds, each since the one before it: a chart has thousands of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any, Final

import msgspec

from recorder.review.report.charts import BANDS, Place, Point, Span
from recorder.review.report.findings import Drawn, Moment, RobotSummary
from recorder.review.report.words import moment_words, reason_words
from schemas.command_line import plain

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

STOP_LINES_MAX: Final = 40
"""More lines across the charts would hide them: then there are none."""


class EventLook(msgspec.Struct, frozen=True):
    """The look of a kind of event.

    Attributes:
        path: its outline, as SVG has it, between -1 and 1.
        is_open: the outline alone is drawn.
        is_on_map: it is shown on the path, too.
        radius: in pixels.
    """

    path: str
    colour: str
    is_open: bool = False
    is_on_map: bool = False
    radius: float = 5.5


SQUARE: Final = "M-1-1H1V1H-1Z"
DIAMOND: Final = "M0-1 1 0 0 1-1 0Z"
CIRCLE: Final = "M-1 0A1 1 0 1 1 1 0 1 1 0 1 1-1 0Z"

MARKS: Final = {
    "stop": EventLook(SQUARE, RED, is_on_map=True),
    # It comes with a stop, and is drawn around it.
    "latch": EventLook(DIAMOND, RED, is_open=True, is_on_map=True, radius=10),
    "fault": EventLook("M-1-1 1 1M1-1-1 1", ORANGE, is_open=True, is_on_map=True),
    "guard": EventLook("M0-1.2.3-.4 1.2-.4.5.2.7 1.1 0 .6-.7 1.1-.5.2-1.2-.4-.3-.4Z", RED, is_on_map=True),
    "takeover": EventLook("M0-1 1 1H-1Z", VIOLET, is_on_map=True),
    "lease": EventLook(CIRCLE, BLUE, is_open=True),
    "engaged": EventLook(CIRCLE, GREEN),
    "stopped": EventLook(SQUARE, GREY, is_open=True),
    "end": EventLook(SQUARE, GREY),
    "reset": EventLook(DIAMOND, BLUE, is_open=True),
    "gateway": EventLook("M0-1V1M-1 0H1", RED, is_open=True, is_on_map=True),
    "gap": EventLook("M0-1V1", RED, is_open=True, is_on_map=True),
    "clock": EventLook("M0-1.3.6 0 0 1.3-.6 0Z", ORANGE),
    "recorder": EventLook("M0-1 1-.2.6 1H-.6L-1-.2Z", GREY, is_open=True),
}
"""The look of each kind of event; the outlines differ too, for people who cannot distinguish colours."""

OTHER_MARK: Final = EventLook(CIRCLE, GREY)

ENDS: Final = {
    "begin": EventLook(CIRCLE, GREEN, is_on_map=True, radius=6.5),
    "end": EventLook(CIRCLE, GREEN, is_open=True, is_on_map=True, radius=6.5),
}
"""The look of both ends of the path."""


class Line(msgspec.Struct, frozen=True):
    """A line of a chart: 0 of speed, 1 of angle.

    Attributes:
        key: its name in ``Drawn``.
        name: in the legend.
        dash: lengths of dashes and of what is between them, in pixels.
        is_stepped: each value holds until the next one; else the line goes straight from one to the next.
        is_mirrored: it holds to both sides.
    """

    chart: int
    key: str
    name: str
    colour: str
    dash: tuple[int, ...] = ()
    is_stepped: bool = True
    is_mirrored: bool = False


LINES: Final = (
    Line(0, "speed_limit_mps", "limit", GREY, (2, 4)),
    Line(0, "target_speed_mps", "requested", ORANGE, (8, 4)),
    Line(0, "output_speed_mps", "commanded", GREEN),
    Line(0, "speed_mps", "measured", BLUE, is_stepped=False),
    Line(1, "steering_limit_deg", "limit", GREY, (2, 4), is_mirrored=True),
    Line(1, "target_angle_deg", "requested", ORANGE, (8, 4)),
    Line(1, "output_angle_deg", "commanded", GREEN),
    Line(1, "angle_deg", "measured", BLUE, is_stepped=False),
)


def looks() -> dict[str, Any]:
    """Return what all charts have in common."""
    return {
        "lines": LINES,
        "bands": BANDS,
        "marks": MARKS,
        "other_mark": OTHER_MARK,
        "ends": ENDS,
        "path": BLUE,
        "outage": RED,
    }


def figures(robot: RobotSummary, drawn: Drawn) -> dict[str, Any]:
    """Return the charts of a drive."""
    stops = [moment.time_ns for moment in drawn.moments if moment.is_stop]
    return {
        "robot": robot.name,
        "from_ms": _ms(drawn.start_ns),
        "to_ms": -(-drawn.end_ns // 1_000_000),
        "lines": [_line(drawn.lines.get(line.key, [])) for line in LINES],
        "bands": [_band(drawn.bands.get(row, [])) for row in BANDS],
        "outages": [(_ms(begin), _ms(end)) for begin, end in _few(drawn.outages)],
        "stops": [_ms(time_ns) for time_ns in _few(stops)],
        "moments": [_moment(one) for one in drawn.moments],
        "path": _path(drawn.places),
    }


def clock(time_ns: int) -> str:
    """The time of day, UTC."""
    try:
        return f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%H:%M:%S}.{time_ns % 10**9 // 10**6:03d}"
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"


def band_colours(values: Iterable[str]) -> dict[str, str]:
    """A colour for each value of a band."""
    others = [value for value in dict.fromkeys(values) if value not in COLOURS]
    return COLOURS | {value: PALETTE[number % len(PALETTE)] for number, value in enumerate(others)}


def hover_text(moment: Moment) -> str:
    """An event in words, in lines."""
    parts = [f"{plain(moment.kind)} {clock(moment.time_ns)}", plain(moment_words(moment))]
    if moment.reason != "none":
        parts.append(f"reason: {plain(reason_words(moment.reason))}")
    if moment.operator:
        parts.append(f"operator: {plain(moment.operator)}")
    elif moment.holder:
        parts.append(f"holder of the lease: {plain(moment.holder)}")
    return "\n".join(parts)


def _ms(time_ns: int) -> int:
    return time_ns // 1_000_000


def _steps(times_ms: Sequence[int]) -> list[int]:
    """The first time, and from each one to the next."""
    return [*times_ms[:1], *(after - before for before, after in pairwise(times_ms))]


def _few(found: Sequence[Any]) -> Sequence[Any]:
    return found if len(found) <= STOP_LINES_MAX else ()


def _line(points: Sequence[Point | None]) -> tuple[list[int], list[float | None]]:
    """Times and values; where the line breaks off there is no value right behind the last one."""
    times_ms: list[int] = []
    values: list[float | None] = []
    for point in points:
        times_ms.append(times_ms[-1] + 1 if point is None else _ms(point[0]))
        values.append(None if point is None else round(point[1], 3))
    return _steps(times_ms), values


def _band(spans: Sequence[Span]) -> list[tuple[int, int, str, str]]:
    """Beginning, end, value and colour of each span."""
    colours = band_colours(span.value for span in spans)
    return [(_ms(span.start_ns), _ms(span.end_ns), plain(span.value), colours[span.value]) for span in spans]


def _moment(moment: Moment) -> dict[str, Any]:
    is_known = moment.x_m is not None and moment.y_m is not None
    return {
        "ms": _ms(moment.time_ns),
        "kind": moment.kind,
        "text": hover_text(moment),
        "at": (round(moment.x_m or 0.0, 3), round(moment.y_m or 0.0, 3)) if is_known else None,
    }


def _path(places: Sequence[Place]) -> dict[str, Sequence[float]]:
    """The places as they were passed; before those of the numbers ``begins`` the path breaks off."""
    return {
        "time_ms": _steps([_ms(place.time_ns) for place in places]),
        "x_m": [round(place.x_m, 3) for place in places],
        "y_m": [round(place.y_m, 3) for place in places],
        "heading_deg": [round(place.heading_deg, 1) for place in places],
        "begins": [number for number, place in enumerate(places) if place.begins],
    }
