"""The cost of a bad link: a simulated robot driven by the library's own stream, in simulated time."""

from __future__ import annotations

from typing import Final

from schemas.settings import DEADMAN_MAX_S, CommandSettings
from tests.bench.loads import Row
from tests.support.links import LinkProfile
from tests.support.rigs.far_operator import trip

TOP_MPS: Final = 2.2
ONE_WAYS_MS: Final = (1, 25, 50, 75, 100, 150, 200, 250, 300, 350, 400)
DEADMANS_S: Final = (CommandSettings().deadman_s, DEADMAN_MAX_S)


def rows(seconds: float) -> list[Row]:
    """The table of docs/commands.md: every latency with every deadman, 30 % jitter, 1 % loss."""
    found: list[Row] = []
    for one_way_ms in ONE_WAYS_MS:
        for deadman_s in DEADMANS_S:
            link = LinkProfile("", one_way_ms / 1e3, jitter=0.3, loss=0.01, deadman_s=deadman_s)
            made = trip(link, TOP_MPS, seconds)
            figure = f"{made.reached_mps:.2f} m/s, {made.moving:.0%}, {made.stops_per_min:.0f} stops/min"
            found.append((f"{one_way_ms} ms one way, deadman {deadman_s:g} s", figure, ""))
    return found
