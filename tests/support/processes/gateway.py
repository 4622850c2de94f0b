"""Our own commands as real processes."""

import json
import os
import re
import secrets
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from tests.support.processes.forked import Forked
from tests.support.waiting import wait_until


class Running:
    """A ``cruiser`` command as a process; ``said`` has the lines of its stderr."""

    def __init__(self, *words: str, **environment: str) -> None:
        self.process = Forked(words, os.environ | environment)
        self.said: list[str] = []
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            kill_all(self.process.pid)
        self.process.wait()
        self._thread.join()
        self.process.stdout.close()
        self.process.stderr.close()

    def wait_says(self, pattern: str) -> re.Match[str]:
        found: list[re.Match[str]] = []

        def search() -> bool:
            # What it says last is read after its end.
            is_over = not self._thread.is_alive()
            found.extend(match for line in list(self.said) if (match := re.search(pattern, line)))
            return bool(found) or is_over

        with suppress(TimeoutError):
            wait_until(search)
        assert found, self.said
        return found[0]

    def stop(self, number: signal.Signals = signal.SIGTERM) -> int:
        self.process.send_signal(number)
        return self.process.wait(30)

    def _listen(self) -> None:
        for line in self.process.stderr:
            self.said.append(line.rstrip("\n"))


class Managed(Running):
    """A command under a service manager, which starts it again whenever it ends with 0 by itself."""

    def __init__(self, *words: str) -> None:
        self._is_stopped = False
        self._manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._manager.bind(f"\0{secrets.token_hex(8)}")
        address = "@" + self._manager.getsockname()[1:].decode()
        self._again = words, os.environ | {"NOTIFY_SOCKET": address}
        super().__init__(*words, NOTIFY_SOCKET=address)

    def __exit__(self, *raised: object) -> None:
        self._is_stopped = True
        super().__exit__(*raised)
        self._manager.close()

    def stop(self, number: signal.Signals = signal.SIGTERM) -> int:
        self._is_stopped = True
        return super().stop(number)

    def _listen(self) -> None:
        super()._listen()
        while self.process.wait() == 0 and not self._is_stopped:
            self.process.stdout.close()
            self.process.stderr.close()
            self.process = Forked(*self._again)
            super()._listen()


def kill_all(pid: int) -> None:
    """Kill a process and its children: a guard outlives its gateway while it stops the robot."""
    found = children(pid)
    os.kill(pid, signal.SIGKILL)
    for child in found:
        with suppress(FileNotFoundError, ProcessLookupError):
            kill_all(child)


def children(pid: int) -> set[int]:
    found: set[int] = set()
    with suppress(FileNotFoundError, ProcessLookupError):  # A thread has ended.
        for task in Path(f"/proc/{pid}/task").iterdir():
            found |= set(map(int, (task / "children").read_text().split()))
    return found


@contextmanager
def chassis(*words: str, listen: str = "127.0.0.1:0") -> Iterator[tuple[Running, str]]:
    """A virtual chassis and its address; with real-time priority if the user is root."""
    with Running("sim", "--listen", listen, *words) as sim:
        with suppress(PermissionError):
            os.sched_setscheduler(sim.process.pid, os.SCHED_RR, os.sched_param(1))
        yield sim, sim.wait_says(r" on (127\.0\.0\.1:\d+)")[1]


@contextmanager
def gateway(address: str, endpoint: str, *words: str, kind: type[Running] = Running) -> Iterator[Running]:
    bus = ["--interface", "socketcand", "--channel", address, "--listen", endpoint]
    with kind("gateway", *bus, *words) as running:
        running.wait_says("^gateway: ")
        yield running


def run(words: Sequence[str], timeout_s: float = 100, **environment: str) -> subprocess.CompletedProcess[str]:
    command = Forked(words, os.environ | environment)
    out, err = command.communicate(timeout_s)
    return subprocess.CompletedProcess(words, command.wait(), out, err)


def wait_for_chassis(connect: str, *words: str) -> None:
    """Wait until the gateway sees its chassis: earlier, a stop is reported as not carried out."""

    def sees() -> bool:
        lines = run(["watch", "cruiser-1", "--seconds", "0.5", "--json", "--connect", connect, *words]).stdout
        states = [json.loads(line)["safety"] for line in lines.splitlines()]
        return any(state is not None and "feedback_missing" not in state["blocked_by"] for state in states)

    wait_until(sees)
