"""Lines typed while a command runs."""

import os
import pty
import subprocess
import sys
from collections.abc import Iterator

import pytest


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A pseudo-terminal: the side that types, and the side that reads."""
    ends = pty.openpty()
    yield ends
    for end in ends:
        os.close(end)


IN_BACKGROUND = """
import fcntl, os, sys, termios
from gateway.cli.sim import TypedLines
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.tcsetpgrp(0, os.getpgrp())
child = os.fork()
if not child:
    os.setpgid(0, 0)  # as a shell does for a command that ends with '&'
    os._exit(0 if TypedLines(0).read() == [] else 1)
_, status = os.waitpid(child, os.WUNTRACED)
sys.exit(os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else 2)
"""


def test_from_the_background_a_terminal_is_not_read(terminal: tuple[int, int]) -> None:
    """Reading it would stop the process, and what is typed there is meant for another."""
    os.write(terminal[0], b"clear\n")
    process = subprocess.run(
        [sys.executable, "-c", IN_BACKGROUND], stdin=terminal[1], start_new_session=True, check=False, timeout=20
    )
    assert process.returncode == 0
