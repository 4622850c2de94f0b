"""One minute of a robot, run again alone: the unit of work of ``regress``, and what comes of it.

With the settings of the run a minute is run again from its checkpoint and compared with the log. With others it is
run twice, as it was and as it would have been. It may begin at a checkpoint then as well, but that the other
settings come to that state has to be shown: by the minute before it, at whose end both are in the same state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import msgspec

from recorder.reading.configurations import Configurations, settings_from
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.topics import UNREADABLE
from recorder.review.rerun.comparison import Difference
from recorder.review.rerun.counterfactual import (
    CounterfactualVerdict,
    RunsCompared,
    WhatIfResult,
    changed_settings,
)
from recorder.review.rerun.player import (
    NO_CONFIGURATION,
    RerunPlayer,
    RerunResult,
    SampleAgain,
    installed,
    rerun_parts,
)
from recorder.review.rerun.segments import SETTLED_NS, RunSegment
from recorder.review.rerun.tried_settings import TriedSettings
from recorder.review.tasks import look

TICK_NS: Final = 10_000_000

UNCERTAIN: Final = (
    "it begins at a checkpoint, and nothing before it in the logs shows that the other settings come to that state"
)

COMMANDS: Final = "the commands to the chassis"
"""A thing that differs, beside decisions and events."""

PairRunner = Callable[..., Iterator[None]]
"""The run's settings, the other ones, its journals and a listener: see ``gateway.rerun.run_pair.run_pair``."""

Commanded = tuple[float, float, bool] | None


class FirstDifference(msgspec.Struct, frozen=True):
    """The first thing that differs in a minute.

    Attributes:
        time_ns: nanoseconds since 1970.
        what: a decision, an event, the commands to the chassis, or a subject.
        before, after: as it was recorded, and as it is now or would have been.
    """

    time_ns: int
    what: str
    before: str
    after: str


class MinuteTask(msgspec.Struct, frozen=True):
    """A minute to run, or several of them without a pause.

    Attributes:
        segments: of the robot's time, one behind the other.
        tried: the settings.
    """

    robot: str
    logs: list[LogFile]
    configurations: Configurations
    segments: list[RunSegment]
    tried: TriedSettings


class MinuteRun(msgspec.Struct, frozen=True):
    """A minute that was run, or the part of one run that lies in it. Times are nanoseconds since 1970.

    Attributes:
        result: all that is the same and all that differs.
        first: the first difference; None if there is none.
        start_ns, end_ns: of what was run; 0 if nothing was.
        recorded_ns: so much of it the journals hold.
        is_clear: it begins where every settings begin: at a run's start, or at rest.
        is_shown: nothing more has to be known of what was before: it is clear, or nothing differs.
        ends_same: at the end both are in the same state.
        goes_on: it was run on from the minute before it, which ends in another state.
    """

    result: RerunResult | WhatIfResult
    first: FirstDifference | None
    start_ns: int
    end_ns: int
    recorded_ns: int
    is_clear: bool = True
    is_shown: bool = True
    ends_same: bool = True
    goes_on: bool = False


class MinuteOutcome(msgspec.Struct, frozen=True):
    """The result of a task.

    Attributes:
        runs: of each segment what was run in it, in order of time; fewer segments if both were in the same state
            before the last one.
    """

    runs: list[list[MinuteRun]]
    faults: Faults


def run_minutes(task: MinuteTask) -> MinuteOutcome:
    """Run a task in this process."""
    faults = Faults()
    first, last = task.segments[0], task.segments[-1]
    whole = msgspec.structs.replace(
        first, to_ns=last.to_ns, inputs_to_ns=last.inputs_to_ns, log_to_ns=last.log_to_ns
    )
    if task.tried.is_own:
        player = RerunPlayer(task.robot, task.logs, task.configurations, faults, look, whole)
        return MinuteOutcome([[_compared(result, player, whole) for result in rerun_parts(player)]], faults)
    player = RerunPlayer(task.robot, task.logs, task.configurations, faults, look, whole, compared=())
    return MinuteOutcome(_tried(player, task), faults)


def _compared(result: RerunResult, player: RerunPlayer, segment: RunSegment) -> MinuteRun:
    first = min(result.differences, key=lambda one: one.time_ns, default=None)
    start_ns = max(result.start_ns, segment.from_ns) if result.start_ns else 0
    end_ns = min(result.end_ns, segment.to_ns)
    return MinuteRun(
        result, None if first is None else _described(first), start_ns, end_ns, _recorded_ns(player, segment)
    )


def _recorded_ns(player: RerunPlayer, segment: RunSegment) -> int:
    begin_ns, end_ns = player.recorded_ns
    return max(0, min(end_ns, segment.to_ns) - max(begin_ns, segment.from_ns))


def _described(difference: Difference) -> FirstDifference:
    """The first difference, in words."""
    what = f"{difference.subject}, {difference.what}"
    if difference.what != "changed":
        return FirstDifference(difference.time_ns, what, _short(difference.message), "")
    was = ", ".join(f"{name} {_short(before)}" for name, (before, _) in difference.fields.items())
    now = ", ".join(f"{name} {_short(after)}" for name, (_, after) in difference.fields.items())
    return FirstDifference(difference.time_ns, what, was, now)


def _short(value: Any) -> str:  # noqa: ANN401 - of any field
    text = str(getattr(value, "value", value))
    return text if len(text) <= SHORT else f"{text[: SHORT - 3]}..."


SHORT: Final = 200
"""Characters of a value in a summary; the result has all of it."""


