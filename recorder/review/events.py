"""Events in order: leases, engagements, stops, latches, faults, takeovers, refusals, and gaps in the log.

One pass over the messages of arbiter, gateway and recorder. Entries are held back, up to a limit: a message
that was recorded late takes its place, and a later one can correct an entry.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from heapq import heappop, heappush
from operator import itemgetter
from typing import Any, Final

import msgspec

from recorder.reading.logs import Faults, LogFile, logs_of
from recorder.reading.rows import Progress, Row, Selection, Wants, read_rows
from recorder.reading.topics import UNREADABLE
from recorder.review.entries import (
    DROPPED,
    IDS_KEPT,
    NEAR_NS,
    OF_EVENT,
    Entry,
    EntryKind,
    EntrySource,
    Repeats,
    RobotClock,
    Sequences,
    Spells,
    Stops,
    kind_of,
    risen,
)
from schemas import keys
from schemas.decisions import (
    ArbiterState,
    Decision,
    EventKind,
    SafetyEvent,
    SafetyState,
    Severity,
    Verdict,
    is_same_run,
)
from schemas.messages import GatewayHealth
from schemas.reasons import TEXTS, Reason
from schemas.recording import RecorderEvent, RecorderEventKind, RecordGap
from schemas.settings import SAFETY_STATE_PERIOD_NS, TICK_NS

HELD_MAX: Final = 20_000
"""Limit of entries that are held back. One that comes later is shown out of order, and marked."""

LATER_NS: Final = 15 * 60 * 1_000_000_000
"""The log is read this far beyond the wanted time, for messages that were recorded late."""

LEAD_NS: Final = 5 * 1_000_000_000
"""States are read from this long before the wanted time, so that a change at its start is seen."""

SILENT_NS: Final = 1_000_000_000  # a longer time without states is a gap; they come 20 times a second
HOLDERS_KEPT: Final = 10_000  # limit of changes of the lease that are kept

_UNTOLD: Final = frozenset(
    {"drive", "renew", "acquire", "take", "release", "engage", "disengage", "stop", "reset"}
)
"""Accepted requests without an entry: they have an event of their own, or are part of a stream."""

_EXPECTED: Final = frozenset({Reason.STOPPING, Reason.ENGAGING, Reason.ALREADY_ENGAGED, Reason.BUSY})
"""Refusals that are no fault: a stream of commands continues for a while."""


def is_within(entry: Entry, selection: Selection) -> bool:
    return entry.time_ns < selection.to_ns and entry.last_ns >= selection.from_ns


def hung_ns(was: SafetyState, now: SafetyState, silent_ns: int) -> int:
    """The time that a gateway's loop hung between two states of one run, by its ticks; else 0."""
    lacking_ns = silent_ns - (now.tick - was.tick) * TICK_NS
    return silent_ns if is_same_run(was.tick, now.tick) and lacking_ns > 2 * SAFETY_STATE_PERIOD_NS else 0


def read_events(
    logs: Sequence[LogFile],
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
    *,
    robots: Collection[str] = (),
    kinds: Collection[EntryKind] = (),
) -> Iterator[Entry]:
    """Yield the entries of these robots and kinds, by default of all, in order.

    Entries about no robot are included.
    """

    def is_of(robot: str) -> bool:
        return not robots or not robot or robot in robots

    def is_wanted(entry: Entry) -> bool:
        return is_within(entry, selection) and (not kinds or entry.kind in kinds) and is_of(entry.robot)

    looked_at = Selection(
        lambda topic: topic.kind in _TAKES and is_of(topic.robot) and selection.wants(topic),
        max(0, selection.from_ns - LEAD_NS),
        selection.to_ns + LATER_NS,
    )
    timeline = Timeline(faults)
    for row in read_rows(logs, looked_at, faults, progress):
        timeline.take(row)
        yield from filter(is_wanted, timeline.tell())
    timeline.hear_behind_silence(logs, looked_at.to_ns)
    timeline.endings(logs, looked_at.to_ns)
    yield from filter(is_wanted, timeline.end())


class LogEnding(msgspec.Struct, frozen=True):
    """An end of a robot's log: the gateway went silent (``is_silent``), or the log ends."""

    entry: Entry
    is_silent: bool
    is_commanding: bool


