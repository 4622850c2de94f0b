"""How fast the guard is: a gateway is killed or stopped at 2 m/s; when does the first stop frame come?

Usage: python -m tests.bench.guard_latency [--kills N]
"""

from __future__ import annotations

import argparse
import signal
import time
from typing import Final

import msgspec

from tests.bench.command_latency import DRIVE_ID, on_the_road, until
from tests.bench.processes import Empty, empty_loop, quantile

SPEED_MPS: Final = 2.0
SPEED_RAW: Final = 2000
SIGNALS: Final = (signal.SIGKILL, signal.SIGSTOP)


class GuardLatency(msgspec.Struct, frozen=True):
    """What one way to fail showed.

    Attributes:
        signal: what the gateway was sent, at 2 m/s.
        after_ms: from the last good frame to the first stop frame, both as a third party hears them; sorted.
        empty: of an empty loop meanwhile.
    """

    signal: signal.Signals
    after_ms: list[float]
    empty: Empty

    @property
    def figures(self) -> str:
        """p50, p99 and the longest."""
        return " ".join(f"{quantile(self.after_ms, share):.0f}" for share in (0.5, 0.99, 1)) + " ms"


def measure(kills: int = 50) -> list[GuardLatency]:
    """So many kills, half of them by each signal."""
    latencies = []
    for number in SIGNALS:
        with empty_loop() as empty:
            after_ms = sorted(_after_ms(number) for _ in range(kills // len(SIGNALS)))
        latencies.append(GuardLatency(number, after_ms, empty))
    return latencies


def _after_ms(number: signal.Signals) -> float:
    with on_the_road() as road:
        until(lambda: bool(road.driver.look()["guarded"]))
        road.driver.get_going(SPEED_MPS)
        kill_s = time.monotonic()
        road.gateway.send_signal(number)
        try:
            first_us = road.witness.first_us(kill_s, DRIVE_ID, lambda raw: raw < SPEED_RAW)
        finally:
            road.gateway.kill()
        drives = [at_s for at_s, can_id, _ in road.witness.seen if can_id == DRIVE_ID]
    first_s = kill_s + first_us / 1e6
    return (first_s - max(at_s for at_s in drives if at_s < first_s - 0.001)) * 1e3


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50, help="how often (default 50)")
    for latency in measure(parser.parse_args().kills):
        count = len(latency.after_ms)
        print(f"{latency.signal.name}: p50 p99 max {latency.figures} after the last good frame, of {count}")


if __name__ == "__main__":
    main()
