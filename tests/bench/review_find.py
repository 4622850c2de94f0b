"""``cruiser review find`` on a directory of very many logs: seconds of a question, as a process and in one.

The catalog is made up, a few stops in each log; the logs are empty files of the lengths and times that it names.
So all of them are compared, and none is opened.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from recorder.review.catalog.directory import CATALOG_NAME, Catalog, to_table, write_table
from recorder.review.catalog.find import SEARCHES, FindConditions, find
from recorder.review.catalog.log_row import LoggedRobot
from schemas.reasons import Reason
from tests.bench.loads import Row
from tests.support.catalog import DRIVE, STOP, row
from tests.support.messages import SECOND, WALL_NS

ROBOTS: Final = 200
MOMENTS: Final = 12
HOUR_NS: Final = 3600 * SECOND
CRUISER: Final = Path(sys.executable).with_name("cruiser")

ASKED: Final = {
    "a stop of some robots": (
        "stops",
        FindConditions({f"cruiser-1{digit}" for digit in range(10)}, "front_bumper"),
        ("--reason=front_bumper", "--robot=cruiser-1?"),
    ),
    "drives that ended so": ("drives", FindConditions(reason="front_bumper"), ("--reason=front_bumper",)),
    "logs of an operator": ("logs", FindConditions(operator="nobody"), ("--operator=nobody",)),
}
"""Each question as a search and its conditions, and as flags."""


def rows(logs: int) -> list[Row]:
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        fill(directory, logs)
        size_mb = (directory / CATALOG_NAME).stat().st_size / 1e6
        found: list[Row] = [("logs in the catalog", f"{logs:,}, {size_mb:.1f} MB", "")]
        for about, (search, conditions, flags) in ASKED.items():
            wall_s, cpu_s, count = ask(directory, search, conditions)
            process_s = ask_as_process(directory, search, flags)
            figure = f"{wall_s:.2f} s, {cpu_s:.2f} s of CPU, {count:,} found"
            found.append((f"find: {about}", figure, "under 1 s"))
            found.append(("  as a command, from its start to its end", f"{process_s:.2f} s", ""))
    return found


def fill(directory: Path, logs: int) -> None:
    reasons = [one.value for one in Reason]
    made = []
    for number in range(logs):
        robot = f"cruiser-{number % ROBOTS}"
        start_ns = WALL_NS + number // ROBOTS * HOUR_NS
        moments = [
            msgspec.structs.replace(
                STOP,
                time_ns=start_ns + place * 60 * SECOND,
                last_ns=start_ns + place * 60 * SECOND,
                robot=robot,
                kind=("stop", "lease", "engaged", "fault", "gap")[place % 5],
                is_stop=place % 5 == 0,
                reason=reasons[(number + place) % len(reasons)],
                operator=f"operator-{number % 37}",
                text=f"what happened for the {number % 991}. time",
            )
            for place in range(MOMENTS)
        ]
        drive = msgspec.structs.replace(
            DRIVE, start_ns=start_ns, end_ns=start_ns + HOUR_NS, robot=robot, distance_m=float(number % 1000)
        )
        file = directory / f"{robot}-{number:06}.mcap"
        file.touch()
        os.truncate(file, 1000 + number)
        made.append(
            row(
                file=file.name,
                bytes=1000 + number,
                modified_ns=file.stat().st_mtime_ns,
                start_ns=start_ns,
                end_ns=start_ns + HOUR_NS,
                robots=[LoggedRobot("fleet", robot)],
                names=[robot],
                lost=number % 3,
                stops={moments[0].reason: 3},
                drives=[drive],
                moments=moments,
            )
        )
    write_table(directory / CATALOG_NAME, to_table(made))


def ask(directory: Path, search: str, conditions: FindConditions) -> tuple[float, float, int]:
    """Seconds of a question here, those of the processors, and the number of answers."""
    begun_s, begun_cpu_s = time.perf_counter(), time.process_time()
    catalog = Catalog(directory, SEARCHES[search].columns)
    count = len(find(catalog.table, search, conditions))
    if catalog.stale or catalog.notes:
        raise RuntimeError("the catalog does not hold")
    return time.perf_counter() - begun_s, time.process_time() - begun_cpu_s, count


def ask_as_process(directory: Path, search: str, flags: Sequence[str]) -> float:
    begun_s = time.perf_counter()
    words = [str(CRUISER), "review", "find", search, str(directory), *flags, "--json"]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begun_s
