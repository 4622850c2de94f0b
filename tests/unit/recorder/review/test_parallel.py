"""Logs run again, each a task."""

import pickle
from pathlib import Path

import pytest

from recorder.reading.logs import Faults, LogFile, find_logs
from recorder.review import what_if
from recorder.review.rerun import RerunResult
from recorder.review.tasks import HERE
from recorder.review.what_if import FOLLOWS_NS, RerunOutcome, TriedSettings, WhatIfResult, rerun_tasks, run_task
from tests.support.messages import SECOND
from tests.support.rigs.recorded import RecordedRig

OWN = TriedSettings(None, "", {})
SLOW = TriedSettings(None, "", {"command.speed_limit_mps": "0.3"})


def drive(path: Path, at_s: int, robot: str = "cruiser-1") -> Path:
    """The log of a short drive, some seconds after the first."""
    rig, _ = RecordedRig.driving(0.6, run=7 + at_s)
    rig.wall_ns += at_s * SECOND
    rig.rest_after(0.5)
    path.write_bytes(rig.log(robot=robot))
    return path


def results(logs: list[LogFile], tried: TriedSettings) -> list[RerunResult | WhatIfResult]:
    """What all tasks give, as it comes from another process."""
    outcomes = HERE(run_task, rerun_tasks(logs, tried, Faults()), lambda _: None)
    return [result for outcome in outcomes for result in _sent(outcome).results]


def _sent(outcome: RerunOutcome) -> RerunOutcome:
    sent = pickle.loads(pickle.dumps(outcome))  # noqa: S301 - our own
    assert isinstance(sent, RerunOutcome)
    return sent


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[LogFile]:
    """Of two robots, one of which begins twice."""
    directory = tmp_path_factory.mktemp("logs")
    paths = [drive(directory / "a.mcap", 0), drive(directory / "b.mcap", 0, "cruiser-2")]
    return find_logs(paths, Faults())


def test_a_task_gives_what_its_log_holds(logs: list[LogFile]) -> None:
    """By robot and time, with the settings of the runs and with others; as it comes from another process."""
    own, slow = results(logs, OWN), results(logs, SLOW)
    assert [result.robot for result in own] == [result.robot for result in slow] == ["cruiser-1", "cruiser-2"]
    assert [result.differs_ns is None for result in own] == [True, True]
    assert None not in [result.differs_ns for result in slow]


def test_a_task_goes_to_another_process(logs: list[LogFile]) -> None:
    """Whole."""
    tasks = rerun_tasks(logs, SLOW, Faults())
    assert pickle.loads(pickle.dumps(tasks)) == tasks  # noqa: S301 - our own
    assert [task.bytes for task in tasks] == [log.bytes for log in logs]


@pytest.mark.parametrize(("apart_ns", "count"), [(FOLLOWS_NS, 1), (FOLLOWS_NS + 1, 2)])
def test_files_that_follow_each_other_are_one_log(apart_ns: int, count: int) -> None:
    """A run goes on over what a recorder asks the gateway for later, and not over more."""
    first = LogFile(Path("a"), 1, 5, 5000, frozenset({("fleet", "cruiser-1")}))
    inside = LogFile(Path("b"), 1, 10, 20, frozenset({("fleet", "cruiser-1")}))
    behind = LogFile(Path("c"), 1, 5000 + apart_ns, 2 * FOLLOWS_NS + 5000, frozenset({("fleet", "cruiser-1")}))
    assert len(list(what_if._joined([first, inside, behind]))) == count
