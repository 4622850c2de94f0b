"""Logs as they would have been with other settings, each a task."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.reading.logs import Faults, find_logs
from recorder.reading.survey import settings_from
from recorder.review.rerun import RerunPlayer, RerunResult
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
    what_if_parts,
)
from schemas.messages import Variant
from schemas.settings import Settings
from tests.support.messages import SECOND
from tests.support.rigs.day import Day
from tests.support.rigs.gateway import Operator
from tests.support.rigs.recorded import RecordedRig


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three seconds with 1.2 m/s, a pause of 200 ms in the commands, and a stop."""
    day = Day(1, Variant.COARSE, ticks=0)
    day.rig.run(0.6)
    operator = Operator(day.rig)
    operator.engage()
    operator.drive(1.2, 0.0, 3.0)
    day.rig.run(0.2)
    operator.drive(1.2, 0.0, 1.0)
    operator.ask("disengage")
    day.rig.run(4)
    path = tmp_path_factory.mktemp("logs") / "cruiser-1-20260102T030405Z.mcap"
    path.write_bytes(day.rig.log())
    return path


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Path:
    day = Day(1, Variant.COARSE, ticks=0)
    day.rig.run(0.6)
    operator = Operator(day.rig)
    operator.engage()
    operator.drive(1.0, 0.0, 1.0)
    day.rig.run(6)
    path = tmp_path_factory.mktemp("logs") / "log.mcap"
    path.write_bytes(day.rig.log())
    return path


def run_of(log: Path, settings_of: Callable[[str], Settings]) -> WhatIfResult:
    faults = Faults()
    [task] = rerun_tasks(find_logs([log], faults), TriedSettings(None, "", {}), faults)
    player = RerunPlayer(task.robot, task.logs, task.configurations, faults, lambda _: None)
    [result] = what_if_parts(player, settings_of)
    assert not faults
    return result


@pytest.mark.parametrize(
    ("name", "command", "stops", "top_mps", "verdicts"),
    [
        ("log", {}, ([], [], []), 1.2, set()),
        # What was asked is bound by the limit in nearly every decision.
        ("log", {"speed_limit_mps": 0.4}, ([], [], []), 0.4, {"accepted"}),
        # By the pause that the recorded run bore.
        ("log", {"deadman_s": 0.1}, (["disengaged"], ["deadman"], []), 1.2, {"refused"}),
        # The same stop, a quarter of a second later; the decisions are the same.
        ("left", {"deadman_s": 0.5}, ([], [], [("deadman", 0.25)]), 0.92, set()),
    ],
)
def test_what_other_settings_change(
    request: pytest.FixtureRequest,
    name: str,
    command: dict[str, Any],
    stops: tuple[list[str], list[str], list[tuple[str, float]]],
    top_mps: float,
    verdicts: set[str],
) -> None:
    """Stops avoided, added and moved, the way, and the decisions; and nothing with the settings of the run."""

    def settings_of(text: str) -> Settings:
        settings = settings_from(text)
        return msgspec.structs.replace(settings, command=msgspec.structs.replace(settings.command, **command))

    result = run_of(request.getfixturevalue(name), settings_of)
    assert {name: tried for name, (_, tried) in result.settings.items()} == {
        f"command.{name}": value for name, value in command.items()
    }
    avoided, added = ([one.reason for one in found] for found in (result.stops_avoided, result.stops_added))
    moved = [(one.stop.reason, round((one.other_ns - one.stop.time_ns) / 1e9, 2)) for one in result.stops_moved]
    assert (avoided, added, moved) == stops
    assert result.other.top_speed_mps == pytest.approx(top_mps, abs=0.05)
    assert {change.other.verdict for change in result.changes} == verdicts
    if not command:
        assert result.recorded == result.other
        assert result.decisions > 150
        # 1.2 m/s for four seconds, with the time that 0.8 m/s2 and the pause take.
        assert 3.0 < result.recorded.distance_m < 5.0
        assert [stop.reason for stop in result.recorded.stops] == ["disengaged"]
    elif "speed_limit_mps" in command:
        assert result.other.distance_m < result.recorded.distance_m / 2
        bound = sum(change.count for change in result.changes if "speed" in change.other.bound_by)
        assert bound > 0.8 * sum(change.count for change in result.changes)


STOPS = st.builds(
    StopMade,
    st.integers(0, 20).map(lambda seconds: seconds * SECOND),
    st.sampled_from(["deadman", "remote_stop"]),
    st.just(""),
    st.just(""),
)


@given(st.lists(STOPS, max_size=8), st.lists(STOPS, max_size=8))
def test_each_stop_has_one_counterpart_at_most(stops: list[StopMade], others: list[StopMade]) -> None:
    """Of the same reason, near in time; what is left on either side is the same number as what differs."""
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
    """By robot and time, with the settings of the runs and with others; task and outcome go to another process."""
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
