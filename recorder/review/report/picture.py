"""The report as a picture.

Matplotlib reads formulas between dollar signs; texts from the log are shown as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from textwrap import wrap
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from recorder.review.report.figures import (
    ANGLE_LINES,
    BAND_ROWS,
    BLUE,
    GREEN,
    GREY,
    ON_MAP,
    ORANGE,
    RED,
    SPEED_LINES,
    VIOLET,
    band_colours,
    outages,
    stop_lines,
)
from recorder.review.report.findings import Moment, Report, RobotCharts, RobotReport
from recorder.review.report.series import Point
from recorder.review.report.words import headline, summary_lines
from schemas.printable import plain

ROBOTS_SHOWN: Final = 8
"""A picture of more would be larger than viewers like."""

_WIDTH_IN: Final = 13.0
_HEIGHT_IN: Final = 14.5
_DPI: Final = 110
_DAY_NS: Final = 24 * 3600 * 10**9
_LAST_NS: Final = 2_900_000 * _DAY_NS
_INK: Final = "#16181d"
_SOFT: Final = "#565c66"
_GRID: Final = "#e4e6ea"
_SUMMARY_COLUMNS: Final = 68
_SUMMARY_LINES_MAX: Final = 36
_LEGEND_COLUMNS: Final = 9
_HEAD_COLUMNS: Final = 60
_HEAD_LINES_MAX: Final = 4
_HEAD_LINE: Final = 1.4
"""Its letters are larger."""

_BETWEEN_LINES: Final = 0.5
_DASHES: Final = {"solid": "-", "dash": "--", "dot": ":"}
_MARKS: Final = {
    "stop": ("s", RED, RED),
    "latch": ("D", RED, "none"),
    "fault": ("x", ORANGE, ORANGE),
    "guard": ("*", RED, RED),
    "takeover": ("^", VIOLET, VIOLET),
    "lease": ("o", BLUE, "none"),
    "engaged": ("o", GREEN, GREEN),
    "stopped": ("s", GREY, "none"),
    "reset": ("D", BLUE, "none"),
    "gateway": ("P", RED, RED),
    "gap": ("|", RED, RED),
    "clock": ("d", ORANGE, ORANGE),
    "recorder": ("p", GREY, "none"),
}
"""Symbol, edge and face of each kind of event, as the page has them."""

_UNKNOWN_MARK: Final = ("o", _SOFT, _SOFT)


def picture(report: Report) -> bytes:
    """The report as PNG, one robot below the other."""
    shown = report.robots[:ROBOTS_SHOWN]
    figure = Figure(
        figsize=(_WIDTH_IN, _HEIGHT_IN * len(shown)),
        dpi=_DPI,
        facecolor="white",
        layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12),
    )
    FigureCanvasAgg(figure)
    parts = figure.subfigures(len(shown), 1, squeeze=False)
    for robot, (part,) in zip(shown, parts, strict=True):
        _draw(part, robot, report, left_out=len(report.robots) - len(shown) + report.more_robots)
    stream = BytesIO()
    about = {"Title": "Drive report", "Software": f"cruiser-gateway {report.version}"}
    figure.savefig(stream, format="png", metadata=about)
    return stream.getvalue()


def _draw(part: SubFigure, robot: RobotReport, report: Report, left_out: int) -> None:
    more = f" ({left_out} more robots are not shown)" if left_out else ""
    title = f"{plain(robot.summary.name)}{more}"
    part.suptitle(title, fontsize=17, fontweight="bold", color=_INK, x=0.02, ha="left", parse_math=False)
    axes = part.subplot_mosaic(
        [["map", "summary"], ["speed", "speed"], ["angle", "angle"], ["bands", "bands"]],
        height_ratios=[6.6, 2.2, 2.2, 1.9],
        width_ratios=[1.0, 1.15],
    )
    _map(axes["map"], robot.charts)
    _summary(axes["summary"], robot, report)
    _lines(axes["speed"], robot.charts, SPEED_LINES, "speed, m/s")
    _lines(axes["angle"], robot.charts, ANGLE_LINES, "angle, deg")
    _bands(axes["bands"], robot.charts)
    axes["speed"].legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=4, frameon=False, fontsize=9)
    limits = _time_limits(robot)
    stops = stop_lines(robot.charts)
    for name in ("speed", "angle", "bands"):
        for time_ns in stops:
            axes[name].axvline(_date(time_ns), color=RED, linewidth=0.8, linestyle=":", zorder=0)
        for from_ns, to_ns in outages(robot.charts):
            axes[name].axvspan(_date(from_ns), _date(to_ns), color=RED, alpha=0.15, linewidth=0, zorder=0)
        axes[name].set_xlim(*limits)
        locator = AutoDateLocator()  # type: ignore[no-untyped-call]  # matplotlib's stubs are not whole
        axes[name].xaxis.set_major_locator(locator)
        axes[name].xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        if name != "bands":
            axes[name].tick_params(labelbottom=False)
            axes[name].xaxis.get_offset_text().set_visible(False)
    axes["bands"].set_xlabel("time, UTC", color=_SOFT)


def _summary(axes: Axes, robot: RobotReport, report: Report) -> None:
    axes.axis("off")
    # Texts that are too wide are cut off; they must not take the map's room.
    place: dict[str, Any] = {"transform": axes.transAxes, "va": "top", "parse_math": False, "in_layout": False}
    head = wrap(plain(headline(robot.summary)), _HEAD_COLUMNS, break_on_hyphens=False)[:_HEAD_LINES_MAX]
    axes.text(0.0, 1.0, "\n".join(head), color=_INK, fontsize=12, fontweight="bold", **place)
    lines = _HEAD_LINE * len(head) + _BETWEEN_LINES
    for name, said in summary_lines(robot.summary, report):
        wrapped = wrap(plain(said), _SUMMARY_COLUMNS, break_on_hyphens=False) or [""]
        room = max(1, int(_SUMMARY_LINES_MAX - lines))
        if len(wrapped) > room:
            wrapped = [*wrapped[: room - 1], "..."]
        height = 1.0 - lines / _SUMMARY_LINES_MAX
        axes.text(0.0, height, name, color=_SOFT, fontsize=9.2, **place)
        axes.text(0.2, height, "\n".join(wrapped), color=_INK, fontsize=9.2, linespacing=1.25, **place)
        lines += len(wrapped) + _BETWEEN_LINES
        if lines > _SUMMARY_LINES_MAX:
            return


def _map(axes: Axes, charts: RobotCharts) -> None:
    x: list[float] = []
    y: list[float] = []
    for place in charts.places:
        if place.begins and x:
            x.append(float("nan"))
            y.append(float("nan"))
        x.append(place.x_m)
        y.append(place.y_m)
    axes.plot(x, y, color=BLUE, linewidth=2)
    if charts.places:
        first, last = charts.places[0], charts.places[-1]
        axes.plot([first.x_m], [first.y_m], "o", color=GREEN, markersize=9, label="begin")
        axes.plot([last.x_m], [last.y_m], "o", color=GREEN, markerfacecolor="none", markersize=9, label="end")
    for kind in sorted({moment.kind for moment in charts.moments} & ON_MAP):
        known = [one for one in charts.moments if one.kind == kind and one.x_m is not None]
        _scatter(axes, kind, [one.x_m for one in known], [one.y_m for one in known], kind)
    _dress(axes)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x, m: forward as it stood at first", color=_SOFT)
    axes.set_ylabel("y, m: left", color=_SOFT)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=5, frameon=False, fontsize=9)


def _lines(axes: Axes, charts: RobotCharts, about: Sequence[tuple[str, str, str, str]], title: str) -> None:
    for line, name, colour, dash in about:
        points = charts.lines.get(line, [])
        times, values = _columns(points)
        for sign in (1, -1) if line == "steering_limit_deg" else (1,):
            axes.plot(
                times,
                [sign * value for value in values],
                color=colour,
                linestyle=_DASHES[dash],
                linewidth=1.8 if name == "measured" else 1.2,
                drawstyle="default" if name == "measured" else "steps-post",
                label=name if sign > 0 else None,
            )
    axes.axhline(0, color=_GRID, linewidth=1.2, zorder=0)
    _dress(axes)
    axes.set_ylabel(title, color=_SOFT)


def _bands(axes: Axes, charts: RobotCharts) -> None:
    axes.set_yticks(range(len(BAND_ROWS)), BAND_ROWS)
    axes.set_ylim(-0.6, len(BAND_ROWS) - 0.4)
    for row, spans in charts.bands.items():
        colours = band_colours(span.value for span in spans)
        whole_ns = max((span.end_ns for span in spans), default=0) - min(
            (span.start_ns for span in spans), default=0
        )
        for span in spans:
            start, end = _date(span.start_ns), _date(span.end_ns)
            number = BAND_ROWS.index(row)
            axes.barh(number, end - start, left=start, height=0.66, color=colours[span.value])
            # About as many letters as fit.
            if (span.end_ns - span.start_ns) * 150 > whole_ns * (len(span.value) + 1):
                axes.text(
                    start + (end - start) / 2,
                    number,
                    plain(span.value),
                    color="white",
                    fontsize=8.5,
                    ha="center",
                    va="center",
                    parse_math=False,
                    clip_on=True,
                )
    for kind in dict.fromkeys(moment.kind for moment in charts.moments):
        of_kind: list[Moment] = [moment for moment in charts.moments if moment.kind == kind]
        height = BAND_ROWS.index("events")
        _scatter(axes, kind, [_date(moment.time_ns) for moment in of_kind], [height] * len(of_kind), kind)
    if charts.moments:
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=_LEGEND_COLUMNS, frameon=False, fontsize=9)
    _dress(axes)


def _scatter(axes: Axes, kind: str, x: Sequence[Any], y: Sequence[Any], label: str) -> None:
    symbol, edge, face = _MARKS.get(kind, _UNKNOWN_MARK)
    axes.plot(
        x,
        y,
        symbol,
        markeredgecolor=edge,
        markerfacecolor=face,
        markeredgewidth=1.5,
        markersize=11 if kind == "latch" else 7,
        linestyle="none",
        label=label,
        zorder=4,
    )


def _dress(axes: Axes) -> None:
    axes.grid(visible=True, color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(colors=_SOFT, labelsize=9)
    for spine in axes.spines.values():
        spine.set_color(_GRID)


def _time_limits(robot: RobotReport) -> tuple[float, float]:
    start_ns, end_ns = robot.summary.start_ns, robot.summary.end_ns
    margin_ns = max((end_ns - start_ns) // 50, 10**8)
    return _date(start_ns - margin_ns), _date(end_ns + margin_ns)


def _columns(points: Sequence[Point | None]) -> tuple[list[float], list[float]]:
    """Times and values; not a number where the line is broken."""
    times: list[float] = []
    values: list[float] = []
    for point in points:
        if point is not None:
            times.append(_date(point[0]))
            values.append(point[1])
        elif times:
            times.append(times[-1])
            values.append(float("nan"))
    return times, values


def _date(time_ns: int) -> float:
    """A time as matplotlib counts it: days since 1970. What is beyond the calendar is near its end."""
    return min(time_ns, _LAST_NS) / _DAY_NS
