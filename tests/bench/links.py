"""The cost of a bad link: a simulated robot driven by the library's own stream, in simulated time."""

from __future__ import annotations

from typing import Final

from schemas.settings import DEADMAN_MAX_S, CommandSettings
from tests.bench.loads import Row
from tests.support.links import FAR, LINKS, LinkProfile
from tests.support.rigs.far_operator import Trip, trip

TOP_MPS: Final = 2.2
GOAL_MPS: Final = 0.5
GOAL: Final = "moving 95 %, 0.1 stops/min"

ONE_WAYS_MS: Final = (1, 25, 50, 75, 100, 150, 200, 250, 300, 350, 400)
DEADMANS_S: Final = (CommandSettings().deadman_s, DEADMAN_MAX_S)


def rows(seconds: float, goal_seconds: float) -> list[Row]:
    made = [_row(profile, TOP_MPS, trip(profile, TOP_MPS, seconds), "") for profile in LINKS]
    return [*made, _row(FAR, GOAL_MPS, trip(FAR, GOAL_MPS, goal_seconds), GOAL)]


def _row(profile: LinkProfile, asked_mps: float, made: Trip, goal: str) -> Row:
    deadman = "" if profile.deadman_s is None else f", deadman {profile.deadman_s:g} s"
    text = (
        f"{made.moving:.0%} of the time at speed, {made.stops_per_min:.1f} stops/min, {made.reached_mps:.2f} m/s, "
        f"{made.after_cut_m:.2f} m after a cut"
    )
    return f"{profile.name}, {asked_mps:g} m/s asked{deadman}", text, goal


def latency_rows(seconds: float) -> list[Row]:
    """The table of docs/commands.md: every latency with every deadman, 30 % jitter, 1 % loss."""
    found: list[Row] = []
    for one_way_ms in ONE_WAYS_MS:
        for deadman_s in DEADMANS_S:
            link = LinkProfile("", one_way_ms / 1e3, jitter=0.3, loss=0.01, deadman_s=deadman_s)
            made = trip(link, TOP_MPS, seconds)
            figure = f"{made.reached_mps:.2f} m/s, {made.moving:.0%}, {made.stops_per_min:.0f} stops/min"
            found.append((f"{one_way_ms} ms one way, deadman {deadman_s:g} s", figure, ""))
    return found
