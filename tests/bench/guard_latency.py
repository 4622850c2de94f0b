"""How fast the guard is: a gateway is killed or stopped at 2 m/s; when does the first stop frame come?"""

from __future__ import annotations

import signal
import time
from typing import Final

from tests.bench.command_latency import DRIVE_ID, on_the_road, until
from tests.bench.loads import Row, beside
from tests.bench.processes import empty_loop

SPEED_MPS: Final = 2.0
SPEED_RAW: Final = 2000
SIGNALS: Final = (signal.SIGKILL, signal.SIGSTOP)


def rows(kills: int) -> list[Row]:
    found: list[Row] = []
    for number in SIGNALS:
        with empty_loop() as empty:
            after_us = sorted(_after_us(number) for _ in range(kills // len(SIGNALS)))
        after, late, difference = beside(after_us, empty.lateness_us, (0.5, 0.99, 1), 1)
        name = f"{number.name} at 2 m/s to first stop frame, p50 p99 max"
        found += [
            (name, f"{after}, of {len(after_us)}", "under 100 ms"),
            ("  an empty loop's lateness meanwhile", late, ""),
            ("  the difference", difference, ""),
        ]
    return found


def _after_us(number: signal.Signals) -> float:
    """Microseconds from the last good frame to the first stop frame, as a witness sees them."""
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
    return (first_s - max(at_s for at_s in drives if at_s < first_s - 0.001)) * 1e6
