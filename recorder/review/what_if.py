"""Recorded runs with other settings, and reruns of many logs, one task a log.

A run with other settings gives the decisions that would differ, and the robot's motion. Where it commands the
chassis differently, a model of the chassis answers in place of the recorded one. Operators' requests stay as
recorded.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

import msgspec

from gateway.chassis.odometry import GAP_NS, DeadReckoning
from gateway.choice.chassis import CHASSIS
from gateway.rerun import what_if
from recorder.reading.logs import Faults, LogFile, logs_of
from recorder.reading.rows import Progress
from recorder.reading.survey import CONFIGURATION, Configurations, configurations_of, settings_from, survey
from recorder.reading.topics import UNREADABLE
from recorder.review.rerun import NO_CONFIGURATION, RerunPlayer, RerunResult, rerun_parts
from schemas import codec
from schemas.codec import Sample
from schemas.configuration import TomlSource, merge
from schemas.decisions import Decision, EventKind, SafetyEvent
from schemas.journal import COMMAND_RULES
from schemas.messages import RobotState
from schemas.settings import STANDSTILL_MPS, Settings
from schemas.subjects import BY_NAME


class TriedSettings(msgspec.Struct, frozen=True):
    """The run's own configuration or another one, and changes to it; called with the recorded TOML text.

    Attributes:
        text: the other configuration as TOML; None for the run's own.
        changes: values by the name of the setting, as ``command.speed_limit_mps``.
    """

    text: str | None
    path: str
    changes: dict[str, object]

    @property
    def is_own(self) -> bool:
        return self.text is None and not self.changes

    def __call__(self, recorded: str) -> Settings:
        """Return the settings to try; CommandError if a value is invalid in this version."""
        if self.text is None:
            source = TomlSource(CONFIGURATION, recorded, is_recorded=True)
        else:
            source = TomlSource(self.path, self.text)
        return merge(source, {}, self.changes)


STOP_TOLERANCE_NS: Final = 2_000_000_000  # stops of one reason within this time are the same stop
MOVED_NS: Final = 10_000_000  # a stop moved by this much, a tick of the arbiter, is reported


class StopMade(msgspec.Struct, frozen=True):
    """A stop of the robot; the time is in nanoseconds since 1970."""

    time_ns: int
    reason: str
    operator: str
    text: str


class StopMoved(msgspec.Struct, frozen=True):
    """A stop of both runs, in the other one at another time, in nanoseconds since 1970."""

    stop: StopMade
    other_ns: int


class StopsCompared(msgspec.Struct, frozen=True):
    """The stops of two runs: only in the recorded one, only in the other, and in both at different times."""

    avoided: list[StopMade]
    added: list[StopMade]
    moved: list[StopMoved]


class CounterfactualVerdict(msgspec.Struct, frozen=True):
    """The outcome of a request: the verdict, its reason, and the limits that bound it."""

    verdict: str
    reason: str
    bound_by: tuple[str, ...]

    def __str__(self) -> str:
        """Name it with its reason and the limits, for people."""
        text = self.verdict if self.reason == "none" else f"{self.verdict} ({self.reason})"
        return f"{text}, limited by {' and '.join(self.bound_by)}" if self.bound_by else text


class DecisionChange(msgspec.Struct):
    """Requests of one kind that would have been decided differently, from ``first_ns`` to ``last_ns``."""

    operator: str
    request: str
    recorded: CounterfactualVerdict
    other: CounterfactualVerdict
    count: int
    first_ns: int
    last_ns: int


class Journey(msgspec.Struct):
    """The motion of a robot."""

    distance_m: float = 0.0
    moving_s: float = 0.0
    top_speed_mps: float = 0.0
    stops: list[StopMade] = []


class WhatIfResult(msgspec.Struct, frozen=True):
    """A run with its own and with other settings.

    Attributes:
        settings: each setting that differs: recorded and tried value.
        first, inputs, detail, rules: as in ``rerun.RerunResult``.
        decisions: number of decisions of both runs; ``changes`` are those that differ.
        stops_avoided, stops_added, stops_moved: stops only in the recorded run, only in the other one, and at
            different times.
    """

    robot: str
    run: int
    first: int
    inputs: int
    detail: str
    start_ns: int
    end_ns: int
    settings: dict[str, tuple[object, object]]
    decisions: int
    changes: list[DecisionChange]
    recorded: Journey
    other: Journey
    stops_avoided: list[StopMade]
    stops_added: list[StopMade]
    stops_moved: list[StopMoved]
    rules: int = COMMAND_RULES

    @property
    def differs_ns(self) -> int | None:
        """The time of the first decision or stop that differs; None if there is none."""
        decided = [change.first_ns for change in self.changes]
        stops = [*self.stops_avoided, *self.stops_added, *(moved.stop for moved in self.stops_moved)]
        return min([*decided, *(stop.time_ns for stop in stops)], default=None)


def what_if_parts(player: RerunPlayer, settings_of: Callable[[str], Settings]) -> Iterator[WhatIfResult]:
    """Rerun every run of a player with its own settings, and with others made from its TOML text."""
    while player.next_part():
        yield _what_if(player, settings_of)


def _what_if(player: RerunPlayer, settings_of: Callable[[str], Settings]) -> WhatIfResult:
    text = player.configuration()
    pair = _RunsCompared()
    changed: dict[str, tuple[object, object]] = {}
    if text is None:
        run = player.skip(NO_CONFIGURATION)
    else:
        settings, other = settings_from(text), settings_of(text)
        changed = _changed_settings(settings, other)
        try:
            for output in what_if(settings, other, player.journals()):
                pair.take(output.sample, is_other=output.is_other)
        except UNREADABLE as error:
            player.break_off(error)
        run = player.result(pair.start_ns)
    return pair.result(run, changed)


def _changed_settings(settings: Settings, other: Settings) -> dict[str, tuple[object, object]]:
    """The settings of the arbiter that differ."""
    return {
        f"{section}.{name}": (was, tried)
        for section in ("command", "chassis", "gateway")
        for name in getattr(settings, section).__struct_fields__
        if (was := getattr(getattr(settings, section), name)) != (tried := getattr(getattr(other, section), name))
    }


def compared(recorded: Sequence[StopMade], other: Sequence[StopMade]) -> StopsCompared:
    """Pair the stops of two runs by reason and time."""
    by_reason: dict[str, deque[StopMade]] = {}
    for stop in sorted(other, key=_time):
        by_reason.setdefault(stop.reason, deque()).append(stop)
    found = StopsCompared([], [], [])
    for stop in sorted(recorded, key=_time):
        left = by_reason.get(stop.reason, deque())
        # In order of time: what is too early for this stop is too early for all later ones.
        while left and left[0].time_ns < stop.time_ns - STOP_TOLERANCE_NS:
            found.added.append(left.popleft())
        if not left or left[0].time_ns > stop.time_ns + STOP_TOLERANCE_NS:
            found.avoided.append(stop)
        elif abs((other_ns := left.popleft().time_ns) - stop.time_ns) >= MOVED_NS:
            found.moved.append(StopMoved(stop, other_ns))
    found.added.extend(stop for left in by_reason.values() for stop in left)
    found.added.sort(key=_time)
    return found


def _time(stop: StopMade) -> int:
    return stop.time_ns


class _Side:
    """One of the two runs."""

    def __init__(self) -> None:
        self.journey = Journey()
        self.waiting: dict[int, Decision] = {}
        self._last: RobotState | None = None
        self._way = DeadReckoning(CHASSIS.wheelbase_m)

    def take_state(self, state: RobotState) -> None:
        last, self._last = self._last, state
        speed_mps = state.speed_mps
        if speed_mps is None:
            return
        self.journey.top_speed_mps = max(self.journey.top_speed_mps, abs(speed_mps))
        self._way.move(state.time_ns, speed_mps, state.angle_deg or 0.0)
        self.journey.distance_m = self._way.distance_m
        if last is None or last.speed_mps is None:
            return
        passed_s = (state.time_ns - last.time_ns) / 1e9
        if not 0 < passed_s <= GAP_NS / 1e9:
            return
        mean_mps = (abs(last.speed_mps) + abs(speed_mps)) / 2
        if mean_mps > STANDSTILL_MPS:
            self.journey.moving_s += passed_s


class _RunsCompared:
    """The comparison of both runs; ``start_ns`` and ``end_ns`` are those of the states, 0 before the first."""

    def __init__(self) -> None:
        self.changes: dict[tuple[object, ...], DecisionChange] = {}
        self.start_ns = self.end_ns = 0
        self._sides = {False: _Side(), True: _Side()}
        self._decisions = 0

    def take(self, sample: Sample, *, is_other: bool) -> None:
        if sample.subject not in _TAKEN:
            return
        message = codec.decode(BY_NAME[sample.subject], sample.payload)
        side = self._sides[is_other]
        match message:
            case RobotState():
                self.start_ns = self.start_ns or message.time_ns
                self.end_ns = message.time_ns
                side.take_state(message)
            case SafetyEvent(kind=EventKind.STOP):
                stop = StopMade(message.time_ns, message.reason.value, message.operator, message.text)
                side.journey.stops.append(stop)
            case Decision():
                self._take_decision(message, is_other=is_other)
            case _:
                pass

    def result(self, run: RerunResult, settings: dict[str, tuple[object, object]]) -> WhatIfResult:
        recorded, tried = self._sides[False].journey, self._sides[True].journey
        stops = compared(recorded.stops, tried.stops)
        return WhatIfResult(
            robot=run.robot,
            run=run.run,
            first=run.first,
            inputs=run.inputs,
            detail=run.detail,
            start_ns=self.start_ns,
            end_ns=self.end_ns,
            settings=settings,
            decisions=self._decisions,
            changes=list(self.changes.values()),
            recorded=recorded,
            other=tried,
            stops_avoided=stops.avoided,
            stops_added=stops.added,
            stops_moved=stops.moved,
            rules=run.rules,
        )

    def _take_decision(self, decision: Decision, *, is_other: bool) -> None:
        """Pair the decisions of both runs by sequence: both decide the same requests in the same order."""
        counterpart = self._sides[not is_other].waiting.pop(decision.sequence, None)
        if counterpart is None:
            self._sides[is_other].waiting[decision.sequence] = decision
            return
        self._decisions += 1
        recorded, other = (counterpart, decision) if is_other else (decision, counterpart)
        was, would_be = _verdict_of(recorded), _verdict_of(other)
        if was == would_be:
            return
        key = (recorded.operator, recorded.request, was, would_be)
        change = self.changes.get(key)
        if change is None:
            self.changes[key] = DecisionChange(
                recorded.operator, recorded.request, was, would_be, 1, recorded.time_ns, recorded.time_ns
            )
        else:
            change.count += 1
            change.last_ns = recorded.time_ns


_TAKEN: Final = frozenset({"state", "safety/decision", "safety/event"})


def _verdict_of(decision: Decision) -> CounterfactualVerdict:
    return CounterfactualVerdict(
        decision.verdict.value, decision.reason.value, tuple(bound.value for bound in decision.bound_by)
    )


FOLLOWS_NS: Final = 600_000_000_000
"""Files of a robot within this time are one log: a gateway stores its journal for about ten minutes, and a
returning recorder queries it, so that a run continues over the gap."""


class RerunTask(msgspec.Struct, frozen=True):
    """A log of a robot."""

    robot: str
    logs: list[LogFile]
    configurations: Configurations
    tried: TriedSettings

    @property
    def bytes(self) -> int:
        return sum(log.bytes for log in self.logs)


class RerunOutcome(msgspec.Struct, frozen=True):
    """The results of a task: one for each run of a gateway, or for each part of one between gaps."""

    results: list[RerunResult | WhatIfResult]
    faults: Faults


def rerun_tasks(logs: Sequence[LogFile], tried: TriedSettings, faults: Faults) -> list[RerunTask]:
    """The logs of all robots, by robot and time."""
    found = survey(logs, faults)
    tasks = []
    for robot in found.robots:
        files = logs_of(robot, logs)
        # A recorder writes a new configuration once, perhaps in an earlier log.
        configurations = configurations_of(robot, files, found, faults)
        tasks += [RerunTask(robot, log, configurations, tried) for log in _joined(files)]
    return tasks


def _joined(files: Iterable[LogFile]) -> Iterator[list[LogFile]]:
    """Group successive files."""
    log: list[LogFile] = []
    end_ns = 0
    for file in files:
        if log and file.start_ns - end_ns > FOLLOWS_NS:
            yield log
            log = []
        log.append(file)
        end_ns = max(end_ns, file.end_ns)
    if log:
        yield log


def run_task(task: RerunTask, progress: Progress) -> RerunOutcome:
    """Rerun a log with its own settings, or with others."""
    faults = Faults()
    player = RerunPlayer(task.robot, task.logs, task.configurations, faults, progress)
    parts = rerun_parts(player) if task.tried.is_own else what_if_parts(player, task.tried)
    return RerunOutcome(list(parts), faults)
