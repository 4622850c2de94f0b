"""``make bench``: the figures of the design, measured here and now, as a table. Not a test: machines differ.

Usage: python -m tests.bench [--seconds N]
"""

from __future__ import annotations

import argparse
import os
import platform

from tests.bench import path_cost
from tests.bench.processes import NOMINAL_FRAMES_PER_S, Load, quantile, run_load

SATURATED_FRAMES_PER_S = 7500


def main() -> None:
    """Measure everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each load (default 20)")
    seconds = parser.parse_args().seconds
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    print(f"{machine}; each load {seconds:g} s")
    cost = path_cost.measure()
    rows = [
        ("CPU of a frame, from the frame to its sample", f"{cost.path_us:.1f} us", ""),
        ("  by cantools, json.dumps, session.put", f"{cost.peer_us:.1f} us", ""),
        ("  ratio", f"{cost.ratio:.1f} x less", "3 x less"),
        ("  with raw batches, state and health too", f"{cost.whole_us:.1f} us, {cost.whole_ratio:.1f} x less", ""),
    ]
    for name, frames_per_s, goal_ms in (
        ("nominal", NOMINAL_FRAMES_PER_S, 2),
        ("saturated 1 Mbit/s", SATURATED_FRAMES_PER_S, 5),
    ):
        rows += load_rows(name, run_load(frames_per_s, seconds), goal_ms)
    width = max(len(row[0]) for row in rows)
    print(f"{'figure':{width}}  {'measured':34}  goal")
    for figure, measured, goal in rows:
        print(f"{figure:{width}}  {measured:34}  {goal}")


def load_rows(name: str, load: Load, goal_ms: int) -> list[tuple[str, str, str]]:
    """The rows of one load."""
    latency = [f"{quantile(load.latency_us, share) / 1000:.2f}" for share in (0.5, 0.99)]
    lateness = [f"{quantile(load.lateness_us, share) / 1000:.2f}" for share in (0.5, 0.99, 0.999, 1)]
    is_nominal = load.frames_per_s == NOMINAL_FRAMES_PER_S
    return [
        (f"{name}: {load.frames_per_s:g} frames/s", f"{load.frames} in the log", ""),
        ("  frames lost, samples missed", f"{load.lost}, {load.missed}", "0, 0"),
        (
            "  gateway's CPU, all of it",
            f"{load.gateway_cpu_percent:.0f} %, {load.gateway_cpu_us:.0f} us a frame",
            "" if is_nominal else "under 100 %",
        ),
        ("  chassis to subscriber, p50 p99", f"{' '.join(latency)} ms", "p99 under 5 ms" if is_nominal else ""),
        ("  tick lateness, p50 p99 p99.9 max", f"{' '.join(lateness)} ms", f"p99.9 under {goal_ms} ms"),
    ]


if __name__ == "__main__":
    main()
