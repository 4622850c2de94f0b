"""More frames than a gateway can read."""

import signal
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import Final

from tests.socketcan.can_utils import send
from tests.socketcan.hearing import Hearing, hearing
from tests.socketcan.interface import Vcan
from tests.socketcan.road import gateway
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running

FLOOD: Final = 20_000
"""More than its buffer holds."""

GROWTH_KB: Final = 4_096
"""Of memory, from one flood to the next but for one: less than the frames of one would take."""


def flood(vcan: Vcan, running: Running) -> None:
    """Frames of any identifier as fast as they can be made, for a gateway that stands still meanwhile."""
    running.process.send_signal(signal.SIGSTOP)
    command = ["cangen", vcan.name, "-g", "0", "-n", str(FLOOD), "-e"]
    subprocess.run(command, check=True, timeout=100)
    running.process.send_signal(signal.SIGCONT)


def memory_kb(running: Running) -> int:
    status = Path(f"/proc/{running.process.pid}/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))


def count(heard: Hearing, before: int) -> tuple[int, int]:
    """The frames read and those dropped, once more were read than before and no more are waiting."""
    heard.wait_healthy(lambda health: health.frames > before)
    health = heard.wait_healthy(lambda health: health.frames_per_s == 0)
    return health.frames, health.bus_drops


def test_what_the_kernel_drops_is_counted_to_the_frame(vcan: Vcan) -> None:
    """Read and dropped are all that were sent, flood after flood; and it goes on, no larger than it was."""
    endpoint = free_endpoint()
    with gateway(vcan.name, endpoint) as running, hearing(endpoint, "gateway/health") as heard:
        sent = read = 0
        sizes_kb = []
        for _ in range(4):
            flood(vcan, running)
            read, _ = count(heard, read)
            # The kernel tells of what it dropped with the frame that comes next.
            send(vcan.name, 0x123, b"")
            read, dropped = count(heard, read)
            sent += FLOOD + 1
            assert (read + dropped, dropped > 0) == (sent, True)
            sizes_kb.append(memory_kb(running))
        # Once, when most of a flood is read in one go, room for it is made and kept; it is not made again.
        growths_kb = sorted(after - before for before, after in pairwise(sizes_kb))
        assert sum(growths_kb[:-1]) < GROWTH_KB, sizes_kb
        assert heard.health.bus_losses == 0
        assert len(heard.health.unknown_identifiers) == 65
        assert running.stop() == 0
