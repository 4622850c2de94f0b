"""What the arbiter has told of one robot, and how the runs of its gateways ended."""

from pathlib import Path

from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.review.entries import Entry, EntryKind, EntrySource
from recorder.review.reasoning.story import RunEnding, Story, endings
from schemas.decisions import RUN_TICKS, ArbiterState, Severity
from schemas.reasons import Reason
from tests.support.messages import MS, ROBOT, SECOND
from tests.support.rigs.recorded import RecordedRig


def _entry(kind: EntryKind, time_ns: int, text: str, *, tick: int, reason: Reason = Reason.NONE) -> Entry:
    return Entry(
        time_ns=time_ns,
        last_ns=time_ns,
        robot="cruiser-1",
        kind=kind,
        severity=Severity.INFO,
        source=EntrySource.EVENT,
        text=text,
        reason=reason,
        tick=tick,
    )


def test_a_reset_is_of_the_latches_that_it_names_in_its_run() -> None:
    """One of another latch, one of nothing, and one of another gateway are none of it."""
    latch = _entry(EntryKind.LATCH, 1, "latched until a reset", tick=10, reason=Reason.REMOTE_STOP)
    others = [
        _entry(EntryKind.RESET, 2, "reset: front_bumper", tick=20),
        _entry(EntryKind.RESET, 3, "reset: nothing was latched", tick=30),
        _entry(EntryKind.RESET, 4, "reset: remote_stop", tick=10 + RUN_TICKS),
    ]
    own = _entry(EntryKind.RESET, 5, "reset: front_bumper, remote_stop", tick=50)
    assert Story([latch, *others]).reset_of(latch) is None
    assert Story([latch, *others, own]).reset_of(latch) == own


def test_the_last_stop_is_one_that_nobody_asked_for() -> None:
    """Where there was none, it is the end of the drive."""
    stop = _entry(EntryKind.STOP, 1, "stopping", tick=10, reason=Reason.DEADMAN)
    end = _entry(EntryKind.END, 2, "stopping", tick=20, reason=Reason.DISENGAGED)
    assert Story([stop, end]).last_stop() == stop
    assert Story([end]).last_stop() == end
    assert Story([stop, end]).stop_before(3) == end


def _next(rig: RecordedRig, run: int, seconds: float = 1.0) -> None:
    """Another gateway begins a second after this one was last heard; its samples are put behind."""
    other = RecordedRig.beginning(rig.at_ns + SECOND, run)
    other.run(seconds)
    rig.recorded += other.recorded


def _ending(path: Path, rig: RecordedRig, from_ns: int = 0) -> RunEnding:
    path.write_bytes(rig.log())
    faults = Faults()
    found = endings(ROBOT, find_logs([path], faults), from_ns, faults, lambda _: None)
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
    assert endings(ROBOT, find_logs([path], faults), 0, faults, lambda _: None) == RunEnding()
