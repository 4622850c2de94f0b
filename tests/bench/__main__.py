"""``make bench``: the figures of the design, measured here and now, as a table. Not a test: machines differ.

Usage: python -m tests.bench [--seconds N] [--kills N] [--short]
"""

from __future__ import annotations

import argparse
import os
import platform
from typing import Final

import msgspec

from tests.bench import (
    command_latency,
    flood,
    guard_latency,
    links,
    path_cost,
    recorder_rate,
    review_export,
    review_rate,
)
from tests.bench.loads import Row, load_rows, print_table
from tests.bench.on_vcan import vcan
from tests.bench.processes import quantile


class Extent(msgspec.Struct, frozen=True, kw_only=True):
    """How much is measured.

    Attributes:
        seconds: of each load.
        kills: of the gateway, at 2 m/s.
        path_rounds, recorder_rounds, export_rounds: paired runs of ours and others.
        drives, stops, ticks, floods: of commands.
        link_s, goal_s: simulated, of each bad link, and of the one with a goal.
        review_mb, review_minutes, export_messages: sizes of the logs.
    """

    seconds: float = 20.0
    kills: int = 10
    path_rounds: int = path_cost.ROUNDS
    drives: int = 500
    stops: int = 20
    ticks: int = 3000
    floods: int = 10
    link_s: float = links.SECONDS
    goal_s: float = links.GOAL_SECONDS
    recorder_rounds: int = recorder_rate.ROUNDS
    review_mb: int = 100
    review_minutes: float = 2.0
    export_messages: int = review_export.MESSAGES
    export_rounds: int = review_export.ROUNDS


SHORT: Final = Extent(
    seconds=1.0,
    kills=2,
    path_rounds=1,
    drives=50,
    stops=2,
    ticks=300,
    floods=1,
    link_s=10.0,
    goal_s=60.0,
    recorder_rounds=1,
    review_mb=10,
    review_minutes=0.5,
    export_messages=20_000,
    export_rounds=1,
)
"""Enough to see that each bench runs; its figures say nothing."""


def main() -> None:
    """Measure everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each load (default 20)")
    parser.add_argument("--kills", type=int, default=10, help="of the gateway, at 2 m/s (default 10)")
    parser.add_argument("--short", action="store_true", help="a little of each: to see that it runs")
    arguments = parser.parse_args()
    print_table(measure(SHORT if arguments.short else Extent(seconds=arguments.seconds, kills=arguments.kills)))


def measure(extent: Extent) -> list[Row]:
    """Every figure."""
    seconds = extent.seconds
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    print(f"{machine}; each load {seconds:g} s")
    cost = path_cost.measure(extent.path_rounds)
    rows: list[Row] = [
        ("CPU of a frame, from the frame to its sample", f"{cost.path_us:.1f} us", ""),
        ("  by cantools, json.dumps, session.put", f"{cost.peer_us:.1f} us", ""),
        ("  ratio", f"{cost.ratio:.1f} x less", "3 x less"),
        ("  with raw batches, state and health too", f"{cost.whole_us:.1f} us, {cost.whole_ratio:.1f} x less", ""),
    ]
    rows += load_rows(seconds)
    with vcan() as interface:
        if interface:
            rows += load_rows(seconds, interface)
    rows += command_rows(command_latency.measure(extent.drives, extent.stops, extent.ticks))
    rows += flood_rows(flood.measure(extent.floods))
    rows += [guard_row(latency) for latency in guard_latency.measure(extent.kills)]
    rows += links.rows(extent.link_s, extent.goal_s)
    rows += recorder_rate.rows(extent.recorder_rounds, min(seconds, recorder_rate.HELD_S), seconds)
    rows += review_rate.rows(extent.review_mb, extent.review_minutes)
    return rows + review_export.rows(extent.export_messages, extent.export_rounds)


def command_rows(latency: command_latency.CommandLatency) -> list[Row]:
    """Commands, from the put to the bus."""
    drive, stop, tick = (
        [quantile(values_us, share) for share in (0.5, 0.99)]
        for values_us in (latency.drive_us, latency.stop_us, latency.tick_us)
    )
    return [
        (
            "drive put to first CAN frame, p50 p99",
            f"{_ms(drive)} ms, of {len(latency.drive_us)}",
            "p99 under 15 ms",
        ),
        ("remote stop put to first stop frame, p50 p99", f"{_ms(stop)} ms, of {len(latency.stop_us)}", ""),
        ("arbiter's tick, engaged, CPU, p50 p99", f"{tick[0]:.0f} {tick[1]:.0f} us", ""),
    ]


def flood_rows(flooded: flood.Flooded) -> list[Row]:
    """What a flood of drive commands does."""
    return [
        (
            f"flood of {flooded.puts_per_s:.0f} puts/s: tick lateness, max",
            f"{_ms([max(flooded.late_us)])} ms",
            "20 ms",
        ),
        ("  remote stop put to first stop frame, max", f"{_ms([max(flooded.stop_us)])} ms", "100 ms"),
    ]


def guard_row(latency: guard_latency.GuardLatency) -> Row:
    """How fast the guard is."""
    figure = f"{latency.signal.name} at 2 m/s to first stop frame, p50 p99 max"
    return figure, f"{latency.figures}, of {len(latency.after_ms)}", "under 100 ms"


def _ms(values_us: list[float]) -> str:
    return " ".join(f"{value_us / 1000:.1f}" for value_us in values_us)


if __name__ == "__main__":
    main()
