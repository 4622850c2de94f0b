"""``make bench``: the figures of the design, measured here and now, as a table. Not a test: machines differ.

Usage: python -m tests.bench [--seconds N] [--kills N] [--short]
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
    path_cost,
    recorder_rate,
    review_export,
    review_find,
    review_rate,
    review_rerun,
    signed_latency,
    thin_link,
)
from tests.bench.loads import Row, beside, load_rows, print_table
from tests.bench.on_vcan import vcan
from tests.bench.origin import heading
from tests.bench.processes import quantile


class Extent(msgspec.Struct, frozen=True, kw_only=True):
    """How much is measured. By itself so much as takes ten minutes, which leaves each bench its own, longer run.

    Attributes:
        seconds: of each load.
        kills: of the gateway, at 2 m/s.
        held_s: of robots at their own pace, each number of them; at most as a load.
        fleet_robots: that speak through two routers into two recorders.
        path_rounds, recorder_rounds, export_rounds: paired runs of ours and others.
        authority_rounds: of each step of a proof.
        turns, turn_drives: of open and signed mode, and the drive commands of each.
        drives, stops, ticks, floods: of commands.
        link_s, goal_s: simulated, of each bad link, and of the one with a goal.
        presses, desk_kills, crowd_s: of a pointer and of the browser on the desk; of its crowd.
        review_mb, review_minutes, export_messages: sizes of the logs.
        cataloged_logs: number of the logs that are searched.
        thin_profiles: of what leaves a robot.
        thin_s: standing, and driven, in each of them.
    """

    seconds: float = 20.0
    kills: int = 10
    path_rounds: int = path_cost.ROUNDS
    authority_rounds: int = authority.ROUNDS
    turns: int = 2
    turn_drives: int = signed_latency.DRIVES
    drives: int = 500
    stops: int = 10
    ticks: int = 3000
    floods: int = 5
    link_s: float = 30.0
    goal_s: float = 300.0
    presses: int = desk.PRESSES
    desk_kills: int = desk.KILLS
    crowd_s: float = desk.CROWD_S
    recorder_rounds: int = 2
    held_s: float = 5.0
    fleet_robots: int = 40
    review_mb: int = 100
    review_minutes: float = 1.0
    export_messages: int = review_export.MESSAGES
    export_rounds: int = 3
    cataloged_logs: int = review_find.LOGS
    thin_profiles: tuple[str, ...] = tuple(PROFILES)
    thin_s: float = 5.0


SHORT: Final = Extent(
    seconds=1.0,
    kills=2,
    path_rounds=1,
    authority_rounds=1,
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
    fleet_robots=5,
    review_mb=10,
    review_minutes=0.5,
    export_messages=20_000,
    export_rounds=1,
    cataloged_logs=500,
    thin_profiles=(OPERATOR,),
    thin_s=1.0,
)
"""Enough to see that each bench runs; its figures say nothing."""


def main() -> None:
    """Measure everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each load (default 20)")
    parser.add_argument("--kills", type=int, default=10, help="of the gateway, at 2 m/s (default 10)")
    parser.add_argument("--short", action="store_true", help="a little of each: to see that it runs")
    arguments = parser.parse_args()
    extent = SHORT if arguments.short else Extent(seconds=arguments.seconds, kills=arguments.kills)
    print(heading(sys.argv[1:], extent.seconds), flush=True)
    rows, failed = measure(extent)
    print_table(rows)
    if failed:
        sys.exit(f"bench: not measured: {', '.join(failed)}")


