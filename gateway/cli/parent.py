"""The end of a command whose parent is gone: by a pipe that only the parent can close.

A module of its own, so that ``cruiser --help`` loads no settings.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from typing import Final

VARIABLE: Final = "CRUISER_PARENT_PIPE"
"""Names the reading end, a file descriptor. The parent holds the other end, and writes nothing."""

END_S: Final = 20.0  # the longest time that an orderly end may take


def end_with_parent() -> None:
    """End this process as by SIGTERM when its parent is gone, however it ended.

    SIGKILL of the parent closes its end of the pipe too. PR_SET_PDEATHSIG would be Linux's alone, and would act
    where the thread ends that started the child.
    """
    pipe = os.environ.pop(VARIABLE, "")
    if pipe.isdecimal():
        threading.Thread(target=_watch, args=(int(pipe),), name="parent", daemon=True).start()


def _watch(pipe: int) -> None:
    try:
        os.read(pipe, 1)
    except OSError:
        return  # a number of somebody else's environment: there is no such pipe
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(END_S)
    os.kill(os.getpid(), signal.SIGKILL)
