"""The actions that wait for the disk: in their order, within a bound of memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

from recorder.record.actions import LogAction, SyncLog, WriteChunk, WriteMetadata


class LogQueue:
    """Actions that wait, the oldest first.

    Args:
        limit_bytes: the most that ``trim`` leaves, as far as messages and metadata may go.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._actions: deque[LogAction] = deque()
        self.bytes = 0
        """Memory of what waits."""
        self._misfits = 0
        """Chunks that can never fit, were everything else to go for them."""

    def __len__(self) -> int:
        return len(self._actions)

    @property
    def head(self) -> LogAction:
        """The oldest."""
        return self._actions[0]

    def put(self, action: LogAction) -> None:
        """Add an action behind the others."""
        self._actions.append(action)
        self._count(action, 1)

    def put_back(self, actions: Iterable[LogAction]) -> None:
        """Add actions before the others, in their order."""
        for action in reversed(list(actions)):
            self._actions.appendleft(action)
            self._count(action, 1)

    def take(self) -> LogAction:
        """Remove and return the oldest."""
        action = self._actions.popleft()
        self._count(action, -1)
        return action

    def trim(self, other_bytes: int) -> list[LogAction]:
        """Drop what is beyond the bound, and return it.

        First goes what can never fit. Then the oldest messages; and only when none is left, the metadata of single
        files. Which files there are, and what lasts, never goes.

        Args:
            other_bytes: other memory under the same bound.
        """
        most = self._limit_bytes - other_bytes
        dropped: list[LogAction] = []
        if self.bytes > most and self._misfits:
            dropped += self._drop(most, self._is_misfit)
        if self.bytes > most:
            dropped += self._drop(most, lambda action: isinstance(action, WriteChunk | SyncLog))
        if self.bytes > most:
            dropped += self._drop(most, lambda action: isinstance(action, WriteMetadata) and not action.lasts)
        return dropped

    def _is_misfit(self, action: LogAction) -> bool:
        # Half of the bound may be what the disk has in hand.
        return action.bytes > self._limit_bytes // 2 and isinstance(action, WriteChunk)

    def _count(self, action: LogAction, sign: int) -> None:
        self.bytes += sign * action.bytes
        self._misfits += sign * self._is_misfit(action)

    def _drop(self, most: int, may_go: Callable[[LogAction], bool]) -> list[LogAction]:
        dropped: list[LogAction] = []
        kept: list[LogAction] = []
        kept_bytes = 0
        while self._actions and self.bytes + kept_bytes > most:
            action = self.take()
            if may_go(action):
                dropped.append(action)
            else:
                kept.append(action)
                kept_bytes += action.bytes
        self.put_back(kept)
        return dropped
