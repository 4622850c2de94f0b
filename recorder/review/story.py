"""The first pass over a robot's logs: its entries and the runs of its gateways, in their order."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import END_OF_TIME_NS, Progress, Selection, read_rows
from recorder.review.clock import SETTLE_NS
from recorder.review.entries import ENDS, STOPS, Entry, EntryKind, EntrySource
from recorder.review.events import Timeline
from recorder.review.window import AFTER_NS, BEFORE_NS, Heard
from schemas.decisions import ArbiterState, SafetyEvent, SafetyState, Severity, is_same_run
from schemas.messages import GatewayHealth
from schemas.reasons import Reason
from schemas.recording import RecorderEvent

KEPT: Final = 50_000
"""Entries of a story; the oldest go first."""

_TELLS: Final = ENDS | {
    EntryKind.LATCH,
    EntryKind.RESET,
    EntryKind.STOPPED,
    EntryKind.ENGAGED,
    EntryKind.LEASE,
    EntryKind.GATEWAY,
    EntryKind.CLOCK,
}


class GatewayRun(msgspec.Struct):
    """A run of a gateway: its first state and its last."""

    first: Heard[SafetyState]
    last: Heard[SafetyState]

    @property
    def was_active(self) -> bool:
        """It ended while it commanded the robot, or stopped it."""
        return self.last.said.state is not ArbiterState.STANDBY


class Story:
    """The entries of a robot, in order.

    Times that are asked for are those of a clock that may have been set back, so that two moments can have one
    time: the later is meant.

    Attributes:
        runs: of its gateways; of two that speak at once the states are of one.
        is_shared: two gateways speak under its name.
    """

    def __init__(
        self, entries: Iterable[Entry], runs: Sequence[GatewayRun] = (), offsets: Sequence[tuple[int, int]] = ()
    ) -> None:
        self.runs = runs
        self.is_shared = False
        self._offsets = offsets
        self._entries: list[Entry] = []
        self._order_ns: list[int] = []
        self._eras = [(0, END_OF_TIME_NS, 0)]
        """The times between which the clock was not set back, and by how much it had been."""
        ordered = []
        for entry in deque(entries, maxlen=KEPT):
            if entry.kind is EntryKind.CLOCK and entry.last_ns > entry.time_ns:
                from_ns, _, set_ns = self._eras[-1]
                self._eras[-1] = (from_ns, entry.last_ns, set_ns)
                self._eras.append((entry.time_ns, END_OF_TIME_NS, set_ns + entry.last_ns - entry.time_ns))
            ordered.append((entry.time_ns + self._eras[-1][2], entry))
        ordered.sort(key=lambda one: one[0])
        for order_ns, entry in ordered:
            self._order_ns.append(order_ns)
            self._entries.append(entry)

    @classmethod
    def read(cls, robot: str, logs: Sequence[LogFile], faults: Faults, progress: Progress) -> Story:
        """Read all that the arbiter says of itself, and what recorders say of the gateway."""
        wanted = {SafetyEvent, SafetyState, GatewayHealth}
        selection = Selection(
            lambda topic: topic.kind is RecorderEvent or (topic.robot == robot and topic.kind in wanted)
        )
        timeline, runs, offsets = Timeline(faults), list[GatewayRun](), list[tuple[int, int]]()
        track = timeline.robot(robot)
        newest: SafetyState | None = None

        def entries() -> Iterator[Entry]:
            nonlocal newest
            for row in read_rows(logs, selection, faults, progress):
                timeline.take(row)
                if track.state is not newest and track.state is not None:
                    newest = track.state
                    heard = Heard(track.state_ns, newest)
                    if runs and (track.is_shared or is_same_run(newest.tick, runs[-1].last.said.tick)):
                        runs[-1].last = heard
                    else:
                        runs.append(GatewayRun(heard, heard))
                    if not offsets or offsets[-1][1] != track.clock.offset_ns:
                        offsets.append((row.log_ns, track.clock.offset_ns))
                yield from timeline.tell()
            yield from timeline.end()

        story = cls((one for one in entries() if one.robot == robot and one.kind in _TELLS), runs, offsets)
        story.is_shared = track.is_shared
        return story

    def order_ns(self, at_ns: int) -> int:
        """The time as it would be had the clock never been set back."""
        within = [set_ns for from_ns, to_ns, set_ns in self._eras if from_ns <= at_ns <= to_ns]
        return at_ns + (within[-1] if within else 0)

    def offset_ns(self, at_ns: int) -> int:
        """To be added to the robot's clock around a moment; a clock that is behind is believed after a while."""
        offsets = [offset_ns for log_ns, offset_ns in self._offsets if log_ns <= at_ns + SETTLE_NS + 1_000_000_000]
        return offsets[-1] if offsets else next((offset_ns for _, offset_ns in self._offsets), 0)

    def is_steady(self, at_ns: int) -> bool:
        """No clock was set in the seconds around a moment."""
        clocks = (one.time_ns for one in self._entries if one.kind is EntryKind.CLOCK)
        return not any(at_ns - BEFORE_NS <= time_ns <= at_ns + AFTER_NS for time_ns in clocks)

    def last_stop(self) -> Entry | None:
        """The last stop; where there was none, the last end that was asked for."""
        either = (
            next((one for one in reversed(self._entries) if stops(one, kinds)), None) for kinds in (STOPS, ENDS)
        )
        return next(filter(None, either), None)

    def stop_before(self, at_ns: int) -> Entry | None:
        """The last stop up to a time, if the robot has not been engaged since."""
        for one in self.before(at_ns):
            if one.kind is EntryKind.ENGAGED:
                return None
            if stops(one):
                return one
        return None

    def next_stop(self, from_ns: int) -> Entry | None:
        """The first stop from a time on."""
        return next(filter(stops, self.after(from_ns - 1)), None)

    def death(self, at_ns: int) -> Entry | None:
        """The death of a gateway that a recorder saw, if it is the last thing that is known up to a time."""
        last = next((one for one in self.before(at_ns) if one.kind is not EntryKind.CLOCK), None)
        return last if last is not None and _is_death(last) else None

    def latch_before(self, reason: Reason, at_ns: int) -> Entry | None:
        """The last latch for this reason up to a time."""
        latches = (one for one in self.before(at_ns) if one.kind is EntryKind.LATCH)
        return next((one for one in latches if one.reason is reason), None)

    def lease_before(self, at_ns: int) -> Entry | None:
        """The last that became of the lease up to a time."""
        return next((one for one in self.before(at_ns) if one.kind is EntryKind.LEASE), None)

    def next_engaged(self, after_ns: int) -> Entry | None:
        """The first engagement behind a time."""
        return next((one for one in self.after(after_ns) if one.kind is EntryKind.ENGAGED), None)

    def reset_of(self, latch: Entry) -> Entry | None:
        """The first reset of what was latched, in the run in which it was."""
        resets = (one for one in self.after(latch.time_ns) if one.kind is EntryKind.RESET)
        named = (one for one in resets if latch.reason.value in one.text.partition(": ")[2].split(", "))
        return next((one for one in named if None in (one.tick, latch.tick) or _of_run(one, latch.tick)), None)

    def run_after(self, tick: int) -> GatewayRun | None:
        """The run that followed that of a tick."""
        at = next(
            (n for n, run in enumerate(self.runs) if is_same_run(run.last.said.tick, tick)),
            None,
        )
        return None if at is None or at + 1 == len(self.runs) else self.runs[at + 1]

    def of_run(self, run: GatewayRun) -> Iterator[Entry]:
        """The entries of a run up to its first engagement: what it found."""
        for one in self._entries:
            if _of_run(one, run.first.said.tick):
                if one.kind is EntryKind.ENGAGED:
                    return
                yield one

    def before(self, at_ns: int) -> Iterator[Entry]:
        """The entries up to a time, the last one first."""
        return reversed(self._entries[: bisect_right(self._order_ns, self.order_ns(at_ns))])

    def after(self, at_ns: int) -> Iterator[Entry]:
        """The entries behind a time."""
        return iter(self._entries[bisect_right(self._order_ns, self.order_ns(at_ns)) :])


def stops(entry: Entry, kinds: frozenset[EntryKind] = ENDS) -> bool:
    """A stop begins, or goes on for a further cause: that a guard is there, or is gone, has no reason."""
    return entry.kind in kinds and entry.reason is not Reason.NONE and not entry.tells_of_guard


def _is_death(entry: Entry) -> bool:
    is_seen = entry.kind is EntryKind.GATEWAY and entry.source is EntrySource.RECORDER
    return is_seen and entry.severity is Severity.ERROR


def _of_run(entry: Entry, tick: int | None) -> bool:
    return entry.tick is not None and tick is not None and is_same_run(entry.tick, tick)
