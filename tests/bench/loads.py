"""Chassis, gateway and recorder under the load of a bus, as rows of the table."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from tests.bench.processes import NOMINAL_FRAMES_PER_S, Load, quantile, run_load

SATURATED_FRAMES_PER_S: Final = 7500
# Name, frames/s, goal for the lateness of ticks in ms.
LOADS = (("nominal", NOMINAL_FRAMES_PER_S, 2), ("saturated 1 Mbit/s", SATURATED_FRAMES_PER_S, 5))
Row = tuple[str, str, str]  # figure, measured, goal


def rows(seconds: float, vcan: str = "") -> list[Row]:
    return [
        row
        for name, frames_per_s, goal_ms in LOADS
        for row in _rows(f"{name} on {vcan}" if vcan else name, run_load(frames_per_s, seconds, vcan), goal_ms)
    ]


def vcan_rows(seconds: float) -> list[Row]:
    with _vcan() as interface:
        return rows(seconds, interface) if interface else [("loads of a vcan", "no vcan here", "")]


@contextmanager
def _vcan() -> Iterator[str]:
    name = "vcan-bench"
    made = _ip("link", "add", name, "type", "vcan") and _ip("link", "set", name, "up")
    try:
        yield name if made else ""
    finally:
        if made:
            _ip("link", "delete", name)


def _ip(*words: str) -> bool:
    try:
        return subprocess.run(["ip", *words], capture_output=True, check=False).returncode == 0  # noqa: S607
    except FileNotFoundError:
        return False


def print_table(rows: list[Row]) -> None:
    width = max(len(row[0]) for row in rows)
    print(f"{'figure':{width}}  {'measured':34}  goal")
    for figure, measured, goal in rows:
        print(f"{figure:{width}}  {measured:34}  {goal}")


def beside(
    ours_us: list[float], empty_us: list[float], shares: tuple[float, ...], judged: float
) -> tuple[str, str, str]:
    """Our quantiles, an empty loop's, and the difference at the judged share."""
    difference_ms = (quantile(ours_us, judged) - quantile(empty_us, judged)) / 1000
    place = "the longest" if judged == 1 else f"p{judged * 100:g}"
    return _ms(ours_us, shares), _ms(empty_us, shares), f"{difference_ms:.2f} ms at {place}"


def _ms(values_us: list[float], shares: tuple[float, ...]) -> str:
    return " ".join(f"{quantile(values_us, share) / 1000:.2f}" for share in shares) + " ms"


def _rows(name: str, load: Load, goal_ms: int) -> list[Row]:
    latency = beside(load.latency_us, load.empty.put_us, (0.5, 0.99), 0.99)
    lateness = beside(load.lateness_us, load.empty.lateness_us, (0.5, 0.99, 0.999, 1), 0.999)
    is_nominal = load.frames_per_s == NOMINAL_FRAMES_PER_S
    return [
        (f"{name}: {load.frames_per_s:g} frames/s", f"{load.frames} in the log", ""),
        ("  frames lost, samples missed", f"{load.lost}, {load.missed}", "0, 0"),
        (
            "  gateway's CPU, all of it",
            f"{load.gateway_cpu_percent:.0f} %, {load.gateway_cpu_us:.0f} us a frame",
            "" if is_nominal else "under 100 %",
        ),
        ("  chassis to subscriber, p50 p99", latency[0], ""),
        ("    an empty put of its period meanwhile", latency[1], ""),
        ("    the difference", latency[2], "under 5 ms" if is_nominal else ""),
        ("  tick lateness, p50 p99 p99.9 max", lateness[0], ""),
        ("    an empty loop of its priority meanwhile", lateness[1], ""),
        ("    the difference", lateness[2], f"under {goal_ms} ms"),
    ]
