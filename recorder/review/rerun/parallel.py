"""Logs run again, one task a log: in this process, in several, or on the machines of a cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import msgspec

from recorder.reading.configurations import Configurations, configurations_of
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile, logs_of
from recorder.reading.rows import Progress
from recorder.reading.survey import survey
from recorder.review.rerun.counterfactual import WhatIfResult, what_if_parts
from recorder.review.rerun.player import RerunPlayer, RerunResult, rerun_parts
from recorder.review.rerun.tried_settings import TriedSettings

FOLLOWS_NS: Final = 600_000_000_000
"""Files of a robot that lie no further apart are one log. A gateway keeps its journal for some ten minutes, and a
recorder that comes back asks for it: a run goes on over such a gap."""


class RerunTask(msgspec.Struct, frozen=True):
    """A log of a robot.

    Attributes:
        logs: its files, in the order of their beginnings.
        configurations: those of its runs.
        tried: the settings to run it with.
    """

    robot: str
    logs: list[LogFile]
    configurations: Configurations
    tried: TriedSettings

    @property
    def bytes(self) -> int:
        """The length of all files."""
        return sum(log.bytes for log in self.logs)


class RerunOutcome(msgspec.Struct, frozen=True):
    """The result of a task: one for each run of a gateway, or for each part of one between gaps."""

    results: list[RerunResult | WhatIfResult]
    faults: Faults


def rerun_tasks(logs: Sequence[LogFile], tried: TriedSettings, faults: Faults) -> list[RerunTask]:
    """The logs of all robots, by robot and time.

    Args:
        logs: the files, in the order of their beginnings.
        tried: the settings to run them with.
        faults: takes what cannot be read.
    """
    found = survey(logs, faults)
    tasks = []
    for robot in found.robots:
        files = logs_of(robot, logs)
        # A recorder writes a configuration when it is new to it, maybe in a log before.
        configurations = configurations_of(robot, files, found, faults)
        tasks += [RerunTask(robot, log, configurations, tried) for log in _joined(files)]
    return tasks


def _joined(files: Iterable[LogFile]) -> Iterator[list[LogFile]]:
    """Yield files that follow each other together."""
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
    """Run a log again, with the settings of its runs or with others."""
    faults = Faults()
    player = RerunPlayer(task.robot, task.logs, task.configurations, faults, progress)
    parts = rerun_parts(player) if task.tried.is_own else what_if_parts(player, task.tried)
    return RerunOutcome(list(parts), faults)
