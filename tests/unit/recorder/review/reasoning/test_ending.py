"""How the runs of a robot's gateways ended."""

from pathlib import Path

from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.review.reasoning.ending import RunEnding, ending
from schemas.decisions import ArbiterState
from tests.support.recorder_fakes import MS, SECOND
from tests.support.rig_log import ROBOT, RecordedRig


def _next(rig: RecordedRig, run: int, seconds: float = 1.0) -> None:
    """Another gateway begins a second after this one was last heard; its samples are put behind."""
    other = RecordedRig(run=run)
    later_ns = rig.at_ns + SECOND - other.at_ns
    other.wall_ns += later_ns
    other.recorder_ns += later_ns
    other.run(seconds)
    rig.keeping.kept += other.keeping.kept


def _ending(path: Path, rig: RecordedRig, from_ns: int = 0) -> RunEnding:
    path.write_bytes(rig.log())
    faults = Faults()
    found = ending(ROBOT, find_logs([path], faults), from_ns, faults, lambda _: None)
    assert not faults
    return found


def test_a_gateway_that_ends_at_work_has_died(tmp_path: Path) -> None:
    """When it was heard last is told; from a later time on it is not asked about."""
    rig, _ = RecordedRig.driving(run=1)
    dead_ns = rig.at_ns
    _next(rig, 2)
    found = _ending(tmp_path / "log.mcap", rig)
    assert found.died is not None
    assert found.died.said.state is ArbiterState.ENGAGED
    assert abs(found.died.time_ns - dead_ns) <= 60 * MS
    assert found.last is not None
    assert found.last.said.state is ArbiterState.STANDBY
    assert _ending(tmp_path / "log.mcap", rig, dead_ns + 500 * MS).died is None


def test_a_gateway_that_ends_standing_by_has_ended(tmp_path: Path) -> None:
    """It was told to, or nobody needs to know."""
    rig, _ = RecordedRig.ready(run=1)
    _next(rig, 2)
    assert _ending(tmp_path / "log.mcap", rig).died is None


def test_one_that_is_heard_again_has_not_died(tmp_path: Path) -> None:
    """Two gateways of one name speak in turn."""
    rig, operator = RecordedRig.driving(run=1)
    _next(rig, 2)
    rig.run(3.0)
    operator.drive(0.0)
    assert _ending(tmp_path / "log.mcap", rig).died is None


def test_a_log_without_states_tells_of_no_end(tmp_path: Path) -> None:
    """Neither a death nor a last state."""
    rig, _ = RecordedRig.ready()
    path = tmp_path / "log.mcap"
    path.write_bytes(rig.log(without=("safety/state",)))
    faults = Faults()
    assert ending(ROBOT, find_logs([path], faults), 0, faults, lambda _: None) == RunEnding()
