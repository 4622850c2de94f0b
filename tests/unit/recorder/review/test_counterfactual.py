"""Logs as they would have been."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.rerun import GivenOutput, what_if
from recorder.reading.logs import Faults, find_logs
from recorder.reading.survey import settings_from
from recorder.review.rerun import RerunPlayer
from recorder.review.what_if import (
    STOP_TOLERANCE_NS,
    StopMade,
    StopsCompared,
    TriedSettings,
    WhatIf,
    WhatIfResult,
    compared,
    rerun_tasks,
    what_if_parts,
)
from schemas.codec import Sample, encode
from schemas.decisions import EventKind, Journal, SafetyEvent, Severity, Verdict
from schemas.messages import Message, Variant
from schemas.reasons import Reason
from schemas.settings import Settings
from schemas.subjects import BY_TYPE
from tests.support.messages import PERIOD_NS, SECOND, WALL_NS, refusal, state
from tests.support.rigs.day import Day
from tests.support.rigs.gateway import Operator


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three seconds with 1.2 m/s, a pause of 200 ms in the commands, and a stop."""
    day = Day(1, Variant.COARSE, ticks=0)
    rig = day.rig
    rig.run(0.6)
    operator = Operator(rig)
    operator.engage()
    operator.drive(1.2, 0.0, 3.0)
    rig.run(0.2)
    operator.drive(1.2, 0.0, 1.0)
    operator.ask("disengage")
    rig.run(4)
    path = tmp_path_factory.mktemp("logs") / "cruiser-1-20260102T030405Z.mcap"
    path.write_bytes(day.rig.log())
    return path


def run_of(log: Path, settings_of: Callable[[str], Settings], run_both: WhatIf = what_if) -> WhatIfResult:
    """What comes of the one run in a log."""
    faults = Faults()
    [task] = rerun_tasks(find_logs([log], faults), TriedSettings(None, "", {}), faults)
    player = RerunPlayer(task.robot, task.logs, task.configurations, faults, lambda _: None)
    [result] = what_if_parts(player, settings_of, run_both)
    assert not faults
    return result


def tried(log: Path, **command: object) -> WhatIfResult:
    """The log with other settings of the command flow."""

    def settings_of(text: str) -> Settings:
        settings = settings_from(text)
        return msgspec.structs.replace(settings, command=msgspec.structs.replace(settings.command, **command))

    return run_of(log, settings_of)


def test_nothing_changes_with_the_same_settings(log: Path) -> None:
    """And the way is the one that was driven."""
    result = tried(log)
    assert (result.settings, result.changes, result.stops_added, result.stops_avoided) == ({}, [], [], [])
    assert result.recorded == result.other
    assert result.decisions > 150
    # 1.2 m/s for four seconds, with the time that 0.8 m/s2 and the pause take.
    assert 3.0 < result.recorded.distance_m < 5.0
    assert result.recorded.top_speed_mps == pytest.approx(1.2, abs=0.05)
    assert [stop.reason for stop in result.recorded.stops] == ["disengaged"]


def test_a_lower_limit_shortens_the_way(log: Path) -> None:
    """What was asked is bound by the limit in nearly every decision."""
    result = tried(log, speed_limit_mps=0.4)
    assert result.settings == {"command.speed_limit_mps": (1.5, 0.4)}
    assert result.other.top_speed_mps == pytest.approx(0.4, abs=0.05)
    assert result.other.distance_m < result.recorded.distance_m / 2
    assert result.stops_added == []
    bound = sum(change.count for change in result.changes if "speed" in change.other.bound_by)
    assert bound > 0.8 * sum(change.count for change in result.changes)


def test_a_shorter_deadman_adds_a_stop_and_avoids_the_later_one(log: Path) -> None:
    """By the pause that the recorded run bore."""
    result = tried(log, deadman_s=0.1)
    assert [stop.reason for stop in result.stops_added] == ["deadman"]
    assert [stop.reason for stop in result.stops_avoided] == ["disengaged"]
    assert result.other.distance_m < result.recorded.distance_m
    assert {change.other.verdict for change in result.changes} == {"refused"}


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


def test_a_longer_deadman_stops_later(tmp_path: Path) -> None:
    """The same stop, a quarter of a second later; the decisions are the same."""
    day = Day(1, Variant.COARSE, ticks=0)
    day.rig.run(0.6)
    operator = Operator(day.rig)
    operator.engage()
    operator.drive(1.0, 0.0, 1.0)
    day.rig.run(6)
    path = tmp_path / "log.mcap"
    path.write_bytes(day.rig.log())
    result = tried(path, deadman_s=0.5)
    assert (result.stops_added, result.stops_avoided, result.changes) == ([], [], [])
    assert [
        (one.stop.reason, round((one.other_ns - one.stop.time_ns) / 1e9, 2)) for one in result.stops_moved
    ] == [("deadman", 0.25)]


def both(messages: Callable[[bool], list[Message]]) -> Callable[..., Iterator[GivenOutput]]:
    """Two runs that say these."""

    def run(_settings: Settings, _other: Settings, journals: Iterable[Journal]) -> Iterator[GivenOutput]:
        for _ in journals:
            pass
        for is_other in (False, True):
            for message in messages(is_other):
                yield GivenOutput(Sample(BY_TYPE[type(message)].name, encode(message)), is_other)

    return run


def result_of(log: Path, messages: Callable[[bool], list[Message]]) -> WhatIfResult:
    """What is made of two runs that say these."""
    return run_of(log, settings_from, both(messages))


def test_decisions_are_paired_by_their_place_and_counted_by_kind(log: Path) -> None:
    """However far one run is ahead."""

    def messages(is_other: bool) -> list[Message]:  # noqa: FBT001 - the two runs
        return [
            refusal(number, verdict=Verdict.REFUSED if is_other and number % 2 else Verdict.ACCEPTED)
            for number in range(10)
        ]

    result = result_of(log, messages)
    [change] = result.changes
    assert (result.decisions, change.count, change.first_ns, change.last_ns) == (
        10,
        5,
        WALL_NS + PERIOD_NS,
        WALL_NS + 9 * PERIOD_NS,
    )
    assert (change.recorded.verdict, change.other.verdict) == ("accepted", "refused")


def test_over_a_gap_nothing_is_known_of_the_way(log: Path) -> None:
    """Neither distance nor time is made up."""

    def messages(is_other: bool) -> list[Message]:  # noqa: FBT001 - the two runs
        return [state(0), state(1), state(1201 if is_other else 2, speed_mps=None), state(1800)]

    result = result_of(log, messages)
    assert result.recorded.distance_m == result.other.distance_m == pytest.approx(0.05)
    assert result.recorded.moving_s == pytest.approx(0.05)


def test_only_stops_count_as_stops(log: Path) -> None:
    """Not every event is one."""

    def messages(is_other: bool) -> list[Message]:  # noqa: FBT001 - the two runs
        kinds = [EventKind.STOP, EventKind.LEASE, EventKind.STOPPED]
        return [
            SafetyEvent(n, n, 1, Severity.WARNING, kind, Reason.DEADMAN, operator="", text="")
            for n, kind in enumerate(kinds[is_other:])
        ]

    result = result_of(log, messages)
    assert len(result.stops_avoided) == 1
    assert result.stops_added == []
