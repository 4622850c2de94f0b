"""Real-time scheduling and locked memory, where the system allows them."""

from __future__ import annotations

import ctypes
import logging
import os
from typing import Final

log = logging.getLogger(__name__)

# From <sys/mman.h> on Linux. ONFAULT locks pages as they are touched, instead of all of every stack at once.
MCL_CURRENT: Final = 1
MCL_FUTURE: Final = 2
MCL_ONFAULT: Final = 4


def request_realtime(priority: int) -> bool:
    """Ask for SCHED_FIFO at this priority for the calling thread, and for locked memory.

    Args:
        priority: 1 to 99; 0 asks for nothing.

    Returns:
        Whether SCHED_FIFO was granted. A refusal of either is logged and changes nothing else.
    """
    if priority == 0:
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as error:
        log.info("no real-time scheduling: %s", error)
        return False
    if ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0:
        log.info("no locked memory: %s", os.strerror(ctypes.get_errno()))
    return True


def has_realtime() -> bool:
    """Look whether the calling thread has a real-time policy, whoever gave it."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in {os.SCHED_FIFO, os.SCHED_RR}
