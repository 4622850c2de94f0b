"""``make bench``: measure the design's figures and print them as a table.

Usage: python -m tests.bench [BENCH...] [--short] [--seconds N] ...; without a name, those of ``make bench``
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from schemas.settings import FULL
from tests.bench import (
    command_latency,
    desk,
    fleet,
    flood,
    guard_latency,
    links,
    loads,
    odometry_drift,
    path_cost,
    recorder_kills,
    recorder_rate,
    review_rate,
    review_rerun,
    ros,
    signed_latency,
    start_cost,
)
from tests.bench.loads import Row, print_table

# Flags and their values: by default, so that all takes ten minutes, and with ``--short``.
EXTENT: Final[dict[str, tuple[Any, Any, str]]] = {
    "seconds": (20.0, 1.0, "of each load"),
    "path_rounds": (15, 1, "paired, of a frame's cost by ours and others"),
    "trip_s": (100.0, 5.0, "simulated, of each trip of the odometry"),
    "kills": (10, 2, "of the gateway, at 2 m/s"),
    "recorder_kills": (20, 1, "of a recorder"),
    "starts": (15, 1, "of a gateway"),
    "rest_s": (10.0, 1.0, "until memory is read"),
    "turns": (2, 1, "of open and signed mode"),
    "turn_drives": (250, 30, "drive commands of each"),
    "drives": (500, 50, "drive commands"),
    "stops": (10, 2, "remote stops"),
    "ticks": (3000, 300, "of the command flow"),
    "floods": (5, 1, "of commands"),
    "link_s": (60.0, 10.0, "simulated, of each latency"),
    "presses": (50, 5, "of a pointer on the desk"),
    "desk_kills": (5, 1, "of its browser"),
    "crowd_s": (20.0, 1.0, "of its crowd"),
    "recorder_rounds": (2, 1, "paired, of a full queue by ours and others"),
    "held_s": (5.0, 1.0, "of robots at their own pace, each number of them"),
    "sustain_s": (20.0, 1.0, "of the long run"),
    "robots": ((40,), (5,), "of the fleet"),
    "routers": (2, 2, "of the fleet"),
    "shards": (2, 2, "of the fleet's recorder"),
    "profile": (FULL, FULL, "of what leaves each robot"),
    "review_mb": (100, 10, "size of the log"),
    "minutes": (1.0, 0.5, "of the logs that run again"),
    "driven": (tuple(review_rerun.DRIVES), tuple(review_rerun.DRIVES), "how their robots are driven"),
}
BENCHES: Final[dict[str, Callable[[argparse.Namespace], list[Row]]]] = {
    "frame": lambda on: path_cost.rows(on.path_rounds),
    "loads": lambda on: loads.rows(on.seconds),
    "vcan": lambda on: loads.vcan_rows(on.seconds),
    "commands": lambda on: command_latency.rows(on.drives, on.stops, on.ticks),
    "start": lambda on: start_cost.rows(on.starts, on.rest_s),
    "odometry": lambda on: odometry_drift.rows(on.trip_s),
    "signed": lambda on: signed_latency.rows(on.turns, on.turn_drives),
    "ros": lambda on: ros.rows(on.drives, on.seconds),
    "floods": lambda on: flood.rows(on.floods),
    "guard": lambda on: guard_latency.rows(on.kills),
    "desk": lambda on: desk.rows(on.presses, on.desk_kills, on.crowd_s),
    "recorder": lambda on: recorder_rate.rows(on.recorder_rounds, on.held_s, on.sustain_s),
    "fleet": lambda on: fleet.rows(on.robots, on.routers, on.shards, on.seconds, on.profile),
    "review": lambda on: review_rate.rows(on.review_mb),
    "rerun": lambda on: review_rerun.rows(on.minutes, on.driven),
}
# Benches that run by their name alone.
BY_NAME: Final[dict[str, Callable[[argparse.Namespace], list[Row]]]] = {
    "kills": lambda on: recorder_kills.rows(on.recorder_kills),
    "latencies": lambda on: links.rows(on.link_s),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = {**BENCHES, **BY_NAME}
    parser.add_argument("benches", nargs="*", metavar="BENCH", help=f"one or more of {', '.join(known)}")
    parser.add_argument("--short", action="store_true", help="a little of each: to see that it runs")
    short = "--short" in sys.argv
    for name, (default, little, what) in EXTENT.items():
        one, number = (default[0], "+") if isinstance(default, tuple) else (default, None)
        flag, value = f"--{name.replace('_', '-')}", little if short else default
        parser.add_argument(flag, type=type(one), nargs=number, default=value, help=f"{what} (default {default})")
    arguments = parser.parse_args()
    names = arguments.benches or list(BENCHES)
    if unknown := set(names) - known.keys():
        parser.error(f"no such bench: {', '.join(sorted(unknown))}")
    print(heading(sys.argv[1:]), flush=True)
    rows, failed = measure({name: known[name] for name in names}, arguments)
    if rows:
        print_table(rows)
    if failed:
        sys.exit(f"bench: not measured: {', '.join(failed)}")


def heading(words: list[str]) -> str:
    """Command, commit ("-dirty" where files differ from it) and machine."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    found = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return f"{' '.join(['python -m tests.bench', *words])} at {found or 'no commit'}; {machine}"


def measure(
    benches: dict[str, Callable[[argparse.Namespace], list[Row]]], extent: argparse.Namespace
) -> tuple[list[Row], list[str]]:
    """Every figure, and the names of the benches that failed; progress goes to stderr."""
    begun_s = time.monotonic()
    rows: list[Row] = []
    failed: list[str] = []
    for number, (name, run) in enumerate(benches.items(), 1):
        sys.stderr.write(f"bench {number} of {len(benches)}, after {time.monotonic() - begun_s:.0f} s: {name}\n")
        sys.stderr.flush()
        try:
            rows += run(extent)
        except Exception:  # noqa: BLE001 - a robot that is stopped on a busy machine does not cost the other figures
            traceback.print_exc()
            failed.append(name)
    sys.stderr.write(f"bench: {time.monotonic() - begun_s:.0f} s\n")
    return rows, failed


if __name__ == "__main__":
    main()
