"""Priorities of processes, where one processor stands for several computers, as in user-mode Linux."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

CHASSIS: Final = 50
PEER: Final = 40
"""Both are above the gateway's loop and the guard: what these do must not hold up a computer of its own."""

LAST: Final = 10  # nice: a tenth of what another has


def come_first(pid: int, priority: int) -> None:
    """Run a process's threads before the gateway's; without effect unless root."""
    _schedule(pid, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, priority)


def come_as_usual(pid: int) -> None:
    _schedule(pid, os.SCHED_OTHER, 0)


def come_last(pid: int) -> None:
    """Run a process and its children after all others."""
    for task in _tasks(pid):
        os.setpriority(os.PRIO_PROCESS, int(task.name), LAST)
        for child in (task / "children").read_text(encoding="ascii").split():
            come_last(int(child))


def _tasks(pid: int) -> Iterator[Path]:
    yield from Path(f"/proc/{pid}/task").iterdir()


def _schedule(pid: int, policy: int, priority: int) -> None:
    for task in _tasks(pid):
        with suppress(PermissionError, ProcessLookupError):
            os.sched_setscheduler(int(task.name), policy, os.sched_param(priority))
