"""The events of one robot over all of a log: its stops and latches, and how the runs of its gateways ended."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import END_OF_TIME_NS, Progress, Selection, decoded_rows
from recorder.review.clock import NEAR_NS
from recorder.review.entries import ENDS, STOPS, Entry, EntryKind, EntrySource
from recorder.review.events import read_events
from recorder.review.reasoning.window import EvidenceWindow, Heard, is_other_run
from schemas.decisions import ArbiterState, SafetyEvent, SafetyState, Severity, is_same_run
from schemas.reasons import Reason

KEPT: Final = 50_000
"""Entries that are kept; the oldest go first."""


class Story:
    """The events of a robot, by their time."""

    def __init__(self, entries: Iterable[Entry]) -> None:
        self._entries = sorted(deque(entries, maxlen=KEPT), key=lambda entry: entry.time_ns)

    def last_stop(self, until_ns: int = END_OF_TIME_NS) -> Entry | None:
        """The last stop up to a time; where there was none, the last end that somebody asked for."""
        either = (next(filter(_stops, self._before(until_ns, kinds)), None) for kinds in (STOPS, ENDS))
        return next(filter(None, either), None)

    def stop_before(self, until_ns: int) -> Entry | None:
        """The last stop up to a time, if the robot has not been engaged since."""
        stops = (one for one in self._before(until_ns, {*ENDS, EntryKind.ENGAGED}))
        last = next((one for one in stops if one.kind is EntryKind.ENGAGED or _stops(one)), None)
        return None if last is None or last.kind is EntryKind.ENGAGED else last

    def death(self, until_ns: int) -> Entry | None:
        """The death of a gateway that a recorder saw, if it is the last thing that is known up to a time."""
        last = next((one for one in reversed(self._entries) if one.time_ns <= until_ns), None)
        return last if last is not None and _is_death(last) else None

    def next_run(self, after_ns: int, tick: int | None) -> list[Entry]:
        """The entries of the gateway that followed one that died, whose last tick was this, if it is known."""
        behind = [
            (one, one.tick)
            for one in self._entries
            if one.time_ns > after_ns
            and one.tick is not None
            and (tick is None or not is_same_run(one.tick, tick))
        ]
        return [one for one, its_tick in behind if is_same_run(its_tick, behind[0][1])]

    def newest_latch(self, reasons: Iterable[Reason], until_ns: int) -> Entry | None:
        """Of what is latched, that which was latched last."""
        latches = [entry for reason in reasons if (entry := self.last_latch(reason, until_ns)) is not None]
        return max(latches, key=lambda entry: entry.time_ns, default=None)

    def next_stop(self, from_ns: int) -> Entry | None:
        """The first stop from a time on."""
        return next((one for one in self._entries if one.time_ns >= from_ns and _stops(one)), None)

    def last_latch(self, reason: Reason, until_ns: int) -> Entry | None:
        """The last latch for this reason up to a time."""
        return next((one for one in self._before(until_ns, {EntryKind.LATCH}) if one.reason is reason), None)

    def off_ns(self, window: EvidenceWindow) -> int | None:
        """By how much the window's times are before the story's, by the ticks of its events.

        None if a stop of the window is not where the story has it: then the story's times are not to be believed.
        """
        told_ns = {one.tick: one.time_ns for one in self._entries if one.source is EntrySource.EVENT}
        both = [one for one in window.all(SafetyEvent) if one.said.tick in told_ns]
        if any(abs(told_ns[one.said.tick] - one.time_ns) > NEAR_NS for one in both):
            return None
        nearest = min(both, key=lambda one: abs(one.time_ns - window.at_ns), default=None)
        return 0 if nearest is None else told_ns[nearest.said.tick] - nearest.time_ns

    def next_engaged(self, after_ns: int) -> Entry | None:
        """The first engagement behind a time."""
        return next(self._behind(EntryKind.ENGAGED, after_ns), None)

    def reset_of(self, latch: Entry) -> Entry | None:
        """The first reset of what was latched, in the run in which it was."""
        resets = self._behind(EntryKind.RESET, latch.time_ns)
        named = (one for one in resets if latch.reason.value in one.text.partition(": ")[2].split(", "))
        return next((one for one in named if _is_same_run(latch, one)), None)

    def _behind(self, kind: EntryKind, after_ns: int) -> Iterator[Entry]:
        return (one for one in self._entries if one.kind is kind and one.time_ns > after_ns)

    def _before(self, until_ns: int, kinds: Iterable[EntryKind]) -> Iterable[Entry]:
        wanted = frozenset(kinds)
        return (one for one in reversed(self._entries) if one.time_ns <= until_ns and one.kind in wanted)


def _stops(entry: Entry) -> bool:
    # That a guard is there, or is gone, has no reason: it stops nothing by itself.
    return entry.kind in ENDS and entry.reason is not Reason.NONE and not entry.tells_of_guard


def _is_death(entry: Entry) -> bool:
    is_seen = entry.kind is EntryKind.GATEWAY and entry.source is EntrySource.RECORDER
    return is_seen and entry.severity is Severity.ERROR


def _is_same_run(one: Entry, other: Entry) -> bool:
    return one.tick is None or other.tick is None or is_same_run(one.tick, other.tick)


def told(robot: str, logs: Sequence[LogFile], faults: Faults, progress: Progress) -> Story:
    """The story by the robot's own events, and the recorders'. Most of a log need not be read for it."""
    return derived(robot, logs, faults, progress)


def derived(robot: str, logs: Sequence[LogFile], faults: Faults, progress: Progress) -> Story:
    """Return the story with the changes between states too, where events are missing. Reads all of a log."""
    kinds = EntryKind.LATCH, EntryKind.RESET, EntryKind.STOPPED, EntryKind.ENGAGED, EntryKind.GATEWAY
    wanted = frozenset({*ENDS, *kinds})
    return Story(read_events(logs, Selection(), faults, progress, robots=frozenset({robot}), kinds=wanted))


class RunEnding(msgspec.Struct, frozen=True):
    """The ends of runs in a log.

    Attributes:
        died: the last state of the last gateway that did not stand by at its end; None if there is none.
        last: the last state of all; None if the log holds none.
    """

    died: Heard[SafetyState] | None = None
    last: Heard[SafetyState] | None = None


def endings(robot: str, logs: Sequence[LogFile], from_ns: int, faults: Faults, progress: Progress) -> RunEnding:
    """Read the ends of the runs of a robot's gateways from a time on: one that ends at work has died.

    Args:
        robot: its name.
        logs: in the order of their beginnings.
        from_ns: earlier states are not read.
        faults: takes what cannot be read.
        progress: is called during the reading with no bytes: they have been counted before.
    """
    died: Heard[SafetyState] | None = None
    last: Heard[SafetyState] | None = None
    selection = Selection(lambda topic: topic.robot == robot and topic.kind is SafetyState, from_ns)
    for row, state in decoded_rows(logs, selection, faults, lambda _: progress(0)):
        if not isinstance(state, SafetyState):
            continue
        # At the robot's time, or at that of its receipt where the two clocks differ.
        is_near = abs(row.log_ns - row.publish_ns) <= NEAR_NS
        one = Heard(row.publish_ns if is_near else row.log_ns, state)
        if died is not None and not is_other_run(died.said, one.said):
            died = None  # It lives: two gateways speak for this robot.
        if last is not None and is_other_run(last.said, one.said) and last.said.state is not ArbiterState.STANDBY:
            died = last
        last = one
    return RunEnding(died, last)
