"""Every minute of a log run again, each alone. A minute has two seconds and a half here."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway import checkpoint as checkpoint_module
from gateway import core as core_module
from gateway.rerun import run_pair as pair_module
from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.review.rerun import regress as module
from recorder.review.rerun import segments as segments_module
from recorder.review.rerun.minutes import UNCERTAIN
from recorder.review.rerun.player import NO_PLACE
from recorder.review.rerun.regress import NOT_IN_ITS_TURN, Regress
from recorder.review.rerun.segments import RunSegment
from recorder.review.rerun.tried_settings import TriedSettings
from recorder.review.tasks import InThisProcess
from schemas import codec
from schemas.decisions import Decision
from schemas.messages import Variant
from schemas.subjects import BY_NAME
from tests.support.messages import SECOND
from tests.support.rigs.day import COMMAND
from tests.support.rigs.gateway import Operator
from tests.support.rigs.recorded import RecordedRig

PERIOD_NS = 5 * SECOND // 2
OWN = TriedSettings(None, "", {})
NAME = "cruiser-1-20260102T030405Z.mcap"


@pytest.fixture(autouse=True)
def short_minutes(monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes a minute in a robot takes three seconds."""
    monkeypatch.setattr(module, "SHORTEST_NS", PERIOD_NS - SECOND // 10)
    monkeypatch.setattr(segments_module, "BEFORE_NS", SECOND)
    monkeypatch.setattr(pair_module, "ALIKE_NS", SECOND)


@cache
def driven() -> RecordedRig:
    """Thirteen seconds without a pause: slow, fast for two and a half, slow, a stop by a short deadman, slow."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core_module, "CHECKPOINT_PERIOD_NS", PERIOD_NS)
        rig = RecordedRig(Variant.COARSE, COMMAND)
        rig.run(0.6)
        operator = Operator(rig)
        operator.engage()
        operator.drive(0.5, 2.0, 3.5)
        operator.drive(1.2, 2.0, 2.5)
        operator.drive(0.5, 2.0, 2.7)
        rig.run(0.2)
        operator.drive(0.5, 2.0, 3.7)
    return rig


@cache
def driven_log() -> bytes:
    """The log of that."""
    return driven().log()


def decisions(rig: RecordedRig) -> Iterator[Decision]:
    """All of the arbiter's."""
    for _, sample in rig.recorded:
        if sample.subject == "safety/decision":
            message = codec.decode(BY_NAME[sample.subject], sample.payload)
            assert isinstance(message, Decision)
            yield message


def regress(path: Path, data: bytes, tried: TriedSettings = OWN, most: int | None = None) -> Regress:
    """All minutes of a log, or the most novel ones."""
    path.write_bytes(data)
    faults = Faults()
    found = Regress(find_logs([path], faults), tried, faults, InThisProcess(), 1)
    found.run(most)
    assert not faults, faults.told
    return found


def speed_limit(mps: float) -> TriedSettings:
    """Another speed limit."""
    return TriedSettings(None, "", {"command.speed_limit_mps": mps})


def test_the_runs_own_settings_and_code_decide_the_same(tmp_path: Path) -> None:
    """In every minute, also when the same settings are given as others."""
    own = regress(tmp_path / NAME, driven_log()).summary
    assert (own.otherwise, own.not_run) == (0, {})
    assert own.run >= 5
    assert regress(tmp_path / NAME, driven_log(), speed_limit(COMMAND.speed_limit_mps)).summary == own


@settings(max_examples=settings().max_examples // 5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(limit_mps=st.floats(0.55, 1.3))
def test_a_changed_limit_is_found_in_the_minutes_in_which_it_was_reached(
    tmp_path_factory: pytest.TempPathFactory, limit_mps: float
) -> None:
    """In all of these and in no other, by what was asked and what was told the chassis."""
    found = regress(tmp_path_factory.mktemp("logs") / NAME, driven_log(), speed_limit(limit_mps))
    [plan] = found._plans
    reached = {
        number
        for decision in decisions(driven())
        for number, segment in enumerate(plan.segments)
        if segment.holds(decision.time_ns)
        and max(abs(decision.requested_speed_mps or 0.0), abs(decision.output_speed_mps)) > limit_mps
    }
    assert {
        number for number, segment in enumerate(plan.segments) for one in found.otherwise if _lies(one, segment)
    } == (reached)
    assert len(found.otherwise) == len(reached)
    assert found.summary.not_run == {}
    assert all("speed" in one.run.first.after for one in found.otherwise if one.run.first and not one.run.goes_on)


def _lies(one: module.OtherwiseMinute, segment: RunSegment) -> bool:
    return one.run.first is not None and segment.holds(one.run.first.time_ns)


def test_a_stop_that_would_have_been_is_told_with_its_reason(tmp_path: Path) -> None:
    """And the minutes behind it are run on from there, for the robot would not have driven in them."""
    found = regress(tmp_path / NAME, driven_log(), TriedSettings(None, "", {"command.deadman_s": 0.1}))
    first, *others = found.otherwise
    assert first.run.first is not None
    assert not first.run.goes_on
    assert [stop.reason for stop in first.run.result.stops_added] == ["deadman"]  # type: ignore[union-attr]
    assert others
    assert all(one.run.goes_on for one in others)


def test_what_begins_in_mid_drive_is_left_out_where_other_settings_differ_at_once(
    tmp_path: Path,
) -> None:
    """Nothing of what was before is in the log, so nothing is claimed; what the settings do not touch is run."""
    begin_ns = next(one.time_ns for one in decisions(driven()) if abs(one.output_speed_mps) > 1.1)
    late = _from(begin_ns)
    found = regress(tmp_path / NAME, late, speed_limit(0.4))
    assert found.otherwise == []
    assert found.summary.run == 0
    assert UNCERTAIN in found.summary.not_run
    touched = regress(tmp_path / NAME, late, speed_limit(1.3))
    assert touched.otherwise == []
    assert touched.summary.run > 2


def test_checkpoints_of_another_version_are_counted_as_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the reason."""
    monkeypatch.setattr(checkpoint_module, "CLASSES", {})
    summary = regress(tmp_path / NAME, _from(driven().wall_ns - 6 * SECOND)).summary
    assert summary.run == 0
    assert any(NO_PLACE in reason for reason in summary.not_run)
    assert sum(summary.not_run.values()) == pytest.approx(0.1, abs=0.05)


def _from(time_ns: int) -> bytes:
    """The log from a time on."""
    rig, whole = driven(), driven().recorded
    later_ns = rig.recorder_ns - rig.wall_ns + rig.now_ns
    try:
        rig.recorded = [one for one in whole if one[0] >= time_ns + later_ns]
        return rig.log()
    finally:
        rig.recorded = whole


def test_the_most_novel_alone(tmp_path: Path) -> None:
    """What was not run is not claimed; the rarest thing of the log is in what was."""
    found = regress(tmp_path / NAME, driven_log(), speed_limit(1.0), most=2)
    whole = regress(tmp_path / NAME, driven_log(), speed_limit(1.0))
    assert 2 <= found.summary.run < whole.summary.run
    assert found.summary.not_run[NOT_IN_ITS_TURN] == whole.summary.run - found.summary.run
    told = [one.run.first for one in whole.otherwise]
    assert all(one.run.first in told for one in found.otherwise)


def test_another_decision_in_the_log_is_found_in_its_minute_alone(tmp_path: Path) -> None:
    """Each minute begins with the state of the log, so what differs in one touches no other."""
    rig, whole = driven(), driven().recorded
    place = next(
        number for number, one in enumerate(whole) if one[1].subject == "safety/decision" and number > 9000
    )
    at_ns, sample = whole[place]
    decision = codec.decode(BY_NAME[sample.subject], sample.payload)
    assert isinstance(decision, Decision)
    changed = codec.encode(msgspec.structs.replace(decision, operator="somebody"))
    try:
        rig.recorded = [
            *whole[:place],
            (at_ns, msgspec.structs.replace(sample, payload=changed)),
            *whole[place + 1 :],
        ]
        found = regress(tmp_path / NAME, rig.log())
    finally:
        rig.recorded = whole
    [one] = found.otherwise
    assert one.run.first is not None
    assert one.run.first.what == "safety/decision, changed"
    assert (one.run.first.before, one.run.first.after) == ("operator somebody", "operator first")


def test_a_log_without_a_journal_has_no_minutes(tmp_path: Path) -> None:
    """None is counted."""
    summary = regress(tmp_path / NAME, driven().log(without=("journal",))).summary
    assert (summary.run, summary.not_run) == (0, {})
