"""A process that gets processor and disk only where nobody else wants them."""

from __future__ import annotations

import ctypes
import os
import platform
from contextlib import suppress
from typing import Final

IOPRIO_SET: Final = {"x86_64": 251, "aarch64": 30}
"""The number of the system call, for which Python has no function."""

IDLE_CLASS: Final = 3 << 13
"""IOPRIO_CLASS_IDLE: a disk whose scheduler knows classes serves this process when it has nothing else to do."""


def enter_background() -> None:
    """Lower this process. A service is lowered by its unit, and may not do it itself: then it stays as it is.

    Call it before there are threads: they inherit it.
    """
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, 19)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    number = IOPRIO_SET.get(platform.machine())
    if number is not None:
        ctypes.CDLL(None).syscall(number, 1, 0, IDLE_CLASS)
