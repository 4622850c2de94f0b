"""Events in order: leases, engages, stops, latches, faults, takeovers, refusals, and gaps of the log.

One pass over the messages of arbiter, gateway and recorder. Entries are held back, up to a bound, so that a late
one, which the log holds behind newer messages, appears in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from heapq import heappop, heappush
from typing import Any, Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile, logs_of
from recorder.reading.rows import Progress, Row, Selection, Wants, read_rows
from recorder.reading.topics import UNREADABLE
from recorder.review.timeline.ending import SILENT_NS, LogEnding, ending
from recorder.review.timeline.entries import OF_EVENT, Entry, EntryKind, EntrySource, kind_of
from recorder.review.timeline.health_changes import risen
from recorder.review.timeline.repeats import IDS_KEPT, Repeats
from recorder.review.timeline.robot_track import RobotTrack
from recorder.review.timeline.spells import Spells
from recorder.review.timeline.state_changes import Change, changes, entry_of
from schemas import keys
from schemas.decisions import Decision, EventKind, SafetyEvent, SafetyState, Severity, Verdict
from schemas.messages import GatewayHealth
from schemas.reasons import TEXTS, Reason
from schemas.recording import RecorderEvent, RecorderEventKind, RecordGap

HELD_MAX: Final = 20_000
"""Entries that are held back. One that comes after so many newer ones is shown out of order, and marked so."""

LATER_NS: Final = 15 * 60 * 1_000_000_000
"""The log is read this far beyond the end of the wanted time, for late messages about that time."""

BEFORE_NS: Final = 5 * 1_000_000_000
"""The states this long before the wanted time are read too, so that a change at its beginning is seen as one."""

_UNTOLD: Final = frozenset(
    {"drive", "renew", "acquire", "take", "release", "engage", "disengage", "stop", "reset"}
)
"""Requests that, once accepted, have an event of their own, or are of a stream."""

_EXPECTED: Final = frozenset({Reason.STOPPING, Reason.ENGAGING, Reason.ALREADY_ENGAGED, Reason.BUSY})
"""A stream goes on for a while: such a refusal is nobody's fault."""


def is_within(entry: Entry, selection: Selection) -> bool:
    """Report whether an entry is of the time of a selection."""
    return entry.time_ns < selection.to_ns and entry.last_ns >= selection.from_ns


def read_events(
    logs: Sequence[LogFile],
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
    *,
    robots: Collection[str] = (),
    kinds: Collection[EntryKind] = (),
) -> Iterator[Entry]:
    """The entries, by their time.

    Args:
        logs: in the order of their beginnings, as ``find_logs`` gives them.
        selection: of which time, by which topics.
        faults: collects what cannot be read; the rest is shown all the same.
        progress: receives the number of bytes that were read or passed over.
        robots: of these alone, and what is about all; empty is every robot.
        kinds: of these alone; empty is every kind.
    """

    def is_of(robot: str) -> bool:
        return not robots or not robot or robot in robots

    def is_wanted(entry: Entry) -> bool:
        return is_within(entry, selection) and (not kinds or entry.kind in kinds) and is_of(entry.robot)

    looked_at = Selection(
        lambda topic: topic.kind in _TAKES and is_of(topic.robot) and selection.wants(topic),
        max(0, selection.from_ns - BEFORE_NS),
        selection.to_ns + LATER_NS,
    )
    timeline = Timeline(faults)
    for row in read_rows(logs, looked_at, faults, progress):
        timeline.take(row)
        yield from filter(is_wanted, timeline.tell())
    timeline.hear_behind_silence(logs, looked_at.to_ns)
    for _ in timeline.endings(logs, looked_at.to_ns):
        pass
    yield from filter(is_wanted, timeline.end())


