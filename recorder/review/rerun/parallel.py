"""Logs run again by several processes: robot beside robot, and of each one segment beside another.

The answer is the same as one process gives. Where the segments of a robot do not fit together, it is run again in
one piece.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future
from typing import Final

import msgspec

from recorder.reading.configurations import Configurations, configurations_of
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress, Selection, read_rows
from recorder.reading.survey import survey
from recorder.review.rerun.comparison import DIFFERENCES_TOLD
from recorder.review.rerun.player import BROKEN_OFF, RerunPlayer, RerunResult, installed, rerun_logs, rerun_parts
from recorder.review.rerun.segments import WHOLE, Places, Plan, RunSegment, plan
from recorder.review.rerun.tapes import JOURNAL
from recorder.review.tasks import look, outcome_of, processes

SEGMENT_NS: Final = 120_000_000_000
"""A segment is at least so long: the seconds before and behind it are run twice."""

SEGMENTS_PER_JOB: Final = 8
"""Enough that no process waits long for the last one."""


class RerunTask(msgspec.Struct, frozen=True):
    """The unit of work of one process."""

    robot: str
    logs: list[LogFile]
    configurations: Configurations
    segment: RunSegment


class RerunOutcome(msgspec.Struct, frozen=True):
    """The result of a task."""

    results: list[RerunResult]
    faults: Faults


def rerun_in_parallel(
    logs: Sequence[LogFile],
    faults: Faults,
    jobs: int,
    *,
    segment_ns: int = SEGMENT_NS,
    progress: Progress = lambda _: None,
) -> Iterator[RerunResult]:
    """Every run of every robot, run again by what is installed, with the settings it had.

    The processes are begun anew: a script that calls this has to be importable without doing so again.

    Args:
        logs: in the order of their beginnings.
        faults: takes what cannot be read.
        jobs: so many processes run at once.
        segment_ns: the least length of a segment.
        progress: receives numbers of bytes, as they are done.

    Raises:
        CommandError: no gateway is installed, or a process was killed.
    """
    found = survey(logs, faults)
    span_ns = max(log.end_ns for log in logs) - min((log.start_ns for log in logs if log.end_ns), default=0)
    if jobs < 2 or (len(found.robots) < 2 and span_ns < 2 * segment_ns):
        yield from rerun_logs(logs, faults, progress=progress)
        return
    with processes(jobs) as pool:
        length_ns = max(segment_ns, span_ns // (jobs * SEGMENTS_PER_JOB))
        yield from rerun_in(pool, logs, faults, length_ns, progress)


def rerun_in(
    pool: Executor, logs: Sequence[LogFile], faults: Faults, length_ns: int, progress: Progress = lambda _: None
) -> Iterator[RerunResult]:
    """The same in processes that are there; a segment is at least so long."""
    found = survey(logs, faults)
    size = sum(log.bytes for log in logs)
    places: Places = installed("places")
    begun: list[tuple[RerunTask, Plan, list[Future[RerunOutcome]]]] = []
    # All are begun before the first is waited for.
    for robot in found.robots:
        whole = RerunTask(robot, list(logs), configurations_of(robot, logs, found, faults), WHOLE)
        selection = _journals_of(robot)
        planned = plan(read_rows(logs, selection, faults, lambda _: progress(0)), places, length_ns, faults)
        tasks = [msgspec.structs.replace(whole, segment=segment) for segment in planned.segments]
        begun.append((whole, planned, [pool.submit(run_task, task) for task in tasks]))
    for whole, planned, futures in begun:
        outcomes = []
        for future in futures:
            outcomes.append(outcome_of(future, progress))
            progress(size // len(futures))
        results = join(planned, [outcome.results for outcome in outcomes])
        if results is None:
            outcomes = [outcome_of(pool.submit(run_task, whole), progress)]
            results = outcomes[0].results
        for outcome in outcomes:
            faults.add_all(outcome.faults)
        yield from results


def _journals_of(robot: str) -> Selection:
    return Selection(lambda topic: topic.robot == robot and topic.subject == JOURNAL)


def join(planned: Plan, found: Sequence[Sequence[RerunResult]]) -> list[RerunResult] | None:
    """Join the results of the segments; None if they do not fit together.

    Args:
        planned: the segments, and the parts of runs that must come of them.
        found: the results of each segment.
    """
    whole: list[RerunResult] = []
    cut: set[int] = set()
    for segment, results in zip(planned.segments, found, strict=True):
        if segment.from_ns:
            if not (whole and results and _reaches(whole[-1], results[0], segment.from_ns)):
                return None
            whole[-1] = _joined(whole[-1], results[0])
            cut.add(len(whole) - 1)
        whole += results[1:] if segment.from_ns else results
    if not cut:
        return whole
    if [(one.run, one.first) for one in whole] != [(part.run, part.first) for part in planned.parts]:
        return None
    return [
        msgspec.structs.replace(one, inputs=part.inputs, detail=part.detail) if place in cut else one
        for place, (one, part) in enumerate(zip(whole, planned.parts, strict=True))
    ]


def _reaches(before: RerunResult, behind: RerunResult, cut_ns: int) -> bool:
    """Report whether both are of the same run, and one goes on to the cut from which on the other is compared."""
    return (
        before.run == behind.run
        and BROKEN_OFF not in before.detail + behind.detail
        and before.end_ns >= cut_ns >= behind.start_ns > 0
    )


def _joined(before: RerunResult, behind: RerunResult) -> RerunResult:
    return msgspec.structs.replace(
        before,
        end_ns=behind.end_ns,
        same=dict(Counter(before.same) + Counter(behind.same)),
        unrecorded=dict(Counter(before.unrecorded) + Counter(behind.unrecorded)),
        difference_count=before.difference_count + behind.difference_count,
        differences=(before.differences + behind.differences)[:DIFFERENCES_TOLD],
        given_up=before.given_up + behind.given_up,
    )


def run_task(task: RerunTask) -> RerunOutcome:
    """A segment of a robot's time, run again in this process."""
    faults = Faults()
    player = RerunPlayer(task.robot, task.logs, task.configurations, faults, look, task.segment)
    return RerunOutcome(list(rerun_parts(player)), faults)
