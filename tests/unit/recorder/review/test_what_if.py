"""Logs rerun with other settings, each a task."""

import pickle
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from recorder.reading.logs import Faults, find_logs
from recorder.review.rerun import RerunResult
from recorder.review.tasks import HERE
from recorder.review.what_if import (
    STOP_TOLERANCE_NS,
    StopMade,
    StopsCompared,
    TriedSettings,
    WhatIfResult,
    compared,
    rerun_tasks,
    run_task,
)
from tests.support.messages import SECOND
from tests.support.rigs.recorded import RecordedRig

STOPS = st.builds(
    StopMade,
    st.integers(0, 20).map(lambda seconds: seconds * SECOND),
    st.sampled_from(["deadman", "remote_stop"]),
    st.just(""),
    st.just(""),
)


@given(st.lists(STOPS, max_size=8), st.lists(STOPS, max_size=8))
def test_each_stop_has_one_counterpart_at_most(stops: list[StopMade], others: list[StopMade]) -> None:
    found = compared(stops, others)
    assert compared(stops, stops) == StopsCompared([], [], [])
    assert len(stops) - len(found.avoided) == len(others) - len(found.added)
    for stop in found.avoided:
        same = [one for one in found.added if one.reason == stop.reason]
        assert all(abs(one.time_ns - stop.time_ns) > STOP_TOLERANCE_NS for one in same)
    assert all(0 < abs(one.other_ns - one.stop.time_ns) <= STOP_TOLERANCE_NS for one in found.moved)


# The tasks.

OWN = TriedSettings(None, "", {})
SLOW = TriedSettings(None, "", {"command.speed_limit_mps": "0.3"})


def test_a_task_gives_what_its_log_holds(tmp_path: Path) -> None:
    for name, robot in (("a", "cruiser-1"), ("b", "cruiser-2")):
        rig, _ = RecordedRig.driving(0.6)
        rig.rest_after(0.5)
        (tmp_path / f"{name}.mcap").write_bytes(rig.log(robot=robot))
    logs = find_logs([tmp_path], Faults())
    found: dict[bool, list[RerunResult | WhatIfResult]] = {}
    for tried in (OWN, SLOW):
        tasks = pickle.loads(pickle.dumps(rerun_tasks(logs, tried, Faults())))  # noqa: S301 - our own
        assert [task.bytes for task in tasks] == [log.bytes for log in logs]
        outcomes = pickle.loads(pickle.dumps(list(HERE(run_task, tasks, lambda _: None))))  # noqa: S301 - our own
        found[tried.is_own] = [result for outcome in outcomes for result in outcome.results]
    for is_own, results in found.items():
        assert [result.robot for result in results] == ["cruiser-1", "cruiser-2"]
        assert [result.differs_ns is None for result in results] == [is_own, is_own]