class Timeline:
    """Makes entries of rows.

    Args:
        faults: takes what cannot be read.
        has_states: the arbiter's states are among the rows. Else the clock is known from the events only.
        kept: so many samples of each topic are known again when they come a second time.
    """

    def __init__(self, faults: Faults, *, has_states: bool = True, kept: int = IDS_KEPT) -> None:
        self._faults = faults
        self._has_states = has_states
        self._kept = kept
        self._robots: dict[str, RobotTrack] = {}
        self._repeats: dict[str, Repeats] = {}
        self._held: list[tuple[int, int, Entry, Change | None]] = []
        self._count = 0
        self._spells = Spells()
        self._spells_due_ns = 0
        self._told_ns = 0

    def take(self, row: Row, decoded: Any = None) -> None:  # noqa: ANN401 - any message of ours
        """The next row, by log time; of a class of ours. ``decoded`` if somebody has decoded it already."""
        topic = row.topic
        take = _TAKES.get(topic.kind)
        if take is None or topic.decode is None:
            return
        repeats = self._repeats.get(topic.name)
        if repeats is None:
            repeats = self._repeats[topic.name] = Repeats(self._kept)
        if not repeats.is_new(row.publish_ns, row.sequence):
            return
        try:
            message = topic.decode(row.data) if decoded is None else decoded
        except UNREADABLE as error:
            self._faults.add(f"{topic.name}: a message that cannot be read: {error}")
            return
        robot = self._robots.get(topic.robot)
        if robot is None:
            robot = self._robots[topic.robot] = RobotTrack(topic.robot)
        take(self, robot, row, message)
        if not 0 <= self._spells_due_ns - row.log_ns <= SILENT_NS:
            self._spells_due_ns = row.log_ns + SILENT_NS
            for entry in self._spells.take(row.log_ns):
                self._hold(entry)

    def tell(self) -> Iterator[Entry]:
        """Yield the entries for which there is no more room."""
        while len(self._held) > HELD_MAX:
            yield from self._next()

    def hear_behind_silence(self, logs: Sequence[LogFile], to_ns: int) -> None:
        """Read the next state of each robot that is silent up to a time.

        Its tick shows whether the gateway is the same, and how long it was silent: a clock that is set forward
        leaves a hole in the log times, too.

        Args:
            logs: that were read.
            to_ns: the first log time that was not.
        """
        for robot in list(self._robots.values()):
            found = _ending_of(robot, logs, to_ns)
            if found is not None and found.is_silent:
                behind = Selection(_states_of(robot.name), to_ns)
                row = next(read_rows(logs, behind, self._faults), None)
                if row is not None:
                    self.take(row)

    def endings(self, logs: Sequence[LogFile], to_ns: int) -> Iterator[LogEnding]:
        """Yield the ends of each robot's logs, which ``end`` yields as entries too. After the last row.

        Args:
            logs: that were read.
            to_ns: the first log time that was not.
        """
        for robot in self._robots.values():
            found = _ending_of(robot, logs, to_ns)
            if found is not None:
                self._hold(found.entry)
                yield found

    def end(self) -> Iterator[Entry]:
        """Yield the rest of the entries. After the last row."""
        for entry in self._spells.take():
            self._hold(entry)
        for robot in self._robots.values():
            for entry in robot.holes():
                self._hold(entry)
        while self._held:
            yield from self._next()

    def _hold(self, entry: Entry, change: Change | None = None) -> None:
        self._count += 1
        heappush(self._held, (entry.time_ns, self._count, entry, change))

    def _next(self) -> Iterator[Entry]:
        time_ns, _, entry, change = heappop(self._held)
        robot = self._robots.get(entry.robot)
        if robot is not None:
            if change is not None and robot.ticks.tells(change.kind, change.after_tick, change.tick):
                return
            entry = robot.stops.mark(entry)
        is_late = time_ns < self._told_ns
        self._told_ns = max(self._told_ns, time_ns)
        yield msgspec.structs.replace(entry, is_late=True) if is_late else entry

    # One for each class of messages.

    def _take_event(self, robot: RobotTrack, row: Row, event: SafetyEvent) -> None:
        kind = OF_EVENT.get(event.kind, EntryKind.FAULT)
        robot.ticks.add(kind, event.tick)
        if event.kind is EventKind.GATEWAY:
            robot.ended_tick = event.tick
        if not self._has_states:
            robot.clock.hear(event.tick, row.publish_ns, row.log_ns)
        time_ns = robot.place(row, event.tick)
        robot.count(row, event.tick, time_ns)
        self._hold(
            Entry(
                time_ns=time_ns,
                last_ns=time_ns,
                robot=robot.name,
                kind=kind_of(kind, event.reason),
                severity=event.severity,
                source=EntrySource.EVENT,
                text=event.text,
                reason=event.reason,
                operator=event.operator,
                holder=robot.holder_at(event.tick),
                tick=event.tick,
            )
        )

    def _take_decision(self, robot: RobotTrack, row: Row, decision: Decision) -> None:
        time_ns = robot.place(row, decision.tick)
        robot.count(row, decision.tick, time_ns)
        is_refused = decision.verdict is Verdict.REFUSED
        if not is_refused and decision.request in _UNTOLD:
            return
        if is_refused:
            text = f"{decision.request or 'nothing'} refused: {decision.detail or TEXTS[decision.reason].means}"
        else:
            text = f"{decision.request}, as asked"
        expected = not is_refused or decision.reason in _EXPECTED
        entry = Entry(
            time_ns=time_ns,
            last_ns=time_ns,
            robot=robot.name,
            kind=EntryKind.REFUSAL if is_refused else EntryKind.REQUEST,
            severity=Severity.INFO if expected else Severity.WARNING,
            source=EntrySource.DECISION,
            text=text,
            reason=decision.reason,
            operator=decision.operator,
            holder=robot.holder_at(decision.tick),
            request=decision.request,
            tick=decision.tick,
        )
        key = (robot.name, decision.operator, decision.request, decision.reason)
        self._spells.add(key, entry, row.log_ns)

    def _take_state(self, robot: RobotTrack, row: Row, state: SafetyState) -> None:
        was = robot.state
        is_other_run = robot.clock.is_other_run(state.tick)
        said = robot.clock.hear(state.tick, row.publish_ns, row.log_ns)
        time_ns = robot.place(row, state.tick)
        if said:
            self._hold(_plain(robot.name, EntryKind.CLOCK, Severity.WARNING, time_ns, said, EntrySource.LOG))
        if was is not None and is_other_run:
            self._take_other_run(robot, time_ns)
        elif was is not None:
            if state.tick <= was.tick:
                return
            self._look_for_silence(robot, row, state, was, time_ns)
            if _says(state) != _says(was):
                for change in changes(was, state):
                    self._hold(entry_of(change, robot.name, time_ns, state.lease_holder), change)
        robot.hear_state(state, row.sequence, time_ns, row.log_ns)

    def _take_other_run(self, robot: RobotTrack, time_ns: int) -> None:
        """The first state of a gateway that began anew."""
        left, active = robot.left, robot.is_active
        severity = Severity.INFO if robot.is_ended else Severity.ERROR if active else Severity.WARNING
        silent_ns = time_ns - robot.state_ns
        if silent_ns > SILENT_NS and not robot.is_ended:
            text = f"nothing of the arbiter for {silent_ns / 1e9:.1f} s: the gateway fell silent, {left}"
            silence = _plain(robot.name, EntryKind.GAP, severity, robot.state_ns, text, EntrySource.LOG)
            self._hold(msgspec.structs.replace(silence, last_ns=time_ns))
        text = "the gateway began anew: nothing of before holds any more"
        text += f"; the one before was {left}" if active else ""
        self._hold(_plain(robot.name, EntryKind.GATEWAY, severity, time_ns, text))

    def _look_for_silence(
        self, robot: RobotTrack, row: Row, state: SafetyState, was: SafetyState, time_ns: int
    ) -> None:
        # What the clock was thought to be when the last one came may have been wrong.
        was_ns = robot.state_ns + robot.clock.corrected_ns
        silent_ns = time_ns - was_ns
        if silent_ns <= SILENT_NS:
            return
        missed = (row.sequence - robot.state_sequence - 1) % 2**32
        ticks = state.tick - was.tick
        why = f"{missed} samples are missing" if missed else f"the gateway made {ticks} ticks meanwhile"
        text = f"nothing of the arbiter for {silent_ns / 1e9:.1f} s: {why}"
        entry = _plain(robot.name, EntryKind.GAP, Severity.WARNING, was_ns, text, EntrySource.LOG)
        self._hold(msgspec.structs.replace(entry, last_ns=time_ns, count=max(1, missed)))

    def _take_health(self, robot: RobotTrack, row: Row, health: GatewayHealth) -> None:
        time_ns = robot.place(row)
        was, was_ns = robot.health, min(robot.health_ns, time_ns)
        robot.health, robot.health_ns = health, time_ns
        if was is not None and health.uptime_s < was.uptime_s:
            was = None
            if robot.state is None:
                text = f"the gateway began anew, {health.uptime_s:.1f} s ago"
                self._hold(
                    _plain(robot.name, EntryKind.GATEWAY, Severity.WARNING, time_ns, text, EntrySource.HEALTH)
                )
        for one in risen(was, health):
            if one.what == "controller" and robot.state is not None:
                continue  # An event says so.
            is_dated = was is None or one.is_end
            text = one.text if is_dated else f"{one.text} (after this time, as the next gateway/health says)"
            began_ns = time_ns if is_dated else was_ns
            entry = _plain(robot.name, one.kind, one.severity, began_ns, text, EntrySource.HEALTH)
            entry = msgspec.structs.replace(entry, last_ns=time_ns, count=one.count)
            if one.severity is Severity.INFO and one.count == 1 and not one.about:
                self._hold(entry)
            else:
                self._spells.add((robot.name, one.what), entry, row.log_ns, one.about)

    def _take_recorder_event(self, _robot: RobotTrack, row: Row, event: RecorderEvent) -> None:
        kind = EntryKind.GATEWAY if event.kind is RecorderEventKind.GATEWAY else EntryKind.RECORDER
        by = _plain(event.robot, kind, event.severity, row.publish_ns, event.text, EntrySource.RECORDER)
        self._hold(msgspec.structs.replace(by, operator=event.operator))

    def _take_gap(self, _robot: RobotTrack, _row: Row, gap: RecordGap) -> None:
        parts = keys.parse(gap.key)
        words = _GAPS.get(gap.reason.value, gap.reason.value)
        text = f"{gap.count} messages of {gap.key} reached the recorder and are not in the log: {words}"
        robot = ""
        if parts is not None:
            of_root = f"{parts.root}/{parts.robot}"
            robot = of_root if of_root in self._robots else parts.robot
        entry = _plain(robot, EntryKind.GAP, Severity.WARNING, gap.first_ns, text, EntrySource.RECORDER)
        self._hold(msgspec.structs.replace(entry, last_ns=max(gap.first_ns, gap.last_ns), count=gap.count))


