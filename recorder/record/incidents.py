"""Incidents, and gateways that were lost. Pure.

A ring holds the newest chunks of the log. When something happens they are written into a file of its own, and what
follows for a while. Another alarm makes that while longer, up to a bound, so that a recurring fault makes no
endless file.

A gateway whose liveliness token is gone may live: the token also goes with the link, and anybody may declare one.
So the recorder waits for the arbiter's states, and a gateway whose states go on lives.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from heapq import heapify, heappop, heappush
from typing import Final

import msgspec

from recorder.encoding.routes import Latest
from recorder.mcap.writer import Chunk
from recorder.record.actions import INCIDENT_MARK, CloseLog, LogAction, OpenLog, SyncLog, WriteChunk, WriteMetadata
from schemas.decisions import ArbiterState, SafetyState, is_same_run
from schemas.settings import INCIDENT_MAX_NS

INCIDENT_NAME: Final = "cruiser.incident"
"""The metadata record that links a log and an incident: in each the file of the other, when, and why."""


class Incidents:
    """The ring of one log, and the incident that is being written of it. Methods return what is to be done.

    Args:
        before_ns: an incident holds so much of what came before it.
        after_ns: an incident lasts so long after the last alarm.
    """

    def __init__(self, name: str, before_ns: int, after_ns: int) -> None:
        self.log = name + INCIDENT_MARK  # the name of the log of the incidents
        self._name = name
        self._before_ns, self._after_ns = before_ns, after_ns
        self._ring: deque[tuple[int, Chunk]] = deque()
        self.ring_bytes = 0  # bytes of the messages in the ring
        self._begun_ns = 0
        self._until_ns: int | None = None
        self.about: dict[str, str] = {}  # the start and cause of the latest incident, in the form of INCIDENT_NAME

    @property
    def is_open(self) -> bool:
        return self._until_ns is not None

    def add(self, chunk: Chunk, now_ns: int) -> list[LogAction]:
        self._ring.append((now_ns, chunk))
        self.ring_bytes += len(chunk.records)
        return [WriteChunk(self.log, chunk)] if self.is_open else []

    @property
    def oldest_ns(self) -> int | None:
        """The arrival time of the ring's oldest chunk, monotonic nanoseconds; None if the ring is empty."""
        return self._ring[0][0] if self._ring else None

    def trim(self, now_ns: int) -> None:
        while self._ring and now_ns - self._ring[0][0] > self._before_ns:
            self.forget_oldest()

    def forget_oldest(self) -> int:
        """Forget the oldest chunk of the ring. Returns its bytes."""
        size = len(self._ring.popleft()[1].records)
        self.ring_bytes -= size
        return size

    def begin(self, now_ns: int, wall_ns: int, because: str, file: str) -> list[LogAction]:
        """Begin an incident. One that is being written lasts longer instead, and nothing is to be done."""
        if self._until_ns is not None:
            self._until_ns = min(now_ns + self._after_ns, self._begun_ns + INCIDENT_MAX_NS)
            return []
        self._begun_ns = now_ns
        self._until_ns = now_ns + self._after_ns
        self.about = {"at_ns": str(wall_ns), "because": because}
        return [
            OpenLog(self.log, self._name, wall_ns, is_incident=True),
            self._link_to(file),
            *(WriteChunk(self.log, chunk) for _, chunk in self._ring),
            SyncLog(self.log),
        ]

    def link_to(self, file: str) -> list[LogAction]:
        """Name the file in which the log continues, if an incident is being written."""
        return [self._link_to(file)] if self.is_open else []

    def is_over(self, now_ns: int) -> bool:
        return self._until_ns is not None and now_ns >= self._until_ns

    def close(self) -> list[LogAction]:
        if self._until_ns is None:
            return []
        self._until_ns = None
        return [CloseLog(self.log)]

    def _link_to(self, file: str) -> WriteMetadata:
        return WriteMetadata(self.log, INCIDENT_NAME, {**self.about, "file": file}, lasts=True)


def trim_rings(all_incidents: Iterable[Incidents], now_ns: int, limit_bytes: int) -> None:
    """Forget what is too old for an incident that would begin now, and the oldest of all if it is too much."""
    total_bytes = 0
    rings = list(all_incidents)
    for ring in rings:
        ring.trim(now_ns)
        total_bytes += ring.ring_bytes
    if total_bytes <= limit_bytes:
        return
    heads = [(ring.oldest_ns, number) for number, ring in enumerate(rings) if ring.oldest_ns is not None]
    heapify(heads)
    while heads and total_bytes > limit_bytes:
        _, number = heappop(heads)
        total_bytes -= rings[number].forget_oldest()
        oldest_ns = rings[number].oldest_ns
        if oldest_ns is not None:
            heappush(heads, (oldest_ns, number))


WAIT_NS: Final = 500_000_000  # the time without a state that counts as silence: states come every 50 ms

LIVES_NS: Final = 10_000_000_000
"""A gateway that still publishes states so long after its token went is alive. States that merely waited for a
busy recorder come sooner."""


class LostGateway(msgspec.Struct, frozen=True):
    """A gateway that has died.

    Attributes:
        key: of its ``safety/state``.
        lost_ns: when its token went, monotonic.
        was_commanding: it commanded the chassis when its last state came.
    """

    key: str
    lost_ns: int
    text: str
    was_commanding: bool


class _Waiting(msgspec.Struct, frozen=True):
    latest: Latest
    state: SafetyState
    ended: Callable[[], int | None]
    lost_ns: int


class LostGateways:
    """The tokens that are gone, until their gateways are known to be dead or alive."""

    def __init__(self) -> None:
        self._waiting: dict[str, _Waiting] = {}

    def lose_token(self, key: str, latest: Latest, ended: Callable[[], int | None], now_ns: int) -> None:
        """Note that a gateway's token is gone.

        Args:
            ended: returns the tick at which the gateway last reported that it shuts down; None if it
                never did.
        """
        if isinstance(latest.message, SafetyState):
            self._waiting.setdefault(key, _Waiting(latest, latest.message, ended, now_ns))

    def due(self, now_ns: int, wall_ns: int) -> Iterator[LostGateway]:
        """Return the gateways that turn out to have died."""
        for key, waiting in [*self._waiting.items()]:
            waited_ns = now_ns - waiting.lost_ns
            if waited_ns < WAIT_NS:
                continue
            last, newest = waiting.state, waiting.latest.message
            if isinstance(newest, SafetyState) and is_same_run(newest.tick, last.tick):
                if wall_ns - waiting.latest.log_ns < WAIT_NS:
                    if waited_ns > LIVES_NS:
                        del self._waiting[key]
                    continue
                last = newest
            del self._waiting[key]
            was_commanding, ended_tick = last.state is not ArbiterState.STANDBY, waiting.ended()
            if not was_commanding and ended_tick is not None and is_same_run(ended_tick, last.tick):
                continue
            told = f", and told {last.output_speed_mps:.2f} m/s" if was_commanding else ""
            text = f"the gateway died, or the link to it: its token is gone, and it was {last.state.value}{told}"
            yield LostGateway(key, waiting.lost_ns, text, was_commanding)
