"""Priorities of processes, where one processor stands for several computers, as in user-mode Linux."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Final

CHASSIS: Final = 50
PEER: Final = 40
"""Both are above the gateway's loop and the guard: what these do must not hold up a computer of its own."""


def come_first(pid: int, priority: int) -> None:
    """Run a process's threads before the gateway's; without effect unless root."""
    _schedule(pid, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, priority)


def come_as_usual(pid: int) -> None:
    _schedule(pid, os.SCHED_OTHER, 0)


def _schedule(pid: int, policy: int, priority: int) -> None:
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(PermissionError, ProcessLookupError):
            os.sched_setscheduler(int(task.name), policy, os.sched_param(priority))
