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

from schemas.settings import DEADMAN_MAX_S, CommandSettings
from tests.bench.loads import Row, print_table
from tests.bench.plot import Chart, Line, draw
from tests.support.links import FAR, LINKS, LinkProfile
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


def svg(measured: list[Point]) -> str:
    """The plot."""
    lines = [
        Line(
            f"deadman {deadman_s:g} s",
            [
                (one.one_way_ms, one.made.reached_mps, one.made.moving < STEADY)
                for one in measured
                if one.deadman_s == deadman_s
            ],
        )
        for deadman_s in DEADMANS_S
    ]
    note = f"hollow: at speed for less than {STEADY:.0%} of the time"
    y_title = f"speed, m/s, at {TOP_MPS:g} m/s asked"
    return draw(Chart("latency one way, ms", y_title, range(0, 401, 50), (0, 0.5, 1, 1.5, 2, 2.5), lines, note))


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