class _Held(msgspec.Struct):
    """An entry that is held back, and may be corrected or dropped."""

    entry: Entry
    is_void: bool = False

    def correct(self, **fields: Any) -> None:  # noqa: ANN401 - any field of an entry
        self.entry = msgspec.structs.replace(self.entry, **fields)


class RobotTrack:
    """One robot, as far as the log has been read.

    Attributes:
        name: empty for messages of no robot.
        state: the arbiter's newest; its run was first seen at ``run_since_ns``.
        ended_tick: the tick of the last announced shutdown; None if there was none.
        is_shared: two gateways use its name.
        steps: ticks at which the computer's clock was set back, each with the sum so far.
        hung: start and end of the loop's last hang.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.clock = RobotClock()
        self.stops = Stops()
        self.state: SafetyState | None = None
        self.state_ns = self.state_log_ns = self.state_sequence = self.run_since_ns = 0
        self.ended_tick: int | None = None
        self.health: GatewayHealth | None = None
        self.health_ns = 0
        self.is_shared = False
        self.steps: list[tuple[int, int]] = []
        self.hung = (0, 0)
        self.doubtful: _Held | None = None  # a gap that may be a step of the clock
        self.begun: list[_Held] = []  # entries about the last restart
        self.died: _Held | None = None  # the death that a recorder reported, until a state comes again
        self._holders: deque[tuple[int, str]] = deque(maxlen=HOLDERS_KEPT)
        self._runs: list[int] = []
        self._state_runs: list[int] = []
        self._sequences: dict[tuple[str, int], Sequences] = {}

    def place(self, row: Row, tick: int | None = None) -> int:
        """The time of a row's event by the recorder's clock."""
        return self.clock.place(row.publish_ns, row.log_ns, tick)

    def count(self, row: Row, tick: int, time_ns: int) -> None:
        self._sequences.setdefault((row.topic.name, self.run_of(tick)), Sequences()).add(row.sequence, time_ns)

    def order_ns(self, time_ns: int, tick: int | None = None) -> int:
        """The time without the steps back of the computer's clock."""
        set_ns = [by_ns for at_tick, by_ns in self.steps if tick is None or tick >= at_tick]
        return time_ns - (set_ns[-1] if set_ns else 0)

    @property
    def is_ended(self) -> bool:
        """True if the newest gateway shut down as requested, at rest."""
        state, ended = self.state, self.ended_tick
        return state is not None and ended is not None and not self.is_active and is_same_run(state.tick, ended)

    @property
    def is_active(self) -> bool:
        return self.state is not None and self.state.state is not ArbiterState.STANDBY

    @property
    def left(self) -> str:
        """The gateway's newest state and commanded speed in words."""
        if self.state is None or not self.is_active:
            return "standby"
        return f"{self.state.state.value}, commanded {round(self.state.output_speed_mps, 2) + 0.0:.2f} m/s"

    def hear_state(self, state: SafetyState, sequence: int, time_ns: int, log_ns: int) -> None:
        if not self._holders or self._holders[-1][1] != state.lease_holder:
            if self._holders and state.tick < self._holders[-1][0]:
                self._holders.clear()
            self._holders.append((state.tick, state.lease_holder))
        if not self._state_runs or not is_same_run(state.tick, self._state_runs[-1]):
            self._state_runs.append(state.tick)
            self.run_since_ns = time_ns
        self.state, self.state_sequence = state, sequence
        self.state_ns, self.state_log_ns = time_ns, log_ns

    def holder_at(self, tick: int) -> str:
        """The holder of the lease before this tick; empty if there was none or it is unknown."""
        at = bisect_left(self._holders, tick, key=itemgetter(0))
        return self._holders[at - 1][1] if at else ""

    def holes(self) -> Iterator[Entry]:
        for (topic, _), sequences in self._sequences.items():
            for hole in sequences.holes():
                text = f"{hole.count} samples of {topic} are not in the log"
                last_ns = max(hole.after_ns, hole.before_ns)
                yield _of_log(self.name, EntryKind.GAP, hole.after_ns, text, count=hole.count, last_ns=last_ns)

    def run_of(self, tick: int) -> int:
        """The number of a tick's run, counted from the first in the log."""
        for number, newest in enumerate(self._runs):
            if is_same_run(tick, newest):
                self._runs[number] = max(tick, newest)
                return number
        self._runs.append(tick)
        return len(self._runs) - 1

    def is_back(self, tick: int) -> bool:
        """True if another run has come after this one."""
        return any(is_same_run(tick, one) for one in self._state_runs[:-1])


