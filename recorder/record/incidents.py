"""Incidents, and lost gateways. Pure.

A ring holds the newest chunks of the log. An alarm writes them into an incident file, with the chunks that follow
for some time. Another alarm extends that time, up to a limit.

A gateway whose liveliness token is gone may be alive: the token is also lost with the link, and is not
authenticated. The recorder waits for the arbiter's states: while they continue, the gateway is alive.
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
"""Metadata record that links a log and an incident: the other's file, the time, and the reason."""


class Incidents:
    """The ring of one log, and its open incident. Methods return the actions to take.

    Args:
        before_ns: length of the record before an incident.
        after_ns: an incident ends this long after the last alarm.
    """

    def __init__(self, name: str, before_ns: int, after_ns: int) -> None:
        self.log = name + INCIDENT_MARK
        self._name = name
        self._before_ns, self._after_ns = before_ns, after_ns
        self._ring: deque[tuple[int, Chunk]] = deque()
        self.ring_bytes = 0  # bytes of the messages in the ring
        self._begun_ns = 0
        self._until_ns: int | None = None
        self.about: dict[str, str] = {}  # start and cause of the latest incident, as in INCIDENT_NAME

    @property
    def is_open(self) -> bool:
        return self._until_ns is not None

    def add(self, chunk: Chunk, now_ns: int) -> list[LogAction]:
        self._ring.append((now_ns, chunk))
        self.ring_bytes += len(chunk.records)
        return [WriteChunk(self.log, chunk)] if self.is_open else []

    @property
    def oldest_ns(self) -> int | None:
        """Arrival time of the ring's oldest chunk, monotonic; None if the ring is empty."""
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
        """Begin an incident, or extend the open one, which takes no action."""
        if self._until_ns is not None:
            self._until_ns = min(now_ns + self._after_ns, self._begun_ns + INCIDENT_MAX_NS)
            return []
        self._begun_ns = now_ns
        self._until_ns = now_ns + self._after_ns
        self.about = {"at_ns": str(wall_ns), "because": because}
        return [
            OpenLog(self.log, self._name, wall_ns, is_incident=True),
            *self.link_to(file),
            *(WriteChunk(self.log, chunk) for _, chunk in self._ring),
            SyncLog(self.log),
        ]

    def link_to(self, file: str) -> list[LogAction]:
        """Name the file in which the log continues, if an incident is open."""
        metadata = {**self.about, "file": file}
        return [WriteMetadata(self.log, INCIDENT_NAME, metadata, lasts=True)] if self.is_open else []

    def is_over(self, now_ns: int) -> bool:
        return self._until_ns is not None and now_ns >= self._until_ns

    def close(self) -> list[LogAction]:
        if self._until_ns is None:
            return []
        self._until_ns = None
        return [CloseLog(self.log)]


def trim_rings(all_incidents: Iterable[Incidents], now_ns: int, limit_bytes: int) -> None:
    """Drop chunks too old for an incident that begins now, and the oldest of all rings beyond the limit."""
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


WAIT_NS: Final = 500_000_000  # time without a state that counts as silence: states come every 50 ms
LIVES_NS: Final = 10_000_000_000  # a gateway with states this long after its token went is alive


class LostGateway(msgspec.Struct, frozen=True):
    """A gateway that has died.

    Attributes:
        key: of its ``safety/state``.
        lost_ns: time of the token's loss, monotonic.
        was_commanding: it commanded the chassis at its last state.
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
    """Lost tokens, until their gateways are known to be dead or alive."""

    def __init__(self) -> None:
        self._waiting: dict[str, _Waiting] = {}

    def lose_token(self, key: str, latest: Latest, ended: Callable[[], int | None], now_ns: int) -> None:
        """Note a lost token. ``ended`` returns the tick of the gateway's last report of a shutdown, if any."""
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
            told = f" at {last.output_speed_mps:.2f} m/s" if was_commanding else ""
            text = f"the gateway or the link to it died: its token is gone; last state {last.state.value}{told}"
            yield LostGateway(key, waiting.lost_ns, text, was_commanding)
