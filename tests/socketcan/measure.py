"""What ``run`` has to know of this machine before it boots a kernel.

Prints the nanoseconds per tick of the time stamp counter, and the number of the processor that has least to do.
Usage: python -m tests.socketcan.measure CLOCK.SO
"""

import ctypes
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

TRIES: Final = 1000
MEASURED_S: Final = 1.0
IDLE_COLUMN: Final = 4  # of a processor's line in /proc/stat


def both(ticks: Callable[[], int]) -> tuple[float, int]:
    """Read counter and clock at the same time, by the quickest of many tries."""
    tries = [(ticks(), time.monotonic_ns(), ticks()) for _ in range(TRIES)]
    before, now_ns, after = min(tries, key=lambda tried: tried[2] - tried[0])
    return (before + after) / 2, now_ns


def idle() -> dict[int, int]:
    """Return the idle time of each usable processor, in kernel ticks."""
    rows = [line.split() for line in Path("/proc/stat").read_text(encoding="ascii").splitlines()]
    columns = {row[0]: row for row in rows}
    return {number: int(columns[f"cpu{number}"][IDLE_COLUMN]) for number in os.sched_getaffinity(0)}


def main() -> None:
    ticks = ctypes.CDLL(sys.argv[1]).ticks
    ticks.restype = ctypes.c_ulong
    begun, begun_ns = both(ticks)
    idle_before = idle()
    time.sleep(MEASURED_S)
    rested = {number: idle_now - idle_before[number] for number, idle_now in idle().items()}
    ended, ended_ns = both(ticks)
    idlest = max(rested, key=lambda number: rested[number])
    sys.stdout.write(f"{(ended_ns - begun_ns) / (ended - begun)} {idlest}\n")


if __name__ == "__main__":
    main()
