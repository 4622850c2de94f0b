"""Speed of a rerun, reading and comparing included, in one process: wall time and processor time."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from schemas.messages import Variant
from tests.bench.loads import Row
from tests.bench.review_rate import LAG_NS, Asked, ask
from tests.support.rigs.day import Day
from tests.support.rigs.gateway import Operator


def rows(minutes: float, robots: Sequence[str]) -> list[Row]:
    return [row for robot in robots for row in rerun_rows(robot, minutes)]


def rerun_rows(robot: str, minutes: float) -> list[Row]:
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "cruiser-1-20260102T030405Z.mcap"
        path.write_bytes(DRIVES[robot](minutes))
        asked = ask(["rerun", str(path)], path.parent)
    return [(f"review rerun, a robot {robot}, {minutes:g} minutes", _figures(asked, minutes), "60 x")]


def _figures(asked: Asked, minutes: float) -> str:
    length_s = minutes * 60
    return (
        f"{length_s / asked.seconds:.0f} x real time, {length_s / asked.cpu_s:.0f} x processor time, "
        f"{asked.peak_mb:.0f} MB"
    )


def driven(minutes: float) -> bytes:
    return drive(round(minutes), 4)


def alternating(minutes: float) -> bytes:
    return drive(round(minutes / 2), 66)


def drive(times: int, pause_s: float) -> bytes:
    """A log of drives of a minute each, with pauses between them."""
    day = Day(1, Variant.FINE, ticks=0)
    rig = day.rig
    rig.run(0.6)
    operator = Operator(rig)
    for _ in range(times):
        operator.take_lease("take", override=True)
        operator.engage()
        for step in range(54):
            operator.drive(1.0, 10.0 * (-1) ** (step // 9), 1.0)
        operator.ask("disengage")
        rig.run(pause_s)
    return day.rig.log(lag_ns=LAG_NS)


def standing(minutes: float) -> bytes:
    day = Day(1, Variant.FINE, ticks=0)
    day.rig.run(60 * minutes)
    return day.rig.log(lag_ns=LAG_NS)


DRIVES: Final = {"driven": driven, "alternating": alternating, "standing": standing}
