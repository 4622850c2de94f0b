"""The end of a command whose parent has gone, by a pipe that only the parent can close.

Separate, so that ``cruiser --help`` loads no settings.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from typing import Final

VARIABLE: Final = "CRUISER_PARENT_PIPE"  # the reading end's descriptor; the parent holds the other
END_S: Final = 20.0  # the longest time that an orderly end may take


def end_with_parent() -> None:
    """Terminate this process when its parent has ended in any way, even by SIGKILL.

    PR_SET_PDEATHSIG exists only on Linux, and acts when the thread ends that started the child.
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
