"""The messages that wait for one browser. A slow one gets the newest: rows are merged, old samples go. Pure."""

from __future__ import annotations

from collections import deque
from typing import Final

from gateway.desk.words import DeskRows, DeskSample, RecorderRow, RobotRow, ToBrowser

SAMPLES_WAITING: Final = 64
"""Samples of the robot that is shown closely; a second of them. Beyond it the oldest go."""

WAITING: Final = 512
"""Replies and all else that may wait; a browser that reads fewer is cut off."""


class BrowserOutbox:
    """Messages for one browser.

    Attributes:
        robot: the one that it shows closely; empty if none.
        is_full: it does not read, and should be cut off.
    """

    def __init__(self) -> None:
        self.robot = ""
        self.is_full = False
        self._messages: deque[ToBrowser] = deque()
        self._samples: deque[DeskSample] = deque(maxlen=SAMPLES_WAITING)
        self._rows: dict[str, RobotRow | None] = {}
        self._recorders: list[RecorderRow] | None = None
        self._linked: bool | None = None
        self._full = False

    def look(self, robot: str) -> None:
        """Show another robot closely. Samples of the one before are of no use any more."""
        self.robot = robot
        self._samples.clear()

    def add(self, message: ToBrowser) -> None:
        """Add a message that may not be left out."""
        if isinstance(message, DeskSample):
            self._samples.append(message)
        elif len(self._messages) < WAITING:
            self._messages.append(message)
        else:
            self.is_full = True

    def add_rows(
        self,
        rows: dict[str, RobotRow | None],
        recorders: list[RecorderRow] | None,
        *,
        linked: bool,
        full: bool = False,
    ) -> None:
        """Add the rows that have changed; those that still wait are replaced."""
        self._rows |= rows
        self._recorders = self._recorders if recorders is None else recorders
        self._linked, self._full = linked, full

    def take(self) -> list[ToBrowser]:
        """Return all that waits, and keep nothing of it."""
        taken: list[ToBrowser] = [*self._messages]
        self._messages.clear()
        if self._linked is not None:
            taken.append(DeskRows(self._rows, self._linked, self._recorders, self._full))
            self._rows, self._recorders, self._linked = {}, None, None
        taken += self._samples
        self._samples.clear()
        return taken
