"""A machine that has other work."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

BURNERS = 6  # three for each processor of a small machine
PATIENT_DEADMAN_S = 0.5  # the most that settings allow, since a process may get no processor for a while
BURN = "import time; end_s = time.monotonic() + 60\nwhile time.monotonic() < end_s: sum(range(100_000))"


@contextmanager
def burning() -> Iterator[None]:
    """Programs that use up all processors, for a minute at most."""
    burners = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(BURNERS)]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
