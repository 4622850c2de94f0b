"""The heartbeat in shared memory: what was written is read, and nothing that was half written ever is."""

import errno
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from gateway.guard.stopper import Beat
from gateway.host.guard_main import Heartbeat


@pytest.fixture
def heartbeat() -> Iterator[Heartbeat]:
    memory = Heartbeat.create()
    yield memory
    memory.close()


RESIZE = "import os, sys; os.truncate(sys.argv[1], int(sys.argv[2]))"


@pytest.mark.parametrize("size", [0, 1, 1 << 20])
def test_no_other_process_can_resize_it(heartbeat: Heartbeat, size: int) -> None:
    """A process of the same user that opens it through /proc is refused; both sides go on reading and writing."""
    theirs = Heartbeat(os.dup(heartbeat.descriptor))
    before = os.fstat(heartbeat.descriptor).st_size
    path = f"/proc/{os.getpid()}/fd/{heartbeat.descriptor}"
    attacker = subprocess.run(
        [sys.executable, "-c", RESIZE, path, str(size)], capture_output=True, text=True, check=False
    )
    # Looked at first: were it resized, touching the memory would end this process.
    assert os.fstat(heartbeat.descriptor).st_size == before
    assert f"[Errno {errno.EPERM}]" in attacker.stderr
    heartbeat.write_beat(Beat(1))
    assert theirs.read_beat() == Beat(1)
    theirs.close()
