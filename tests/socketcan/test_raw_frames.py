"""A gateway on a shared bus, with and without ``can.raw_frames``, and on a flooded bus."""

import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Final

import pytest

from gateway.chassis.cruiser.frames import load
from schemas.messages import Variant
from tests.socketcan.can_utils import Candump, send
from tests.socketcan.hearing import Hearing, hearing
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis, gateway
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running
from tests.support.waiting import wait_until

HEARD: Final = 500  # frames of the chassis, in a second

ALL: Final = Path("/proc/net/can/rcvlist_all")
EXACT: Final = Path("/proc/net/can/rcvlist_eff")
"""Who in this network namespace asks the kernel for every frame, and who for one extended identifier."""


@pytest.fixture
def only_chassis(tmp_path: Path) -> list[str]:
    path = tmp_path / "cruiser.toml"
    path.write_text("[can]\nraw_frames = false\n", encoding="ascii")
    return ["--config", str(path)]


def asking(path: Path, channel: str) -> list[int]:
    """Return the identifiers requested on an interface; 0 for all."""
    rows = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
    return sorted(int(row[1], 16) for row in rows if row[:1] == [channel])


def test_raw_frames_have_the_kernels_receive_times(vcan: Vcan, candump: Candump) -> None:
    endpoint = free_endpoint()
    with gateway(vcan.name, endpoint), hearing(endpoint, "gateway/health", "can/can0/rx") as heard:
        with chassis(vcan.name):
            heard.wait(lambda: len(heard.raw) > HEARD)
        heard.wait(lambda: len(heard.raw) == len(candump.frames))
    published = [(frame.wall_ns // 1000, frame.identifier, frame.data) for frame in heard.raw]
    assert published == [tuple(frame) for frame in candump.frames]


@contextmanager
def halt(vcan: Vcan) -> Iterator[None]:
    with Running("halt", "--channel", vcan.name):
        yield


def test_who_asks_the_kernel_for_what(vcan: Vcan, only_chassis: list[str]) -> None:
    one = sorted(load(Variant.COARSE).identifiers)
    asked = {
        gateway(vcan.name, free_endpoint()): ([0], one),
        gateway(vcan.name, free_endpoint(), *only_chassis): ([], sorted(2 * one)),
        halt(vcan): ([], one),
    }
    for somebody, expected in asked.items():
        with somebody:
            wait_asked(vcan, *expected)
        wait_asked(vcan, [], [])


def wait_asked(vcan: Vcan, everything: list[int], identifiers: list[int]) -> None:
    wait_until(lambda: (asking(ALL, vcan.name), asking(EXACT, vcan.name)) == (everything, identifiers))


FLOOD: Final = 20_000  # more than its buffer holds

GROWTH_KB: Final = 4_096
"""Of memory, from one flood to the next but for one: less than the frames of one would take."""


def flood(vcan: Vcan, running: Running) -> None:
    """Send frames of any identifier as fast as possible while the gateway is stopped."""
    running.process.send_signal(signal.SIGSTOP)
    command = ["cangen", vcan.name, "-g", "0", "-n", str(FLOOD), "-e"]
    subprocess.run(command, check=True, timeout=100)
    running.process.send_signal(signal.SIGCONT)


def memory_kb(running: Running) -> int:
    status = Path(f"/proc/{running.process.pid}/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))


def count(heard: Hearing, before: int) -> tuple[int, int]:
    heard.wait_healthy(lambda health: health.frames > before)
    health = heard.wait_healthy(lambda health: health.frames_per_s == 0)
    return health.frames, health.bus_drops


def test_what_the_kernel_drops_is_counted_to_the_frame(vcan: Vcan) -> None:
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
