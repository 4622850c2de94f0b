"""Charts of figures as SVG, for the docs: lines with points over a quantity. Several stand two by two."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import msgspec

WIDTH, HEIGHT, LEFT, BOTTOM, RIGHT, TOP = 640, 360, 60, 50, 20, 30
GAP: Final = 18
"""From a line of the legend to the next."""

COLOURS: Final = ("#1668b2", "#c0392b", "#2e7d32", "#8e44ad")


class Line(msgspec.Struct, frozen=True):
    """A line of a chart.

    Attributes:
        name: for the legend.
        points: x, y, and whether the point is drawn hollow.
    """

    name: str
    points: Sequence[tuple[float, float, bool]]


class Chart(msgspec.Struct, frozen=True):
    """Lines with common axes, which begin at 0.

    Attributes:
        x_title, y_title: with their units.
        x_ticks, y_ticks: the values that are written; the last of each is the end of its axis.
        note: of what the hollow points mean; empty if there are none.
        legend_x: where the legend ends, as a share of the width.
    """

    x_title: str
    y_title: str
    x_ticks: Sequence[float]
    y_ticks: Sequence[float]
    lines: Sequence[Line]
    note: str = ""
    legend_x: float = 1.0


def ticks(largest: float) -> list[float]:
    """Round values from 0 on, four to eight of them, the last not below the largest."""
    size = 10 ** math.floor(math.log10(largest))
    step = next(size * part for part in (0.2, 0.5, 1, 2) if largest <= size * part * 7)
    return [number * step for number in range(math.ceil(largest / step) + 1)]


def draw(*charts: Chart) -> str:
    """The charts as one picture, two in a row."""
    width, height = WIDTH * min(2, len(charts)), HEIGHT * -(-len(charts) // 2)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-size="12">',
        "<style>text { font-family: sans-serif }</style>",
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for number, chart in enumerate(charts):
        place = f"{number % 2 * WIDTH} {number // 2 * HEIGHT}"
        parts += [f'<g transform="translate({place})">', *_drawn(chart), "</g>"]
    return "\n".join([*parts, "</svg>", ""])


def _drawn(chart: Chart) -> Iterator[str]:
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM

    def x_of(value: float) -> float:
        return LEFT + value / chart.x_ticks[-1] * (right - LEFT)

    def y_of(value: float) -> float:
        return bottom - value / chart.y_ticks[-1] * (bottom - TOP)

    for value in chart.y_ticks:
        y = y_of(value)
        yield f'<line x1="{LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>'
        yield f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>'
    for value in chart.x_ticks:
        yield f'<text x="{x_of(value):.1f}" y="{bottom + 18}" text-anchor="middle">{value:g}</text>'
    yield f'<text x="{(LEFT + right) / 2}" y="{HEIGHT - 10}" text-anchor="middle">{chart.x_title}</text>'
    yield f'<text x="{LEFT - 45}" y="{TOP - 12}">{chart.y_title}</text>'
    legend = LEFT + (right - LEFT) * chart.legend_x
    for number, (line, colour) in enumerate(zip(chart.lines, COLOURS, strict=False)):
        places = [(x_of(x), y_of(y), is_hollow) for x, y, is_hollow in line.points]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in places)
        yield f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>'
        for x, y, is_hollow in places:
            fill = "white" if is_hollow else colour
            yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" stroke="{colour}" stroke-width="2" fill="{fill}"/>'
        yield f'<text x="{legend}" y="{TOP + GAP * number}" text-anchor="end" fill="{colour}">{line.name}</text>'
    if chart.note:
        y = TOP + GAP * len(chart.lines)
        yield f'<text x="{legend}" y="{y}" text-anchor="end" fill="#555">{chart.note}</text>'
