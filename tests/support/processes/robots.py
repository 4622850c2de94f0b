"""Many robots' states from one process: the load of a desk.

Usage: python -m tests.support.processes.robots COUNT, until SIGTERM
"""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from tests.support.fakes.fleet import FakeFleet


def name_of(number: int) -> str:
    return f"robot-{number:04}"


@contextmanager
def robots(count: int) -> Iterator[str]:
    """Robots that publish meanwhile. Yields their endpoint."""
    words = [sys.executable, "-m", "tests.support.processes.robots", str(count)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip()
        finally:
            process.terminate()


if __name__ == "__main__":
    with FakeFleet(int(sys.argv[1]), moves=True) as fleet:
        print(fleet.listen, flush=True)  # noqa: T201 - whoever started it reads this
        signal.pause()
