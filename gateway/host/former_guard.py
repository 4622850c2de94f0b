"""The guard of a gateway that died: it may still be stopping the robot when the next gateway is there."""

from __future__ import annotations

import threading
import time
from datetime import UTC, datetime
from typing import Final

from gateway.host.realtime import request_realtime
from gateway.host.stop_note import StopNote

STOP_MAX_S: Final = 10.0
"""A guard that has said nothing for so long is not waited for: a stop from the highest speed takes half of it."""

_POLL_S: Final = 0.05

_OURS: Final = "guard: "
_DONE: Final = (f"{_OURS}done: ", f"{_OURS}given up: ")


class FormerGuard:
    """Reads in the note that a guard begins or ends a stop. The disk is read on a thread of its own.

    Attributes:
        is_stopping: it has begun a stop lately, and has not said how that ended.
        says: how it ended; empty until it is known, and where the stop was over before this start.
    """

    def __init__(self, note: StopNote, realtime_priority: int = 0) -> None:
        """Look once, and if a stop is under way, on a thread.

        Args:
            note: of the robot.
            realtime_priority: of the thread, which must not hold the interpreter while others run: that of the
                process's main thread.
        """
        self.says = ""
        self._realtime_priority = realtime_priority
        left_s = _left_s(note)
        self.is_stopping = left_s > 0
        self._until_s = time.monotonic() + left_s
        self._note = note
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="former-guard", daemon=True)
        if self.is_stopping:
            self._thread.start()

    def close(self) -> None:
        """Look no more."""
        self._closing.set()
        if self._thread.ident is not None:
            self._thread.join(_POLL_S * 2)

    def _follow(self) -> None:
        request_realtime(self._realtime_priority)
        while time.monotonic() < self._until_s and not self._closing.wait(_POLL_S):
            last = self._note.last()
            if last is not None and last[1].startswith(_DONE):
                self.says = last[1].removeprefix(_OURS).removeprefix("done: ")
                break
        self.is_stopping = False


def _left_s(note: StopNote) -> float:
    """For how long a guard is to be waited for that stops the robot by now; 0 if none does."""
    last = note.last()
    if last is None or not last[1].startswith(_OURS) or last[1].startswith(_DONE):
        return 0.0
    age_s = (datetime.now(UTC) - last[0]).total_seconds()
    return max(0.0, STOP_MAX_S - age_s) if age_s >= 0 else 0.0
