"""An answer that takes long ends when somebody stops it."""

from __future__ import annotations

from collections.abc import Callable

from recorder.reading.rows import Progress


def heeding(progress: Progress, stopped: Callable[[], bool]) -> Progress:
    """The same progress, which interrupts whoever tells of it once the command was stopped.

    Args:
        progress: what is to be told.
        stopped: whether the command was stopped.
    """

    def told(count: int) -> None:
        if stopped():
            raise KeyboardInterrupt
        progress(count)

    return told
