"""``cruiser drive`` on a pseudo-terminal, against a robot of this process."""

import itertools
import os
import pty
import select
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Self

import pytest

from schemas.decisions import ArbiterState
from schemas.messages import Mode
from schemas.reasons import Reason
from tests.support.fakes.robot import FakeRobot
from tests.support.waiting import wait_until

FIRST_REPEAT_S = LET_GO_S = 0.4
REPEAT_S = 0.05
REPEATS = 20


class Driver:
    """A person at a terminal; ``seen`` is everything that was drawn."""

    def __init__(self, endpoint: str) -> None:
        self.seen = b""
        self._master, slave = pty.openpty()
        self._slave = os.dup(slave)
        self.settings = termios.tcgetattr(slave)
        # A process that gets no processor in time shall not end the drive.
        words = ["drive", "cruiser-1", "--operator", "first", "--speed", "0.5", "--deadman", "1"]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "gateway", *words, "--connect", endpoint],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "120", "LINES": "40"},
        )
        os.close(slave)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._ended.set()
        self._thread.join()
        os.close(self._slave)
        if self._master >= 0:
            os.close(self._master)

    def types(self, keys: bytes) -> Callable[[], None]:
        """Return a function to call repeatedly: it presses, repeats and releases a key, as a keyboard does."""
        pauses_s = itertools.cycle([FIRST_REPEAT_S, *[REPEAT_S] * REPEATS, LET_GO_S])
        due_s = 0.0

        def press() -> None:
            nonlocal due_s
            now_s = time.monotonic()
            if now_s >= due_s:
                due_s = now_s + next(pauses_s)
                os.write(self._master, keys)

        return press

    def wait_shows(self, text: str) -> None:
        wait_until(lambda: text.encode() in self.seen)

    def hang_up(self) -> None:
        self._ended.set()
        self._thread.join()
        os.close(self._master)
        self._master = -1

    def modes(self) -> list[object]:
        return termios.tcgetattr(self._slave)

    def _look(self) -> None:
        while not self._ended.is_set():
            if not select.select([self._master], [], [], 0.02)[0]:
                continue
            with suppress(OSError):
                self.seen += os.read(self._master, 65536)


def test_a_key_that_repeats_drives_and_its_end_stops() -> None:
    with FakeRobot() as fake, Driver(fake.listen) as driver:
        wait_until(lambda: fake.state is ArbiterState.ENGAGED)
        wait_until(lambda: fake.speed_mps > 0.3, driver.types(b"w"))
        wait_until(lambda: fake.speed_mps == 0.0)
        wait_until(lambda: fake.speed_mps < -0.1, driver.types(b"\x1b[B"))
        driver.types(b"x")()
        assert driver.process.wait(30) == 0
        assert fake.state is ArbiterState.STANDBY
        assert len(fake.accepted("release")) == 1
        assert driver.modes() == driver.settings


@pytest.mark.parametrize("key", [b"\x03", b"q"])
def test_ctrl_c_and_q_stop_and_leave(key: bytes) -> None:
    with FakeRobot() as fake, Driver(fake.listen) as driver:
        wait_until(lambda: fake.state is ArbiterState.ENGAGED)
        wait_until(lambda: fake.speed_mps > 0.1 and fake.angle_deg > 10, driver.types(b"u"))
        driver.types(key)()
        assert driver.process.wait(30) == 0
        assert fake.state is ArbiterState.STANDBY
        driver.wait_shows("cruiser-1: stopped and on standby; lease released")


def test_a_window_that_is_closed_stops_the_robot() -> None:
    with FakeRobot() as fake, Driver(fake.listen) as driver:
        wait_until(lambda: fake.state is ArbiterState.ENGAGED)
        wait_until(lambda: fake.speed_mps > 0.1, driver.types(b"w"))
        driver.hang_up()
        wait_until(lambda: fake.state is ArbiterState.STANDBY)


def test_why_it_stands_is_shown_and_r_and_g_bring_it_back() -> None:
    with FakeRobot() as fake, Driver(fake.listen) as driver:
        wait_until(lambda: fake.state is ArbiterState.ENGAGED)
        wait_until(lambda: fake.speed_mps > 0.1, driver.types(b"w"))
        fake.front_bumper = True
        wait_until(lambda: fake.state is ArbiterState.STANDBY, driver.types(b"w"))
        driver.wait_shows("the front bumper was hit")
        fake.front_bumper = False
        driver.types(b"r")()
        wait_until(lambda: Reason.FRONT_BUMPER not in fake.flow.arbiter.latches.details)
        assert len(fake.accepted("engage")) == 1
        driver.types(b"g")()
        wait_until(lambda: fake.state is ArbiterState.ENGAGED)
        assert fake.speed_mps == 0.0


def test_a_robot_that_cannot_be_engaged_is_shown_with_the_reason() -> None:
    with FakeRobot(mode=Mode.REMOTE) as fake, Driver(fake.listen) as driver:
        driver.wait_shows("the remote control has the robot")
        assert driver.process.poll() is None
        assert not fake.accepted("engage")
