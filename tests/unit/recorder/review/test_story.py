"""What the arbiter has told of one robot, and how the runs of its gateways ended."""

from pathlib import Path

import msgspec

from recorder.reading.logs import Faults, find_logs
from recorder.review.entries import EntryKind
from recorder.review.moment import Story
from schemas.decisions import RUN_TICKS
from schemas.reasons import Reason
from tests.support.messages import MS, ROBOT, SECOND
from tests.support.reading import entry
from tests.support.rigs.recorded import RecordedRig


def test_a_reset_is_of_the_latches_that_it_names_in_its_run() -> None:
    """One of another latch, one of nothing, and one of another gateway are none of it."""
    latch = entry(EntryKind.LATCH, 1, "latched until a reset", tick=10, reason=Reason.REMOTE_STOP)
    others = [
        entry(EntryKind.RESET, 2, "reset: front_bumper", tick=20),
        entry(EntryKind.RESET, 3, "reset: nothing was latched", tick=30),
        entry(EntryKind.RESET, 4, "reset: remote_stop", tick=10 + RUN_TICKS),
    ]
    own = entry(EntryKind.RESET, 5, "reset: front_bumper, remote_stop", tick=50)
    assert Story([latch, *others]).reset_of(latch) is None
    assert Story([latch, *others, own]).reset_of(latch) == own


def test_the_last_stop_is_one_that_nobody_asked_for() -> None:
    """Where there was none, it is the end of the drive."""
    stop = entry(EntryKind.STOP, 1, "stopping", tick=10, reason=Reason.DEADMAN)
    end = entry(EntryKind.END, 2, "stopping", tick=20, reason=Reason.DISENGAGED)
    assert Story([stop, end]).last_stop() == stop
    assert Story([end]).last_stop() == end
    assert Story([stop, end]).stop_before(3) == end


def _next(rig: RecordedRig, run: int, seconds: float = 1.0) -> None:
    """Another gateway begins a second after this one was last heard; its samples are put behind."""
    other = RecordedRig.beginning(rig.at_ns + SECOND, run)
    other.run(seconds)
    rig.recorded += other.recorded


def _story(path: Path, rig: RecordedRig, *without: str) -> Story:
    path.write_bytes(rig.log(without=without))
    faults = Faults()
    story = Story.read(ROBOT, find_logs([path], faults), faults, lambda _: None)
    assert not faults
    return story


def test_a_gateway_that_ends_at_work_has_died(tmp_path: Path) -> None:
    """One that stands by at its end has not; of two that speak in turn none has."""
    rig, operator = RecordedRig.driving(run=1)
    dead_ns = rig.at_ns
    _next(rig, 2)
    died, then = _story(tmp_path / "log.mcap", rig).runs
    assert (died.was_active, then.was_active) == (True, False)
    assert abs(died.last.time_ns - dead_ns) <= 60 * MS
    rig.run(3.0)
    operator.drive(0.0)
    assert _story(tmp_path / "log.mcap", rig).is_shared
    assert _story(tmp_path / "log.mcap", rig, "safety/state").runs == []


def test_a_clock_that_is_set_back_leaves_the_order() -> None:
    """A time that comes twice is the later one; the last stop is the last, whatever its time."""
    first = entry(EntryKind.STOP, 100, "stopping", tick=10, reason=Reason.DEADMAN)
    clock = msgspec.structs.replace(entry(EntryKind.CLOCK, 50, "set", tick=11), last_ns=150)
    last = entry(EntryKind.STOP, 60, "stopping", tick=20, reason=Reason.REMOTE_STOP)
    story = Story([first, clock, last])
    assert story.last_stop() == last
    assert [story.order_ns(at_ns) for at_ns in (40, 60, 100, 200)] == [40, 160, 200, 300]
    assert story.stop_before(60) == last
    assert not story.is_steady(60)
