"""A chassis on a served bus, a stand-in for the gateway, its guard, and somebody who writes down who sent what."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import IO

import msgspec

from gateway.can.can_bus import Bus
from gateway.can.open_bus import open_bus
from gateway.chassis.cruiser.frames import MOTION_FRAMES, load
from gateway.chassis.cruiser.guard_view import ChassisView
from gateway.chassis.frame import Frame
from schemas.messages import Mode, Variant
from schemas.settings import CanSettings
from tests.support.processes.gateway import chassis
from tests.support.waiting import wait_until

ATTEMPTS = 5
DRIVEN_MPS = 0.5

COMMANDS = {message.can_id: message.name for message in load(Variant.COARSE).commands}


class Burst(msgspec.Struct):
    at_ns: int
    frames: list[Frame]

    @property
    def is_by_guard(self) -> bool:
        """The stand-in lights the lamp in each burst; the guard never does, but puts it out."""
        return not any(COMMANDS[frame.can_id] == "Auto_LightCmd" and frame.data[0] & 1 for frame in self.frames)

    @property
    def names(self) -> list[str]:
        return [COMMANDS[frame.can_id] for frame in self.frames]


class Listener:
    """Reads the bus on a thread; ``silence`` counts feedback frames since the last command."""

    def __init__(self, bus: Bus) -> None:
        self.view = ChassisView()
        self.bursts: list[Burst] = []
        self.silence = 0
        self._bus = bus
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._bus.close()

    def mode(self) -> Mode:
        return self.view.mode(time.monotonic_ns())

    def stands(self) -> bool:
        return self.view.stands(Variant.COARSE, time.monotonic_ns())

    def speed_mps(self) -> float:
        return self.view.slowest_mps(Variant.COARSE, time.monotonic_ns()) or 0.0

    def by_guard(self) -> list[Burst]:
        """The guard's bursts, without one that may still be incomplete."""
        return [burst for burst in self.bursts[:-1] if burst.is_by_guard]

    def _listen(self) -> None:
        while not self._ended.is_set():
            frame = self._bus.receive(0.05)
            if frame is None:
                continue
            now_ns = time.monotonic_ns()
            self.view.receive(frame, now_ns)
            self.silence = 0 if frame.can_id in COMMANDS else self.silence + 1
            if COMMANDS.get(frame.can_id) == MOTION_FRAMES[0] or (frame.can_id in COMMANDS and not self.bursts):
                self.bursts.append(Burst(now_ns, [frame]))
            elif frame.can_id in COMMANDS:
                self.bursts[-1].frames.append(frame)


class Watched:
    def __init__(self, address: str, listener: Listener, speed_mps: float) -> None:
        self.address = address
        self.listener = listener
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.processes.guard_stand_in", address, str(speed_mps)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.said: list[str] = []
        self.complaints: list[str] = []
        self._threads = [
            threading.Thread(target=self._read, args=[self.process.stdout, self.said]),
            threading.Thread(target=self._read, args=[self.process.stderr, self.complaints]),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def guard(self) -> int:
        wait_until(lambda: bool(self._values("guard")))
        return int(self._values("guard")[0])

    def wait_says(self, line: str) -> None:
        wait_until(lambda: line in self.said)

    def send_signal(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def guard_lives(self) -> bool:
        try:
            status = Path(f"/proc/{self.guard}/stat").read_text(encoding="ascii")
        except FileNotFoundError:
            return False
        return status.rpartition(")")[2].split()[0] != "Z"

    def wait_guard_gone(self) -> None:
        wait_until(lambda: not self.guard_lives())

    @property
    def late_ms(self) -> int:
        return int(self._values("late_ms")[0])

    def close(self) -> None:
        """End the stand-in in any state, and let the guard finish."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        for thread in self._threads:
            thread.join()
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()

    def _values(self, name: str) -> list[str]:
        return [line.partition(" ")[2] for line in list(self.said) if line.startswith(f"{name} ")]

    @staticmethod
    def _read(stream: IO[str] | None, lines: list[str]) -> None:
        lines.extend(line.rstrip("\n") for line in stream or ())


@contextmanager
def listening(address: str) -> Iterator[Listener]:
    with closing(Listener(open_bus(CanSettings(interface="socketcand", channel=address)))) as listener:
        yield listener


@contextmanager
def watched(speed_mps: float = 1.0) -> Iterator[Watched]:
    """A stand-in that a guard watches, driving; again from the start where a busy machine made the guard act."""
    for _ in range(ATTEMPTS):
        with (
            chassis() as (_, address),
            listening(address) as listener,
            closing(Watched(address, listener, speed_mps)) as running,
        ):
            wait_until(lambda: listener.speed_mps() >= DRIVEN_MPS or bool(listener.by_guard()))
            if not listener.by_guard():
                yield running
                return
    raise AssertionError(f"the guard stopped the robot {ATTEMPTS} times")