class Timeline:
    """Makes entries of rows.

    ``kept``: so many samples of each topic are recognised when they come a second time.
    """

    def __init__(self, faults: Faults, *, kept: int = IDS_KEPT) -> None:
        self._faults = faults
        self._kept = kept
        self._robots: dict[str, RobotTrack] = {}
        self._repeats: dict[str, Repeats] = {}
        self._held: list[tuple[int, int, _Held]] = []
        self._count = 0
        self._spells = Spells()
        self._spells_due_ns = 0
        self._told_ns = 0
        self._log_ns = 0

    def take(self, row: Row, decoded: Any = None) -> None:  # noqa: ANN401 - any message of ours
        """Take the next row by log time; ``decoded`` if it has been decoded already."""
        topic = row.topic
        take = _TAKES.get(topic.kind)
        if take is None or topic.decode is None:
            return
        if not self._repeats.setdefault(topic.name, Repeats(self._kept)).is_new(row.publish_ns, row.sequence):
            return
        try:
            message = topic.decode(row.data) if decoded is None else decoded
        except UNREADABLE as error:
            self._faults.add(f"{topic.name}: a message that cannot be read: {error}")
            return
        self._log_ns = row.log_ns
        take(self, self.robot(topic.robot), row, message)
        if not 0 <= self._spells_due_ns - row.log_ns <= SILENT_NS:
            self._spells_due_ns = row.log_ns + SILENT_NS
            for entry in self._spells.take(row.log_ns):
                self._hold(entry)

    def robot(self, name: str) -> RobotTrack:
        found = self._robots.get(name)
        if found is None:
            found = self._robots[name] = RobotTrack(name)
        return found

    def tell(self) -> Iterator[Entry]:
        """Yield the entries beyond ``HELD_MAX``."""
        while len(self._held) > HELD_MAX:
            yield from self._next()

    def hear_behind_silence(self, logs: Sequence[LogFile], to_ns: int) -> None:
        """Read the next state of each robot that is silent at ``to_ns``, and its health if that is not enough.

        The tick shows whether the gateway is the same: a clock that is set forward leaves a gap too.
        """
        for robot in list(self._robots.values()):
            found = self._ending(robot, logs, to_ns)
            if found is not None and found.is_silent:
                for row in read_rows(logs, Selection(_says_of_itself(robot.name), to_ns), self._faults):
                    self.take(row)
                    if robot.doubtful is None and row.topic.kind is SafetyState:
                        break

    def endings(self, logs: Sequence[LogFile], to_ns: int) -> list[LogEnding]:
        """The end of each robot's logs; ``end`` yields them as entries too. After the last row."""
        either = (self._ending(robot, logs, to_ns) for robot in self._robots.values())
        found = [one for one in either if one is not None]
        for one in found:
            self._hold(one.entry)
        return found

    def end(self) -> Iterator[Entry]:
        """Yield the remaining entries, after the last row."""
        for entry in self._spells.take():
            self._hold(entry)
        for robot in self._robots.values():
            for entry in robot.holes():
                self._hold(entry)
        while self._held:
            yield from self._next()

    def _hold(self, entry: Entry) -> _Held:
        held = _Held(entry)
        robot = self._robots.get(entry.robot)
        order_ns = entry.time_ns if robot is None else robot.order_ns(entry.time_ns, entry.tick)
        self._count += 1
        heappush(self._held, (order_ns, self._count, held))
        return held

    def _next(self) -> Iterator[Entry]:
        order_ns, _, held = heappop(self._held)
        entry, robot = held.entry, self._robots.get(held.entry.robot)
        if held.is_void:
            return
        if robot is not None:
            entry = robot.stops.mark(entry)
        is_late = order_ns < self._told_ns
        self._told_ns = max(self._told_ns, order_ns)
        yield msgspec.structs.replace(entry, is_late=True) if is_late else entry

    def _ending(self, robot: RobotTrack, logs: Sequence[LogFile], to_ns: int) -> LogEnding | None:
        """The end of a robot's log; None if it ended in order. Between two files there was no recorder."""
        ends = [log.end_ns for log in logs_of(robot.name, logs) if log.start_ns < to_ns]
        if robot.state is None or robot.is_ended or not ends:
            return None
        # Log times from before a step back do not show the end.
        end_ns = self._log_ns if robot.steps else max(ends)
        silent_ns = min(end_ns, to_ns) - robot.state_log_ns
        is_silent = silent_ns > SILENT_NS
        if is_silent:
            text = f"no arbiter state for {silent_ns / 1e9:.1f} s, until the end: the gateway went silent, "
        elif robot.is_active and end_ns < to_ns:
            text = "the log ends here: "
        else:
            return None
        severity = Severity.ERROR if is_silent and robot.is_active else Severity.WARNING
        last_ns = robot.state_ns + (silent_ns if is_silent else 0)
        text += robot.left
        entry = _of_log(robot.name, EntryKind.GAP, robot.state_ns, text, severity=severity, last_ns=last_ns)
        return LogEnding(entry, is_silent, robot.is_active)

    # One for each class of messages.

    def _take_event(self, robot: RobotTrack, row: Row, event: SafetyEvent) -> None:
        if event.kind is EventKind.GATEWAY:
            robot.ended_tick = event.tick
        time_ns = robot.place(row, event.tick)
        robot.count(row, event.tick, time_ns)
        entry = _entry(
            robot.name,
            kind_of(OF_EVENT.get(event.kind, EntryKind.FAULT), event.reason),
            time_ns,
            event.text,
            severity=event.severity,
            source=EntrySource.EVENT,
            reason=event.reason,
            operator=event.operator,
            holder=robot.holder_at(event.tick),
            tick=event.tick,
        )
        self._hold(entry)

    def _take_decision(self, robot: RobotTrack, row: Row, decision: Decision) -> None:
        time_ns = robot.place(row, decision.tick)
        robot.count(row, decision.tick, time_ns)
        is_refused = decision.verdict is Verdict.REFUSED
        if not is_refused and decision.request in _UNTOLD:
            return
        request = decision.request or "unnamed request"
        why = decision.detail or TEXTS[decision.reason].means
        text = f"{request} refused: {why}" if is_refused else f"{request} accepted"
        expected = not is_refused or decision.reason in _EXPECTED
        entry = _entry(
            robot.name,
            EntryKind.REFUSAL if is_refused else EntryKind.REQUEST,
            time_ns,
            text,
            severity=Severity.INFO if expected else Severity.WARNING,
            source=EntrySource.DECISION,
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
        is_other_run = was is not None and not is_same_run(state.tick, was.tick)
        if is_other_run and robot.is_back(state.tick) and not robot.is_shared:
            self._share(robot, robot.place(row, state.tick))
        if robot.is_shared:
            robot.state, robot.state_ns, robot.state_log_ns = state, robot.place(row), row.log_ns
            return
        said, would_be_ns = robot.clock.hear(state.tick, row.publish_ns, row.log_ns), 0
        time_ns = robot.place(row, state.tick)
        if was is not None and is_other_run:
            self._take_other_run(robot, time_ns)
        elif was is not None:
            if state.tick <= was.tick:
                return
            step_ns = self._take_step(robot, state, was, time_ns)
            if step_ns:
                said, would_be_ns = f"the computer's clock was set by {step_ns / 1e9:+.1f} s", time_ns - step_ns
            self._look_for_silence(robot, row, state, was, time_ns)
            if state.guarded is not was.guarded:
                severity = Severity.INFO if state.guarded else Severity.WARNING
                text = "a guard watches the gateway" if state.guarded else "the guard is gone"
                more: dict[str, Any] = {"holder": state.lease_holder, "tick": state.tick}
                self._hold(_entry(robot.name, EntryKind.GUARD, time_ns, text, severity=severity, **more))
        if said:
            last_ns = max(time_ns, would_be_ns)
            self._hold(_of_log(robot.name, EntryKind.CLOCK, time_ns, said, last_ns=last_ns))
        robot.hear_state(state, row.sequence, time_ns, row.log_ns)

    def _share(self, robot: RobotTrack, time_ns: int) -> None:
        """An earlier run continues: two gateways run at the same time."""
        robot.is_shared = True
        for held in robot.begun:
            held.is_void = True
        text = "two gateways use this name: these entries are from both"
        self._hold(_entry(robot.name, EntryKind.GATEWAY, time_ns, text))

    def _take_other_run(self, robot: RobotTrack, time_ns: int) -> None:
        left, active = robot.left, robot.is_active
        severity = Severity.INFO if robot.is_ended else Severity.ERROR if active else Severity.WARNING
        robot.begun, robot.died, robot.doubtful = [], None, None
        robot.steps = [(0, robot.steps[-1][1])] if robot.steps else []
        silent_ns = time_ns - robot.state_ns
        if silent_ns > SILENT_NS and not robot.is_ended:
            text = f"no arbiter state for {silent_ns / 1e9:.1f} s: the gateway went silent, {left}"
            entry = _of_log(robot.name, EntryKind.GAP, robot.state_ns, text, severity=severity, last_ns=time_ns)
            robot.begun.append(self._hold(entry))
        text = "the gateway restarted: earlier leases, engagement and latches are void"
        text += f"; before that it was {left}" if active else ""
        robot.begun.append(self._hold(_entry(robot.name, EntryKind.GATEWAY, time_ns, text, severity=severity)))

    def _take_step(self, robot: RobotTrack, state: SafetyState, was: SafetyState, time_ns: int) -> int:
        """The step back of the clock, by the ticks; else 0."""
        by_ns = time_ns - robot.state_ns - robot.clock.corrected_ns - (state.tick - was.tick) * TICK_NS
        if by_ns >= -NEAR_NS or time_ns >= robot.state_ns:
            return 0
        before_ns = robot.steps[-1][1] if robot.steps else 0
        robot.steps.append((state.tick, before_ns + by_ns))
        return by_ns

    def _look_for_silence(
        self, robot: RobotTrack, row: Row, state: SafetyState, was: SafetyState, time_ns: int
    ) -> None:
        # The offset may have been corrected since the last state.
        was_ns = robot.state_ns + robot.clock.corrected_ns
        silent_ns = time_ns - was_ns
        missed = (row.sequence - robot.state_sequence - 1) % 2**32
        stood_ns = 0 if missed else hung_ns(was, state, silent_ns)
        if stood_ns:
            robot.hung = (was_ns, time_ns)
        if robot.died is not None:
            self._revive(robot, robot.died, row.log_ns - robot.state_log_ns)
        if silent_ns <= SILENT_NS:
            return
        ticks = state.tick - was.tick
        made = f"the gateway ran {ticks} tick{'' if ticks == 1 else 's'} in that time"
        why = f"{missed} samples are missing" if missed else made
        text = f"no arbiter state for {silent_ns / 1e9:.1f} s: {why}"
        entry = _of_log(robot.name, EntryKind.GAP, was_ns, text, last_ns=time_ns, count=max(1, missed))
        held = self._hold(entry)
        robot.doubtful = held if stood_ns else None

    def _revive(self, robot: RobotTrack, death: _Held, heard_ns: int) -> None:
        """Correct a death that a recorder reported: the run continues."""
        since_ns, until_ns = robot.hung
        hung = since_ns - SILENT_NS <= death.entry.time_ns <= until_ns
        how = "its loop had hung" if hung else "it had run on, the recorder or the link had stalled"
        text = (
            f"the recorder received nothing from the gateway for {heard_ns / 1e9:.1f} s, "
            f"then the same run continued: {how}"
        )
        death.correct(text=text, severity=Severity.WARNING)
        robot.died = None

    def _take_health(self, robot: RobotTrack, row: Row, health: GatewayHealth) -> None:
        if robot.is_shared:
            return
        time_ns = robot.place(row)
        was, was_ns = robot.health, min(robot.health_ns, time_ns)
        if was is not None and health.uptime_s < was.uptime_s:
            was = None
        if robot.doubtful is not None and was is not None:
            self._judge(robot, robot.doubtful, round((health.uptime_s - was.uptime_s) * 1e9), time_ns - was_ns)
        robot.health, robot.health_ns = health, time_ns
        for one in risen(was, health):
            if one.what == "controller" and robot.state is not None:
                continue  # It has an event.
            text, is_dated = one.text, was is None or one.is_end
            if one.what == DROPPED and was_ns <= robot.hung[1] <= time_ns:
                seconds = (robot.hung[1] - robot.hung[0]) / 1e9
                text = f"request dropped unread: the loop hung for {seconds:.1f} s"
            began_ns = time_ns if is_dated else was_ns
            text += "" if is_dated else " (after this time, by the next gateway/health)"
            more = {"severity": one.severity, "source": EntrySource.HEALTH, "last_ns": time_ns, "count": one.count}
            entry = _entry(robot.name, one.kind, began_ns, text, **more)
            if one.severity is Severity.INFO and one.count == 1 and not one.about:
                self._hold(entry)
            else:
                self._spells.add((robot.name, one.what), entry, row.log_ns, one.about)

    def _judge(self, robot: RobotTrack, silence: _Held, up_ns: int, time_ns: int) -> None:
        """Decide by the gateway's uptime whether a gap was a hang or a step of the clock."""
        set_ns = time_ns - up_ns
        if set_ns > NEAR_NS:
            text = f"the computer's clock was set by {set_ns / 1e9:+.1f} s"
            silence.correct(kind=EntryKind.CLOCK, text=text, time_ns=silence.entry.last_ns)
            robot.hung = (0, 0)
        else:
            silence.correct(text=f"{silence.entry.text}, its loop hung")
        robot.doubtful = None

    def _take_recorder_event(self, _robot: RobotTrack, row: Row, event: RecorderEvent) -> None:
        kind = EntryKind.GATEWAY if event.kind is RecorderEventKind.GATEWAY else EntryKind.RECORDER
        more = {"severity": event.severity, "source": EntrySource.RECORDER, "operator": event.operator}
        held = self._hold(_entry(event.robot, kind, row.publish_ns, event.text, **more))
        robot = self._robots.get(event.robot)
        if robot is not None and kind is EntryKind.GATEWAY:
            robot.died = held
            if robot.run_since_ns < row.publish_ns < robot.state_ns:
                self._revive(robot, held, robot.hung[1] - robot.hung[0] or robot.state_ns - row.publish_ns)

    def _take_gap(self, _robot: RobotTrack, _row: Row, gap: RecordGap) -> None:
        parts = keys.parse(gap.key)
        words = _GAPS.get(gap.reason.value, gap.reason.value)
        text = f"{gap.count} messages of {gap.key} were received and not recorded: {words}"
        robot = ""
        if parts is not None:
            of_root = f"{parts.root}/{parts.robot}"
            robot = of_root if of_root in self._robots else parts.robot
        more = {"source": EntrySource.RECORDER, "last_ns": max(gap.first_ns, gap.last_ns), "count": gap.count}
        self._hold(_entry(robot, EntryKind.GAP, gap.first_ns, text, **more))


_GAPS: Final = {
    "queue": "they came faster than the recorder could write",
    "disk": "the disk did not store them",
    "full": "the disk was full",
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


def _entry(robot: str, kind: EntryKind, time_ns: int, text: str, **more: Any) -> Entry:  # noqa: ANN401 - any field
    """An entry; by default a warning from the arbiter's states, without duration."""
    plain: dict[str, Any] = {"severity": Severity.WARNING, "source": EntrySource.STATE, "last_ns": time_ns}
    return Entry(robot=robot, kind=kind, time_ns=time_ns, text=text, **(plain | more))


_of_log: Final = partial(_entry, source=EntrySource.LOG)


def _says_of_itself(robot: str) -> Wants:
    return lambda topic: topic.robot == robot and topic.kind in {SafetyState, GatewayHealth}