def measure(extent: Extent) -> tuple[list[Row], list[str]]:
    """Every figure, and the benches that failed. Says on stderr what is being measured: it takes its time."""
    seconds = extent.seconds
    benches: list[tuple[str, Callable[[], list[Row]]]] = [
        ("the cost of a frame", lambda: path_rows(path_cost.measure(extent.path_rounds))),
        ("loads of the bus", lambda: load_rows(seconds)),
        ("loads of a vcan", lambda: vcan_rows(seconds)),
        (
            "commands",
            lambda: command_rows(command_latency.measure(extent.drives, extent.stops, extent.ticks)),
        ),
        ("authority", lambda: authority.rows(extent.authority_rounds)),
        ("commands in signed mode", lambda: signed_latency.rows(extent.turns, extent.turn_drives)),
        ("floods", lambda: flood_rows(flood.measure(extent.floods))),
        ("the guard", lambda: [row for one in guard_latency.measure(extent.kills) for row in guard_rows(one)]),
        ("bad links", lambda: links.rows(extent.link_s, extent.goal_s)),
        ("thin links", lambda: thin_link.rows(extent.thin_profiles, extent.thin_s)),
        ("the desk", lambda: desk.rows(extent.presses, extent.desk_kills, extent.crowd_s)),
        (
            "the recorder",
            lambda: recorder_rate.rows(extent.recorder_rounds, min(seconds, extent.held_s), seconds),
        ),
        ("a fleet", lambda: fleet.rows([extent.fleet_robots], 2, fleet.SHARDS, seconds, FULL)),
        ("the review", lambda: review_rate.rows(extent.review_mb)),
        ("logs run again", lambda: review_rerun.rows(extent.review_minutes, list(review_rerun.DRIVES))),
        ("the search", lambda: review_find.rows(extent.cataloged_logs)),
        ("the export", lambda: review_export.rows(extent.export_messages, extent.export_rounds)),
    ]
    begun_s = time.monotonic()
    rows: list[Row] = []
    failed: list[str] = []
    for number, (name, run) in enumerate(benches, 1):
        sys.stderr.write(f"bench {number} of {len(benches)}, after {time.monotonic() - begun_s:.0f} s: {name}\n")
        sys.stderr.flush()
        try:
            rows += run()
        except Exception:  # noqa: BLE001 - a robot that is stopped on a busy machine does not cost the other figures
            traceback.print_exc()
            failed.append(name)
    sys.stderr.write(f"bench: {time.monotonic() - begun_s:.0f} s\n")
    return rows, failed


def path_rows(cost: path_cost.PathCost) -> list[Row]:
    """A frame, from the bus to its sample."""
    return [
        ("CPU of a frame, from the frame to its sample", f"{cost.path_us:.1f} us", ""),
        ("  of that in the core; in Zenoh's put", f"{cost.core_us:.1f}; {cost.put_us:.1f} us", ""),
        ("  by cantools, json.dumps, session.put", f"{cost.peer_us:.1f} us", ""),
        ("  ratio", f"{cost.ratio:.1f} x less", "3 x less"),
        ("  with raw batches, state and health too", f"{cost.whole_us:.1f} us, {cost.whole_ratio:.1f} x less", ""),
    ]


def vcan_rows(seconds: float) -> list[Row]:
    """The loads once more on a vcan, where the kernel has one."""
    with vcan() as interface:
        return load_rows(seconds, interface) if interface else []


def command_rows(latency: command_latency.CommandLatency) -> list[Row]:
    """Commands, from the put to the bus."""
    drive, empty, difference = beside(latency.drive_us, latency.empty.put_us, (0.5, 0.99), 0.99)
    stop, _, stop_difference = beside(latency.stop_us, latency.empty.put_us, (0.5, 0.99), 0.99)
    tick = [quantile(latency.tick_us, share) for share in (0.5, 0.99)]
    return [
        ("drive put to first CAN frame, p50 p99", f"{drive}, of {len(latency.drive_us)}", ""),
        ("  an empty put meanwhile", empty, ""),
        ("  the difference", difference, "under 15 ms"),
        ("remote stop put to first stop frame, p50 p99", f"{stop}, of {len(latency.stop_us)}", ""),
        ("  the difference", stop_difference, ""),
        ("arbiter's tick, engaged, CPU, p50 p99", f"{tick[0]:.0f} {tick[1]:.0f} us", ""),
    ]


def flood_rows(flooded: flood.Flooded) -> list[Row]:
    """What a flood of drive commands does."""
    late, empty, difference = beside(flooded.late_us, flooded.empty.lateness_us, (0.5, 0.99, 1), 1)
    stop, empty_put, _ = beside(flooded.stop_us, flooded.empty.put_us, (0.5, 1), 1)
    return [
        (f"flood of {flooded.puts_per_s:.0f} puts/s: tick lateness, p50 p99 max", late, ""),
        ("  an empty loop of its priority meanwhile", empty, ""),
        ("  the difference", difference, "20 ms"),
        ("  remote stop put to first stop frame, p50 max", stop, "100 ms"),
        ("  an empty put meanwhile", empty_put, ""),
    ]


def guard_rows(latency: guard_latency.GuardLatency) -> list[Row]:
    """How fast the guard is."""
    after_us = [after_ms * 1000 for after_ms in latency.after_ms]
    after, empty, difference = beside(after_us, latency.empty.lateness_us, (0.5, 0.99, 1), 1)
    return [
        (
            f"{latency.signal.name} at 2 m/s to first stop frame, p50 p99 max",
            f"{after}, of {len(after_us)}",
            "under 100 ms",
        ),
        ("  an empty loop's lateness meanwhile", empty, ""),
        ("  the difference", difference, ""),
    ]


if __name__ == "__main__":
    main()
