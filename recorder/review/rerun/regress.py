"""Today's arbiter and settings against every minute of many logs, each run alone, the most novel first."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from typing import Final

import msgspec

from recorder.reading.configurations import Configurations, configurations_of
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile, logs_of
from recorder.reading.rows import Progress, Row, Selection, read_rows
from recorder.reading.survey import survey
from recorder.reading.topics import UNREADABLE
from recorder.review.rerun.minutes import UNCERTAIN, MinuteOutcome, MinuteRun, MinuteTask, run_minutes
from recorder.review.rerun.novelty import WITNESSES, by_novelty, happenings
from recorder.review.rerun.player import installed
from recorder.review.rerun.segments import RunSegment, plan
from recorder.review.rerun.tapes import JOURNAL
from recorder.review.rerun.tried_settings import TriedSettings
from recorder.review.tasks import look, outcome_of
from schemas.command_rules import COMMAND_RULES

MINUTE_NS: Final = 60_000_000_000

SHORTEST_NS: Final = 59_000_000_000
"""Checkpoints are a minute apart, and places of rest too: the first of them behind this time ends a minute."""

SMALL_NS: Final = 5_000_000_000
"""So much of a minute that was not run is not told: a part behind a gap begins at its first place."""

BEGUN_AHEAD: Final = 2
"""For each process so many tasks are begun before the first is waited for."""

SECOND_NS: Final = 1_000_000_000

NOT_IN_ITS_TURN: Final = "it was not its turn yet"
BEFORE_PLACE: Final = "it lies before the first place from which its run can be run again"


class RobotPlan(msgspec.Struct, frozen=True):
    """The minutes of a robot.

    Attributes:
        logs: those that hold it.
        segments: the minutes, one behind the other.
        happened: the things that happened in each.
    """

    robot: str
    logs: list[LogFile]
    configurations: Configurations
    segments: list[RunSegment]
    happened: list[frozenset[str]]
    faults: Faults


class OtherwiseMinute(msgspec.Struct, frozen=True):
    """A minute that decides otherwise.

    Attributes:
        rarest: the rarest thing in it, for which it was run early.
        logs: the names of the files that hold it.
        run: what differs.
    """

    robot: str
    rarest: str
    logs: list[str]
    run: MinuteRun


class RegressSummary(msgspec.Struct, frozen=True):
    """The sum over all minutes.

    Attributes:
        run: so many minutes were run.
        otherwise: so many of these decide otherwise.
        other_rules: so many of these again were made under other command rules, so that this was expected.
        not_run: so many minutes were not run, by reason.
    """

    run: int
    otherwise: int
    other_rules: int
    not_run: dict[str, float]


def plan_robot(robot: str, logs: list[LogFile]) -> RobotPlan:
    """Look through the logs of a robot, in this process: its minutes, and what happened in each."""
    faults = Faults()
    found = survey(logs, faults)
    seconds: dict[int, set[str]] = {}

    def take(row: Row) -> None:
        decode = row.topic.decode
        try:
            message = None if decode is None else decode(row.data)
        except UNREADABLE as error:
            faults.add(f"{row.topic.name}: a message that cannot be read: {error}")
        else:
            seconds.setdefault(row.publish_ns // SECOND_NS, set()).update(happenings(message))

    wanted = {JOURNAL, *WITNESSES}
    selection = Selection(lambda topic: topic.robot == robot and topic.subject in wanted)
    rows = read_rows(logs, selection, faults, look)
    planned = plan(rows, installed("places"), SHORTEST_NS, faults, take)
    segments = planned.segments if planned.parts else []
    begins_ns = [segment.from_ns for segment in segments]
    happened: list[set[str]] = [set() for _ in segments]
    for second, things in seconds.items():
        if segments:
            happened[bisect_right(begins_ns, second * SECOND_NS) - 1] |= things
    configurations = configurations_of(robot, logs, found, faults)
    return RobotPlan(robot, logs, configurations, segments, [frozenset(one) for one in happened], faults)


Place = tuple[int, int]
"""A robot, and a minute of it, each by its number."""


class Regress:
    """All minutes of the logs, run again.

    Args:
        logs: in the order of their beginnings.
        tried: the settings to run them with.
        faults: takes what cannot be read.
        pool: runs the tasks.
        jobs: so many of them at once.
        progress: receives numbers of bytes, as they are done.
    """

    def __init__(
        self,
        logs: Sequence[LogFile],
        tried: TriedSettings,
        faults: Faults,
        pool: Executor,
        jobs: int,
        progress: Progress = lambda _: None,
    ) -> None:
        self._tried = tried
        self._faults = faults
        self._pool = pool
        self._ahead = BEGUN_AHEAD * jobs
        self._progress = progress
        self._size = sum(log.bytes for log in logs)
        robots = survey(logs, faults).robots
        planned = [pool.submit(plan_robot, robot, logs_of(robot, logs)) for robot in robots]
        self._plans = [outcome_of(future, progress) for future in planned]
        for one in self._plans:
            faults.add_all(one.faults)
        self._places = [
            (robot, number) for robot, one in enumerate(self._plans) for number in range(len(one.segments))
        ]
        self._order = by_novelty([self._plans[robot].happened[number] for robot, number in self._places])
        self._novelty = {self._places[one.minute]: one for one in self._order}
        self._futures: dict[Place, Future[MinuteOutcome]] = {}
        self._alone: dict[Place, list[MinuteRun]] = {}
        self._runs: dict[Place, list[MinuteRun]] = {}
        """The true ones, by minute: run alone, or on from the minute before."""

    def run(self, most: int | None = None) -> None:
        """Run the minutes, or the most novel of them."""
        turn = deque(self._places[one.minute] for one in self._order[:most])
        begun: deque[Place] = deque()
        while turn or begun:
            while turn and len(begun) < self._ahead:
                place = turn.popleft()
                self._begin(place)
                begun.append(place)
            place = begun.popleft()
            self._settle(place)
            self._progress(self._size // len(self._places))

    def _begin(self, place: Place) -> Future[MinuteOutcome]:
        future = self._futures.get(place)
        if future is None:
            future = self._futures[place] = self._submit(place, 1)
        return future

    def _submit(self, place: Place, most: int | None = None) -> Future[MinuteOutcome]:
        robot, number = place
        one = self._plans[robot]
        segments = one.segments[number : None if most is None else number + most]
        from_ns, to_ns = segments[0].log_from_ns, segments[-1].log_to_ns
        logs = [log for log in one.logs if log.start_ns < to_ns and log.end_ns >= from_ns]
        return self._pool.submit(
            run_minutes, MinuteTask(one.robot, logs, one.configurations, segments, self._tried)
        )

    def _run_alone(self, place: Place) -> list[MinuteRun]:
        if place not in self._alone:
            outcome = outcome_of(self._begin(place), self._progress)
            self._faults.add_all(outcome.faults)
            self._alone[place] = outcome.runs[0]
        return self._alone[place]

    def _settle(self, place: Place) -> None:
        """Find out what is true of a minute: its own run, or one that begins further back."""
        runs = self._run_alone(place)
        if place in self._runs:
            return
        robot, number = place
        base = number
        if runs and not runs[0].is_shown:
            while not self._is_base((robot, base)):
                if not base:
                    self._runs[place] = [_left_out(runs[0]), *runs[1:]]
                    return
                base -= 1
        self._runs.setdefault((robot, base), self._run_alone((robot, base)))
        base_runs = self._run_alone((robot, base))
        if self._tried.is_own or not base_runs or base_runs[-1].ends_same:
            return
        if base + 1 < len(self._plans[robot].segments):
            self._go_on((robot, base))

    def _is_base(self, place: Place) -> bool:
        """Report whether the settings tried come to the state in which a minute begins."""
        runs = self._run_alone(place)
        if not runs or runs[0].is_clear:
            return True
        robot, number = place
        before = self._run_alone((robot, number - 1)) if number else []
        return bool(before) and before[-1].ends_same

    def _go_on(self, place: Place) -> None:
        """Run on from a minute at whose end the two are not in the same state, until they are."""
        robot, number = place
        outcome = outcome_of(self._submit(place), self._progress)
        self._faults.add_all(outcome.faults)
        for further, runs in enumerate(outcome.runs[1:], 1):
            self._runs[robot, number + further] = runs

    @property
    def otherwise(self) -> list[OtherwiseMinute]:
        """The minutes that decide otherwise, by robot and time."""
        found = []
        for (robot, number), runs in sorted(self._runs.items()):
            one = self._plans[robot]
            for run in runs:
                if run.first is not None:
                    at_ns = run.first.time_ns
                    logs = [log.path.name for log in one.logs if log.start_ns <= at_ns <= log.end_ns]
                    found.append(OtherwiseMinute(one.robot, self._novelty[robot, number].rarest, logs, run))
        return found

    @property
    def summary(self) -> RegressSummary:
        """The sum over all minutes, as far as they have been run."""
        runs = [run for found in self._runs.values() for run in found]
        not_run: Counter[str] = Counter()
        for run in runs:
            ran_ns = run.end_ns - run.start_ns if run.start_ns else 0
            if not run.start_ns:
                not_run[run.result.detail] += run.recorded_ns
            elif run.recorded_ns - ran_ns > SMALL_NS:
                not_run[BEFORE_PLACE] += run.recorded_ns - ran_ns
        not_run[NOT_IN_ITS_TURN] = (len(self._places) - len(self._runs)) * MINUTE_NS
        otherwise = [run for run in runs if run.first is not None]
        return RegressSummary(
            run=sum(run.start_ns > 0 for run in runs),
            otherwise=len(otherwise),
            other_rules=sum(run.result.rules != COMMAND_RULES for run in otherwise),
            not_run={
                reason: round(length_ns / MINUTE_NS, 1) for reason, length_ns in not_run.items() if length_ns
            },
        )


def _left_out(run: MinuteRun) -> MinuteRun:
    result = msgspec.structs.replace(run.result, detail=UNCERTAIN)
    return msgspec.structs.replace(run, result=result, first=None, start_ns=0, end_ns=0)