def _tried(player: RerunPlayer, task: MinuteTask) -> list[list[MinuteRun]]:
    run_pair: PairRunner = installed("run_pair")
    found: list[list[MinuteRun]] = [[]]
    while player.next_part():
        text = player.configuration()
        pair = _Minutes(task.segments[len(found) - 1 :])
        changed: dict[str, tuple[object, object]] = {}
        if text is None:
            run = player.skip(NO_CONFIGURATION)
        else:
            settings, other = settings_from(text), task.tried(text)
            changed = changed_settings(settings, other)
            try:
                for _ in run_pair(settings, other, player.journals(), pair):
                    if pair.is_over:
                        player.leave()
                        break
            except UNREADABLE as error:
                player.break_off(error)
            run = player.result(pair.start_ns)
        for number, minute in enumerate(pair.minutes):
            if number:
                found.append([])
            found[-1].append(minute.run(run, changed, _recorded_ns(player, minute.segment)))
        if pair.is_over:
            break
    return found


class _Minute:
    """One minute of both runs."""

    def __init__(self, segment: RunSegment, *, goes_on: bool) -> None:
        self.segment = segment
        self.start_ns = self.end_ns = 0
        self.is_clear = self.is_certain = True
        self.ends_same = False
        self._goes_on = goes_on
        self._begins_alike = True
        self._compared = RunsCompared()
        self._commanded: FirstDifference | None = None

    def tick(self, time_ns: int) -> None:
        if self.segment.holds(time_ns):
            self.start_ns = self.start_ns or time_ns
            self.end_ns = time_ns

    def say(self, samples: Sequence[SampleAgain], *, is_other: bool) -> None:
        for sample in samples:
            self._compared.take(sample, is_other=is_other)

    def command(self, time_ns: int, recorded: Commanded, other: Commanded) -> None:
        if not self.start_ns:
            self._begins_alike = False
        elif self._commanded is None:
            words = commanded_in_words(recorded), commanded_in_words(other)
            self._commanded = FirstDifference(time_ns, COMMANDS, *words)

    def run(self, run: RerunResult, changed: dict[str, tuple[object, object]], recorded_ns: int) -> MinuteRun:
        first = min(self._differences(), key=lambda one: one.time_ns, default=None)
        return MinuteRun(
            self._compared.result(run, changed),
            first,
            self.start_ns,
            self.end_ns,
            recorded_ns,
            self.is_clear,
            self.is_clear or (self.is_certain and self._begins_alike and first is None),
            self.ends_same,
            self._goes_on,
        )

    def _differences(self) -> Iterator[FirstDifference]:
        for change in self._compared.changes.values():
            what = f"{change.request} of {change.operator}"
            yield FirstDifference(
                change.first_ns, what, verdict_in_words(change.recorded), verdict_in_words(change.other)
            )
        event = self._compared.first_event()
        if event is not None:
            what = f"event {event.kind}, {event.reason}"
            yield FirstDifference(event.time_ns, what, f"{event.recorded} x", f"{event.other} x")
        if self._commanded is not None:
            yield self._commanded


def verdict_in_words(verdict: CounterfactualVerdict) -> str:
    """A verdict with its reason and the limits that bound the command."""
    text = verdict.verdict if verdict.reason == "none" else f"{verdict.verdict} ({verdict.reason})"
    return f"{text}, bound by {' and '.join(verdict.bound_by)}" if verdict.bound_by else text


def commanded_in_words(told: Commanded) -> str:
    """The speed, the angle and the parking brake that the chassis is told."""
    if told is None:
        return "nothing is sent"
    speed_mps, angle_deg, parking = told
    return f"{speed_mps:.3f} m/s, {angle_deg:.2f} deg, parking brake {'on' if parking else 'off'}"


class _Minutes:
    """Both runs minute by minute; a ``PairListener`` of the gateway.

    Attributes:
        minutes: those that have begun.
        start_ns: the first tick that was run, since 1970; 0 before.
        is_over: both are in the same state at the end of a minute, or the last one has ended.
    """

    def __init__(self, segments: Sequence[RunSegment]) -> None:
        self.minutes = [_Minute(segments[0], goes_on=False)]
        self.start_ns = 0
        self.is_over = False
        self._following = list(segments[1:])
        self._time_ns = 0

    def begin(self, *, is_clear: bool, is_certain: bool) -> None:
        self.minutes[0].is_clear, self.minutes[0].is_certain = is_clear, is_certain

    def tick(self, time_ns: int) -> None:
        self._time_ns = time_ns
        self.start_ns = self.start_ns or time_ns
        minute = self.minutes[-1]
        if time_ns >= minute.segment.to_ns:
            if minute.ends_same or not self._following:
                self.is_over = True
                return
            self.minutes.append(minute := _Minute(self._following.pop(0), goes_on=True))
        minute.tick(time_ns)

    def say(self, recorded: Sequence[SampleAgain], other: Sequence[SampleAgain]) -> None:
        minute = self.minutes[-1]
        if minute.segment.holds(self._time_ns) and not self.is_over:
            minute.say(recorded, is_other=False)
            minute.say(other, is_other=True)

    def command(self, recorded: Commanded, other: Commanded) -> None:
        if not self.is_over:
            self.minutes[-1].command(self._time_ns, recorded, other)

    def compare(self, *, are_same: bool) -> None:
        minute = self.minutes[-1]
        if self._time_ns >= minute.segment.to_ns - SETTLED_NS - TICK_NS:
            # The next minute begins here.
            minute.ends_same = minute.ends_same or are_same
