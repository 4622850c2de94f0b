"""``make bench``: the figures of the design, measured here and now, as a table. Not a test: machines differ.

Usage: python -m tests.bench [BENCH...] [--short] [--seconds N] ...; without a name, those of ``make bench``
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections.abc import Callable
from typing import Final

import msgspec

from schemas.settings import FULL, OPERATOR, PROFILES
from tests.bench import (
    authority,
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
    review_export,
    review_find,
    review_rate,
    review_rerun,
    signed_latency,
    start_cost,
    thin_link,
)
from tests.bench.loads import Row, print_table
from tests.bench.origin import heading


class Extent(msgspec.Struct, frozen=True, kw_only=True):
    """How much is measured, each a flag. By itself so much as takes ten minutes.

    Attributes:
        seconds: of each load.
        kills: of the gateway, at 2 m/s.
        recorder_kills: of a recorder.
        held_s, sustain_s: of robots at their own pace, each number of them, and of the long run.
        robots, routers, shards, profile: of the fleet; how much leaves each robot.
        path_rounds, recorder_rounds, export_rounds: paired runs of ours and others.
        authority_rounds: of each step of a proof.
        trip_s: simulated, of each trip of the odometry.
        starts, rest_s: of a gateway, and until memory is read.
        turns, turn_drives: of open and signed mode, and the drive commands of each.
        drives, stops, ticks, floods: of commands.
        link_s, goal_s: simulated, of each bad link, and of the one with a goal.
        presses, desk_kills, crowd_s: of a pointer and of the browser on the desk; of its crowd.
        review_mb, export_messages: sizes of the logs.
        minutes, driven: of the logs that run again, and how their robots are driven.
        cataloged_logs: number of the logs that are searched.
        profiles, thin_s: of what leaves a robot; standing, and driven, in each of them.
    """

    seconds: float = 20.0
    kills: int = 10
    recorder_kills: int = 20
    path_rounds: int = 15
    authority_rounds: int = 15
    trip_s: float = 100.0
    starts: int = 15
    rest_s: float = 10.0
    turns: int = 2
    turn_drives: int = 250
    drives: int = 500
    stops: int = 10
    ticks: int = 3000
    floods: int = 5
    link_s: float = 30.0
    goal_s: float = 300.0
    presses: int = 50
    desk_kills: int = 5
    crowd_s: float = 20.0
    recorder_rounds: int = 2
    held_s: float = 5.0
    sustain_s: float = 20.0
    robots: tuple[int, ...] = (40,)
    routers: int = 2
    shards: int = fleet.SHARDS
    profile: str = FULL
    review_mb: int = 100
    minutes: float = 1.0
    driven: tuple[str, ...] = tuple(review_rerun.DRIVES)
    export_messages: int = 500_000
    export_rounds: int = 3
    cataloged_logs: int = 50_000
    profiles: tuple[str, ...] = tuple(PROFILES)
    thin_s: float = 5.0


SHORT: Final = Extent(
    seconds=1.0,
    kills=2,
    recorder_kills=1,
    path_rounds=1,
    authority_rounds=1,
    trip_s=5.0,
    starts=1,
    rest_s=1.0,
    turns=1,
    turn_drives=30,
    drives=50,
    stops=2,
    ticks=300,
    floods=1,
    link_s=10.0,
    goal_s=60.0,
    presses=5,
    desk_kills=1,
    crowd_s=1.0,
    recorder_rounds=1,
    held_s=1.0,
    sustain_s=1.0,
    robots=(5,),
    review_mb=10,
    minutes=0.5,
    export_messages=20_000,
    export_rounds=1,
    cataloged_logs=500,
    profiles=(OPERATOR,),
    thin_s=1.0,
)
"""Enough to see that each bench runs; its figures say nothing."""

BENCHES: Final[dict[str, Callable[[Extent], list[Row]]]] = {
    "frame": lambda on: path_cost.rows(on.path_rounds),
    "loads": lambda on: loads.rows(on.seconds),
    "vcan": lambda on: loads.vcan_rows(on.seconds),
    "commands": lambda on: command_latency.rows(on.drives, on.stops, on.ticks),
    "start": lambda on: start_cost.rows(on.starts, on.rest_s),
    "odometry": lambda on: odometry_drift.rows(on.trip_s),
    "authority": lambda on: authority.rows(on.authority_rounds),
    "signed": lambda on: signed_latency.rows(on.turns, on.turn_drives),
    "floods": lambda on: flood.rows(on.floods),
    "guard": lambda on: guard_latency.rows(on.kills),
    "links": lambda on: links.rows(on.link_s, on.goal_s),
    "thin": lambda on: thin_link.rows(on.profiles, on.thin_s),
    "desk": lambda on: desk.rows(on.presses, on.desk_kills, on.crowd_s),
    "recorder": lambda on: recorder_rate.rows(on.recorder_rounds, on.held_s, on.sustain_s),
    "fleet": lambda on: fleet.rows(on.robots, on.routers, on.shards, on.seconds, on.profile),
    "review": lambda on: review_rate.rows(on.review_mb),
    "rerun": lambda on: review_rerun.rows(on.minutes, on.driven),
    "find": lambda on: review_find.rows(on.cataloged_logs),
    "export": lambda on: review_export.rows(on.export_messages, on.export_rounds),
}
BY_NAME: Final[dict[str, Callable[[Extent], list[Row]]]] = {
    "kills": lambda on: recorder_kills.rows(on.recorder_kills),
    "growth": lambda on: fleet.growth_rows(on.seconds),
    "latencies": lambda on: links.latency_rows(on.link_s),
}
"""Those that run by their name alone."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = {**BENCHES, **BY_NAME}
    parser.add_argument("benches", nargs="*", metavar="BENCH", help=f"one or more of {', '.join(known)}")
    parser.add_argument("--short", action="store_true", help="a little of each: to see that it runs")
    for field in msgspec.structs.fields(Extent):
        flag, default = f"--{field.name.replace('_', '-')}", field.default
        one, number = (default[0], "+") if isinstance(default, tuple) else (default, None)
        parser.add_argument(flag, type=type(one), nargs=number, help=f"default {default}")
    arguments = vars(parser.parse_args())
    names, is_short = arguments.pop("benches") or list(BENCHES), arguments.pop("short")
    if unknown := set(names) - known.keys():
        parser.error(f"no such bench: {', '.join(sorted(unknown))}")
    asked = {name: value for name, value in arguments.items() if value is not None}
    extent = msgspec.structs.replace(SHORT if is_short else Extent(), **asked)
    print(heading(sys.argv[1:], extent.seconds), flush=True)
    rows, failed = measure({name: known[name] for name in names}, extent)
    if rows:
        print_table(rows)
    if failed:
        sys.exit(f"bench: not measured: {', '.join(failed)}")


def measure(benches: dict[str, Callable[[Extent], list[Row]]], extent: Extent) -> tuple[list[Row], list[str]]:
    """Every figure, and the benches that failed. Says on stderr what is being measured: it takes its time."""
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
