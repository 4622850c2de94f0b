"""What counts as a stop: one for each end of being commanded that no client asked for."""

import pytest

from recorder.review.entries import Entry, EntryKind, Stops
from schemas.decisions import GUARD_STOP_ENDED, Severity
from schemas.reasons import Reason
from tests.support.messages import SECOND, WALL_NS
from tests.support.reading import entry

ENGAGED = (EntryKind.ENGAGED, Reason.NONE)
STOPPED = (EntryKind.STOPPED, Reason.NONE)
RESET = (EntryKind.RESET, Reason.NONE)
END = (EntryKind.END, Reason.DISENGAGED)
DEADMAN = (EntryKind.STOP, Reason.DEADMAN)
FOUND_MOVING = (EntryKind.STOP, Reason.FOUND_MOVING)
BUMPER = (EntryKind.STOP, Reason.FRONT_BUMPER)
TAKEOVER = (EntryKind.TAKEOVER, Reason.HAND_TRANSMITTER)
GUARD = (EntryKind.LATCH, Reason.GUARD)
LATCH = (EntryKind.LATCH, Reason.FRONT_BUMPER)
DIED = (EntryKind.GATEWAY, Reason.NONE)
WATCHED = (EntryKind.GUARD, Reason.NONE)


def happened(kind: EntryKind, reason: Reason, time_ns: int) -> Entry:
    """An entry; what is of no gateway that died is no error."""
    severity = Severity.ERROR if kind is EntryKind.GATEWAY else Severity.WARNING
    return entry(kind, time_ns, reason=reason, severity=severity)


@pytest.mark.parametrize(
    ("entries", "stops"),
    [
        pytest.param([], [], id="nothing"),
        pytest.param([ENGAGED, END, STOPPED], [], id="a normal end"),
        pytest.param([ENGAGED, LATCH, BUMPER, STOPPED, RESET], [2], id="a latch comes with its stop"),
        pytest.param([ENGAGED, DEADMAN, ENGAGED, DEADMAN], [1, 3], id="one for each drive"),
        pytest.param([ENGAGED, DEADMAN, BUMPER, STOPPED], [1], id="one that turned worse"),
        pytest.param([ENGAGED, TAKEOVER, FOUND_MOVING, STOPPED], [1], id="a takeover, and what was left moving"),
        pytest.param([ENGAGED, END, BUMPER, STOPPED], [2], id="a bumper in a normal end"),
        pytest.param([ENGAGED, DIED, GUARD, DIED, RESET, ENGAGED], [1], id="a killed gateway"),
        pytest.param([ENGAGED, GUARD, DEADMAN, FOUND_MOVING, STOPPED], [1], id="a gateway that hung"),
        pytest.param([ENGAGED, DIED, GUARD, STOPPED, GUARD, GUARD], [1], id="a latch that restarts report again"),
        pytest.param([ENGAGED, BUMPER, STOPPED, ENGAGED, DIED], [1, 4], id="a bumper, then killed"),
        pytest.param([FOUND_MOVING, STOPPED], [0], id="pushed while on standby"),
        pytest.param([WATCHED, ENGAGED, WATCHED], [], id="a guard that came and went"),
    ],
)
def test_one_stop_for_each_end_of_being_commanded(
    entries: list[tuple[EntryKind, Reason]], stops: list[int]
) -> None:
    """These entries, a second apart, and the numbers of those that are stops."""
    counted = Stops()
    marked = [counted.mark(happened(*one, number * SECOND)) for number, one in enumerate(entries)]
    assert [number for number, one in enumerate(marked) if one.is_stop] == stops


@pytest.mark.parametrize(
    ("second", "after_s", "stops"),
    [(FOUND_MOVING, 10.0, 1), (FOUND_MOVING, 10.1, 2), (DIED, 9000.0, 1), (GUARD, 9000.0, 1)],
)
def test_a_robot_that_is_stopped_again_much_later(
    second: tuple[EntryKind, Reason], after_s: float, stops: int
) -> None:
    """It was moved in between, though never engaged; what the next gateway says of the stop is no news."""
    counted = Stops()
    marked = [
        counted.mark(happened(*one, WALL_NS + round(time_s * SECOND)))
        for one, time_s in ((DIED, 0), (second, after_s))
    ]
    assert sum(one.is_stop for one in marked) == stops


def test_the_end_of_a_guards_stop_is_none() -> None:
    """It is news of a stop before."""
    told = entry(EntryKind.GUARD, 0, f"{GUARD_STOP_ENDED}the robot stands", reason=Reason.GUARD)
    assert not Stops().mark(told).is_stop
