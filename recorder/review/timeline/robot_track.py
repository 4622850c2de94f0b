"""The state of one robot as the log gives it so far, as far as further entries need it."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from typing import Final

from recorder.reading.rows import Row
from recorder.review.timeline.clock import RobotClock
from recorder.review.timeline.entries import Entry, EntryKind, EntrySource
from recorder.review.timeline.repeats import Sequences
from recorder.review.timeline.state_changes import EventTicks
from recorder.review.timeline.stops import Stops
from schemas.decisions import ArbiterState, SafetyState, Severity, is_same_run
from schemas.messages import GatewayHealth

HOLDERS_KEPT: Final = 10_000
"""Changes of the lease that are remembered."""


class RobotTrack:
    """One robot.

    Attributes:
        name: empty for what is no robot's.
        clock: its clock.
        ticks: of its events.
        stops: its stops.
        state: the arbiter's newest; when it was (``state_ns``) and was received (``state_log_ns``), and its
            ``state_sequence``.
        ended_tick: the tick of the last announcement of a shutdown; None if there was none.
        health: the newest; ``health_ns``, when it was.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.clock = RobotClock()
        self.ticks = EventTicks()
        self.stops = Stops()
        self.state: SafetyState | None = None
        self.state_ns = self.state_log_ns = 0
        self.state_sequence = 0
        self.ended_tick: int | None = None
        self.health: GatewayHealth | None = None
        self.health_ns = 0
        self._holder_ticks: deque[int] = deque(maxlen=HOLDERS_KEPT)
        self._holders: deque[str] = deque(maxlen=HOLDERS_KEPT)
        self._runs: list[int] = []
        self._sequences: dict[tuple[str, int], Sequences] = {}

    def place(self, row: Row, tick: int | None = None) -> int:
        """Return the time of a row's event by the recorder's clock."""
        return self.clock.place(row.publish_ns, row.log_ns, tick)

    def count(self, row: Row, tick: int, time_ns: int) -> None:
        """A sample of a subject of which every one should be in the log."""
        key = row.topic.name, self._run_of(tick)
        sequences = self._sequences.get(key)
        if sequences is None:
            sequences = self._sequences[key] = Sequences()
        sequences.add(row.sequence, time_ns)

    @property
    def is_ended(self) -> bool:
        """True if the gateway of the newest state shut down as requested, at rest."""
        return (
            self.state is not None
            and not self.is_active
            and self.ended_tick is not None
            and is_same_run(self.state.tick, self.ended_tick)
        )

    @property
    def is_active(self) -> bool:
        """True if the gateway of the newest state commanded the chassis."""
        return self.state is not None and self.state.state is not ArbiterState.STANDBY

    @property
    def left(self) -> str:
        """The gateway's state and commanded speed in its newest message, for people."""
        if self.state is None or not self.is_active:
            return "standby"
        return f"{self.state.state.value}, and told {self.state.output_speed_mps:.2f} m/s"

    def hear_state(self, state: SafetyState, sequence: int, time_ns: int, log_ns: int) -> None:
        """The arbiter's newest state."""
        if not self._holders or self._holders[-1] != state.lease_holder:
            if self._holder_ticks and state.tick < self._holder_ticks[-1]:
                self._holder_ticks.clear()
                self._holders.clear()
            self._holder_ticks.append(state.tick)
            self._holders.append(state.lease_holder)
        self.state, self.state_sequence = state, sequence
        self.state_ns, self.state_log_ns = time_ns, log_ns

    def holder_at(self, tick: int) -> str:
        """Return the holder of the lease before this tick; empty if nobody held it, or the log does not say."""
        at = bisect_right(self._holder_ticks, tick - 1)
        return self._holders[at - 1] if at else ""

    def holes(self) -> list[Entry]:
        """Return an entry for each range of missing events and decisions."""
        return [
            Entry(
                time_ns=hole.after_ns,
                last_ns=max(hole.after_ns, hole.before_ns),
                robot=self.name,
                kind=EntryKind.GAP,
                severity=Severity.WARNING,
                source=EntrySource.LOG,
                count=hole.count,
                text=f"{hole.count} samples of {topic} are not in the log",
            )
            for (topic, _), sequences in self._sequences.items()
            for hole in sequences.holes()
        ]

    def _run_of(self, tick: int) -> int:
        for number, newest in enumerate(self._runs):
            if is_same_run(tick, newest):
                self._runs[number] = max(tick, newest)
                return number
        self._runs.append(tick)
        return len(self._runs) - 1
