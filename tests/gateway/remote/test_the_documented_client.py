"""The client that docs/commands.md shows, as a program of its own."""

import subprocess
import sys
import textwrap
import threading
import time
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from socket import SHUT_RDWR, socket

import pytest

from gateway.sim.relay import BUFFER_BYTES, Relay
from schemas.decisions import ArbiterState
from tests.gateway.remote.fake_robot import FakeRobot
from tests.gateway.remote.waiting import wait_until

PAGE = Path(__file__).parents[3] / "docs" / "commands.md"
ENDPOINT = "tcp/127.0.0.1:7447"
LINES_MAX = 38


class FarRelay(Relay):
    """Carries everything with a delay."""

    def __init__(self, host: str, port: int, one_way_s: float) -> None:
        self._one_way_s = one_way_s
        super().__init__(host, port)

    def _carry(self, source: socket, sink: socket) -> None:
        under_way: SimpleQueue[tuple[float, bytes]] = SimpleQueue()
        threading.Thread(target=self._deliver, args=(under_way, sink), name="relay", daemon=True).start()
        with suppress(OSError):
            while data := source.recv(BUFFER_BYTES):
                under_way.put((time.monotonic() + self._one_way_s, data))
        under_way.put((time.monotonic() + self._one_way_s, b""))

    def _deliver(self, under_way: "SimpleQueue[tuple[float, bytes]]", sink: socket) -> None:
        with suppress(OSError):
            while True:
                due_s, data = under_way.get()
                time.sleep(max(0.0, due_s - time.monotonic()))
                if not data:
                    sink.shutdown(SHUT_RDWR)
                    return
                sink.sendall(data)


def documented() -> str:
    """The program's text."""
    section = PAGE.read_text(encoding="utf-8").partition("### A whole client\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("    ") or not line]
    return textwrap.dedent("\n".join(lines)).strip()


def test_it_is_short() -> None:
    """Somebody reads it, and writes it anew in another language."""
    assert len([line for line in documented().splitlines() if line]) <= LINES_MAX


@pytest.mark.parametrize("one_way_s", [0.0, 0.2])
def test_it_drives_near_and_far(one_way_s: float) -> None:
    """Goal of the row 'travel delay': 200 ms one way. It drives, comes to rest and gives the lease back."""
    with FakeRobot() as fake:
        host, _, port = fake.listen.removeprefix("tcp/").rpartition(":")
        with FarRelay(host, int(port), one_way_s) as relay:
            program = documented()
            assert ENDPOINT in program
            done = subprocess.run(
                [sys.executable, "-c", program.replace(ENDPOINT, f"tcp/{relay.endpoint}")],
                capture_output=True,
                text=True,
                timeout=60,
                check=False,
            )
        assert (done.returncode, done.stderr) == (0, "")
        assert {one.requested_speed_mps for one in fake.accepted("drive")} == {0.0, 0.5}
        assert max(one.output_speed_mps for one in fake.accepted("drive")) == 0.5
        wait_until(lambda: fake.state is ArbiterState.STANDBY)
        assert fake.accepted("release")
