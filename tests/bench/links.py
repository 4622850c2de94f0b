"""What a bad link costs: a simulated robot behind each of a table of links, driven by the library's own stream.

Usage: python -m tests.bench.links [--seconds N] [--plot docs/link_speed.svg]

Times are simulated, so the figures are the same on every machine. With ``--plot`` the speed over the latency is
drawn instead, with the configured deadman and with the longest, and printed as a table for docs/commands.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

import msgspec

from gateway.sim.links import FAR, LINKS, LinkProfile
from schemas.settings import DEADMAN_MAX_S, CommandSettings
from tests.bench.loads import Row, print_table
from tests.support.rigs.far_operator import Trip, trip

SECONDS: Final = 60.0
TOP_MPS: Final = 2.2
GOAL_MPS: Final = 0.5
GOAL_SECONDS: Final = 600.0
GOAL: Final = "moving 95 %, 0.1 stops/min"

ONE_WAYS_MS: Final = (1, 25, 50, 75, 100, 150, 200, 250, 300, 350, 400)
DEADMANS_S: Final = (CommandSettings().deadman_s, DEADMAN_MAX_S)
PLOT_SECONDS: Final = 60.0
STEADY: Final = 0.95
"""Under this share of the time at speed a link is not one to drive over: drawn hollow."""


def rows(seconds: float = SECONDS, goal_seconds: float = GOAL_SECONDS) -> list[Row]:
    """Each link at full speed, and the goal."""
    made = [_row(profile, TOP_MPS, trip(profile, TOP_MPS, seconds), "") for profile in LINKS]
    return [*made, _row(FAR, GOAL_MPS, trip(FAR, GOAL_MPS, goal_seconds), GOAL)]


def _row(profile: LinkProfile, asked_mps: float, made: Trip, goal: str) -> Row:
    deadman = "" if profile.deadman_s is None else f", deadman {profile.deadman_s:g} s"
    text = (
        f"{made.moving:.0%} of the time at speed, {made.stops_per_min:.1f} stops/min, {made.reached_mps:.2f} m/s, "
        f"{made.after_cut_m:.2f} m after a cut"
    )
    return f"{profile.name}, {asked_mps:g} m/s asked{deadman}", text, goal


class Point(msgspec.Struct, frozen=True):
    """A place of the plot: what a link of this latency gives."""

    one_way_ms: int
    deadman_s: float
    made: Trip


def points(seconds: float = PLOT_SECONDS) -> list[Point]:
    """Every latency with every deadman: 30 % jitter, 1 % loss."""
    return [
        Point(one_way_ms, deadman_s, trip(_link(one_way_ms, deadman_s), TOP_MPS, seconds))
        for deadman_s in DEADMANS_S
        for one_way_ms in ONE_WAYS_MS
    ]


def _link(one_way_ms: int, deadman_s: float) -> LinkProfile:
    return LinkProfile("", one_way_ms / 1e3, jitter=0.3, loss=0.01, deadman_s=deadman_s)


WIDTH, HEIGHT, LEFT, BOTTOM, RIGHT, TOP = 640, 360, 60, 50, 20, 30
X_MAX_MS, Y_MAX_MPS = 400, 2.5
COLOURS: Final = ("#1668b2", "#c0392b")


def _x(one_way_ms: float) -> float:
    return LEFT + one_way_ms / X_MAX_MS * (WIDTH - LEFT - RIGHT)


def _y(speed_mps: float) -> float:
    return HEIGHT - BOTTOM - speed_mps / Y_MAX_MPS * (HEIGHT - BOTTOM - TOP)


def svg(measured: list[Point]) -> str:
    """The plot."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-size="12">',
        "<style>text { font-family: sans-serif }</style>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
    ]
    for speed_mps in (0.0, 0.5, 1.0, 1.5, 2.0, 2.5):
        y = _y(speed_mps)
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{speed_mps:g}</text>')
    for one_way_ms in range(0, X_MAX_MS + 1, 50):
        place = f'x="{_x(one_way_ms):.1f}" y="{HEIGHT - BOTTOM + 18}"'
        parts.append(f'<text {place} text-anchor="middle">{one_way_ms}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 10}" text-anchor="middle">latency one way, ms</text>')
    parts.append(f'<text x="{LEFT - 45}" y="{TOP - 12}">speed, m/s, at {TOP_MPS:g} m/s asked</text>')
    for number, (deadman_s, colour) in enumerate(zip(DEADMANS_S, COLOURS, strict=True)):
        line = [one for one in measured if one.deadman_s == deadman_s]
        places = [(_x(one.one_way_ms), _y(one.made.reached_mps), one.made.moving >= STEADY) for one in line]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in places)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" stroke="{colour}" stroke-width="2" '
            f'fill="{colour if is_steady else "white"}"/>'
            for x, y, is_steady in places
        ]
        parts.append(
            f'<text x="{WIDTH - RIGHT}" y="{TOP + 18 * number}" text-anchor="end" fill="{colour}">'
            f"deadman {deadman_s:g} s</text>"
        )
    note = f"hollow: at speed for less than {STEADY:.0%} of the time"
    parts.append(
        f'<text x="{WIDTH - RIGHT}" y="{TOP + 18 * len(DEADMANS_S)}" text-anchor="end" fill="#555">{note}</text>'
    )
    return "\n".join([*parts, "</svg>", ""])


def markdown(measured: list[Point]) -> str:
    """The same as a table."""
    heads = [f"deadman {deadman_s:g} s" for deadman_s in DEADMANS_S]
    lines = ["| one way | " + " | ".join(heads) + " |", "| --- |" + " --- |" * len(heads)]
    for one_way_ms in ONE_WAYS_MS:
        cells = [
            f"{one.made.reached_mps:.2f} m/s, {one.made.moving:.0%}, {one.made.stops_per_min:.0f} stops/min"
            for one in measured
            if one.one_way_ms == one_way_ms
        ]
        lines.append(f"| {one_way_ms} ms | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure, and print or draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=SECONDS, help="simulated, of each link (60)")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the speed over the latency, as SVG")
    arguments = parser.parse_args()
    if arguments.plot is None:
        print_table(rows(arguments.seconds))
        return
    measured = points(arguments.seconds)
    arguments.plot.write_text(svg(measured), encoding="utf-8")
    print(markdown(measured))


if __name__ == "__main__":
    main()
