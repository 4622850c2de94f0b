"""What waits for the disk: effects in their order, within a bound of bytes. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import Final

import msgspec

from recorder.record.effects import (
    DeclareChannel,
    FileEffect,
    OpenLog,
    SyncLog,
    WriteAttachment,
    WriteChunk,
    WriteMetadata,
)

ENTRY_BYTES: Final = 100
"""What an effect takes besides what it carries."""


class Waiting(msgspec.Struct, frozen=True):
    """An effect, the log that it is meant for, and the memory that it takes."""

    log: str
    effect: OpenLog | FileEffect
    bytes: int


def waiting(log: str, effect: OpenLog | FileEffect) -> Waiting:
    """An effect on its way to a log."""
    return Waiting(log, effect, ENTRY_BYTES + _size(effect))


def _size(effect: OpenLog | FileEffect) -> int:
    match effect:
        case WriteChunk():
            return len(effect.chunk.records)
        case WriteMetadata():
            return sum(len(name) + len(entry) for name, entry in effect.entries.items())
        case WriteAttachment():
            return len(effect.data)
        case DeclareChannel():
            # Its schema is one that all channels of a kind share.
            return len(effect.channel.topic)
        case _:
            return 0


class LogQueue:
    """Effects that wait, the oldest first.

    Args:
        limit_bytes: what ``trim`` leaves at most, as far as messages and metadata may go.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._ones: deque[Waiting] = deque()
        self.bytes = 0
        """Memory of what waits."""
        self._misfits = 0
        """Chunks that can never fit, were everything else to go for them."""

    def __len__(self) -> int:
        return len(self._ones)

    @property
    def head(self) -> Waiting:
        """The oldest."""
        return self._ones[0]

    def put(self, one: Waiting) -> None:
        """It waits behind the others."""
        self._ones.append(one)
        self._count(one, 1)

    def put_back(self, ones: Iterable[Waiting]) -> None:
        """These wait again, before the others."""
        for one in reversed(list(ones)):
            self._ones.appendleft(one)
            self._count(one, 1)

    def take(self) -> Waiting:
        """The oldest, which waits no more."""
        one = self._ones.popleft()
        self._count(one, -1)
        return one

    def trim(self, other_bytes: int) -> list[Waiting]:
        """Drop what is beyond the bound, and tell.

        First goes what can never fit. Then the oldest messages; and only when none is left, what is said of a
        single file. Which files there are, and what lasts, never goes.

        Args:
            other_bytes: what else is in memory, under the same bound.
        """
        most = self._limit_bytes - other_bytes
        dropped: list[Waiting] = []
        if self.bytes > most and self._misfits:
            dropped += self._drop(most, self._is_misfit)
        if self.bytes > most:
            dropped += self._drop(most, lambda one: isinstance(one.effect, WriteChunk | SyncLog))
        if self.bytes > most:
            dropped += self._drop(most, lambda one: isinstance(one.effect, WriteMetadata) and not one.effect.lasts)
        return dropped

    def _is_misfit(self, one: Waiting) -> bool:
        # Half of the bound may be what the disk has in hand.
        return one.bytes > self._limit_bytes // 2 and isinstance(one.effect, WriteChunk)

    def _count(self, one: Waiting, sign: int) -> None:
        self.bytes += sign * one.bytes
        self._misfits += sign * self._is_misfit(one)

    def _drop(self, most: int, may_go: Callable[[Waiting], bool]) -> list[Waiting]:
        dropped: list[Waiting] = []
        kept: list[Waiting] = []
        kept_bytes = 0
        while self._ones and self.bytes + kept_bytes > most:
            one = self.take()
            if may_go(one):
                dropped.append(one)
            else:
                kept.append(one)
                kept_bytes += one.bytes
        self.put_back(kept)
        return dropped