_GAPS: Final = {
    "queue": "they came faster than they could be recorded",
    "disk": "the disk did not take or keep them",
    "full": "there was no room on the disk",
    "size": "they were too large",
}

_TAKES: Final[dict[type[msgspec.Struct] | None, Callable[[Timeline, RobotTrack, Row, Any], None]]] = {
    SafetyEvent: Timeline._take_event,  # noqa: SLF001 - its own table
    Decision: Timeline._take_decision,  # noqa: SLF001
    SafetyState: Timeline._take_state,  # noqa: SLF001
    GatewayHealth: Timeline._take_health,  # noqa: SLF001
    RecorderEvent: Timeline._take_recorder_event,  # noqa: SLF001
    RecordGap: Timeline._take_gap,  # noqa: SLF001
}
"""The handler of each class; other classes are not read."""


def _plain(
    robot: str,
    kind: EntryKind,
    severity: Severity,
    time_ns: int,
    text: str,
    source: EntrySource = EntrySource.STATE,
) -> Entry:
    """An entry that nobody did and that has no reason of the arbiter's."""
    return Entry(
        time_ns=time_ns, last_ns=time_ns, robot=robot, kind=kind, severity=severity, source=source, text=text
    )


def _ending_of(robot: RobotTrack, logs: Sequence[LogFile], to_ns: int) -> LogEnding | None:
    return ending(robot, [(log.start_ns, log.end_ns) for log in logs_of(robot.name, logs)], to_ns)


def _states_of(robot: str) -> Wants:
    return lambda topic: topic.robot == robot and topic.kind is SafetyState


def _says(state: SafetyState) -> tuple[object, ...]:
    """Return the part of a state whose changes make entries."""
    return state.state, state.lease_holder, state.latched, state.guarded
