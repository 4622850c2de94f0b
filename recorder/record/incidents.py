"""The last seconds of a log in memory, and incidents: what came before and after, in a file of its own. Pure.

A ring holds the chunks that the log was given. When something happens they are written into an incident's file,
and so is what comes after, for a while. Another alarm meanwhile makes that while longer, up to a bound: a fault
that comes back all the time must not make an endless file.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

import msgspec

from recorder.mcap.chunk import Chunk
from recorder.record.effects import (
    CloseLog,
    DeclareChannel,
    Effect,
    FileEffect,
    OpenLog,
    SyncLog,
    WriteAttachment,
    WriteChunk,
    WriteMetadata,
)
from recorder.record.prologue import Prologue
from schemas.recorder_settings import INCIDENT_MAX_NS

INCIDENT_NAME: Final = "cruiser.incident"
"""The metadata record that links a log and an incident: in each the file of the other, when, and why."""


class IncidentPlan(msgspec.Struct, frozen=True):
    """What an incident's file holds.

    Attributes:
        before_ns: so much of what came before...
        after_ns: ...and so much of what comes after.
    """

    before_ns: int
    after_ns: int


class Incidents:
    """The ring of one log, and the incident that is being written of it.

    Args:
        name: begins the incidents' file names.
        plan: how much they hold.
    """

    def __init__(self, name: str, plan: IncidentPlan) -> None:
        self._name = name
        self._plan = plan
        self._prologue = Prologue()
        self._ring: deque[tuple[int, Chunk]] = deque()
        self.ring_bytes = 0
        """Bytes of the messages in the ring."""
        self._begun_ns = 0
        self._until_ns: int | None = None
        self.about: dict[str, str] = {}
        """When and why the latest incident was begun, as INCIDENT_NAME has it."""

    @property
    def is_open(self) -> bool:
        """Whether an incident is being written."""
        return self._until_ns is not None

    def take(self, effects: Iterable[Effect], now_ns: int) -> list[OpenLog | FileEffect]:
        """Effects on their way into the log. What of them belongs into the incident too."""
        copied: list[OpenLog | FileEffect] = []
        for effect in effects:
            if isinstance(effect, WriteChunk):
                self._ring.append((now_ns, effect.chunk))
                self.ring_bytes += len(effect.chunk.records)
            elif isinstance(effect, DeclareChannel | WriteAttachment) or (
                isinstance(effect, WriteMetadata) and effect.lasts
            ):
                self._prologue.take(effect)
            elif not isinstance(effect, SyncLog):
                continue
            if self._until_ns is not None:
                copied.append(effect)
        return copied

    @property
    def oldest_ns(self) -> int | None:
        """When the oldest chunk of the ring came; None if it is empty."""
        return self._ring[0][0] if self._ring else None

    def trim(self, now_ns: int) -> None:
        """Forget what is too old for an incident that would begin now."""
        while self._ring and now_ns - self._ring[0][0] > self._plan.before_ns:
            self.forget_oldest()

    def forget_oldest(self) -> int:
        """Forget the oldest chunk of the ring. Its bytes."""
        size = len(self._ring.popleft()[1].records)
        self.ring_bytes -= size
        return size

    def begin(self, now_ns: int, wall_ns: int, because: str, log: str) -> list[OpenLog | FileEffect]:
        """Something has happened. Nothing is to be done if an incident is under way: it lasts longer.

        Args:
            now_ns: when.
            wall_ns: the same, since 1970.
            because: what.
            log: the file in which the log goes on; empty if there is none.
        """
        if self._until_ns is not None:
            self._until_ns = min(now_ns + self._plan.after_ns, self._begun_ns + INCIDENT_MAX_NS)
            return []
        self._begun_ns = now_ns
        self._until_ns = now_ns + self._plan.after_ns
        self.about = {"at_ns": str(wall_ns), "because": because}
        return [
            OpenLog(self._name, wall_ns, is_incident=True),
            *self._prologue.effects,
            self._naming(log),
            *(WriteChunk(chunk) for _, chunk in self._ring),
            SyncLog(),
        ]

    def go_on_in(self, log: str) -> list[OpenLog | FileEffect]:
        """The log goes on in this file: an incident that is being written says so."""
        return [] if self._until_ns is None else [self._naming(log)]

    def is_over(self, now_ns: int) -> bool:
        """Whether the incident that is being written is to be ended."""
        return self._until_ns is not None and now_ns >= self._until_ns

    def close(self) -> list[OpenLog | FileEffect]:
        """End the incident, if there is one."""
        if self._until_ns is None:
            return []
        self._until_ns = None
        return [CloseLog()]

    def _naming(self, log: str) -> WriteMetadata:
        return WriteMetadata(INCIDENT_NAME, {**self.about, "file": log}, lasts=True)
