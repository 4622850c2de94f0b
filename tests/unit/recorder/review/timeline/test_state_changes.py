"""What two states tell of what happened between them."""

from collections.abc import Mapping
from typing import Any

from recorder.review.timeline.entries import EntryKind
from recorder.review.timeline.state_changes import TICKS_MAX, EventTicks, changes
from schemas.decisions import ArbiterState
from schemas.reasons import Reason
from schemas.requests import Role
from tests.unit.recorder.review.timeline.test_timeline import state


def kinds(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[tuple[EntryKind, Reason, str]]:
    """What is told of two states 50 ms apart."""
    found = changes(state(0, 0, **before), state(5, 1, **now))
    return [(one.kind, one.reason, one.text) for one in found]


def test_nothing_changed_tells_nothing() -> None:
    """Whatever the speeds do."""
    assert kinds({"output_speed_mps": 0.1}, {"output_speed_mps": 0.2}) == []


def test_a_lease_comes_goes_and_changes_hands() -> None:
    """With who, and in which role."""
    nobody, one = {"lease_holder": ""}, {"lease_holder": "operator-1", "lease_role": Role.OPERATOR}
    two = {"lease_holder": "operator-2", "lease_role": Role.SUPERVISOR}
    assert kinds(nobody, one) == [(EntryKind.LEASE, Reason.NONE, "operator-1 holds the lease as operator")]
    assert kinds(one, nobody) == [(EntryKind.LEASE, Reason.NONE, "operator-1 no longer holds the lease")]
    assert kinds(one, two) == [
        (EntryKind.LEASE, Reason.NONE, "operator-2 holds the lease as supervisor, operator-1 before")
    ]


def test_a_stop_that_began_and_ended_unseen_is_both() -> None:
    """Engaged before and standing by now, for a reason that has a stop sequence."""
    engaged = {"state": ArbiterState.ENGAGED}
    rest = {"state": ArbiterState.STANDBY, "stop_reason": Reason.DEADMAN}
    assert [(kind, reason) for kind, reason, _ in kinds(engaged, rest)] == [
        (EntryKind.STOP, Reason.DEADMAN),
        (EntryKind.STOPPED, Reason.DEADMAN),
    ]


def test_an_output_that_ceased_at_once_is_a_takeover() -> None:
    """Or the guard's."""
    engaged = {"state": ArbiterState.ENGAGED}
    for reason, kind in ((Reason.HAND_TRANSMITTER, EntryKind.TAKEOVER), (Reason.GUARD, EntryKind.GUARD)):
        rest = {"state": ArbiterState.STANDBY, "stop_reason": reason}
        assert [(one, why) for one, why, _ in kinds(engaged, rest)] == [(kind, reason)]


def test_latches_are_told_one_by_one_and_cleared_together() -> None:
    """As the arbiter does it."""
    both = {"latched": [Reason.GATE, Reason.FRONT_BUMPER]}
    assert [(kind, reason) for kind, reason, _ in kinds({}, both)] == [
        (EntryKind.LATCH, Reason.GATE),
        (EntryKind.LATCH, Reason.FRONT_BUMPER),
    ]
    assert kinds(both, {}) == [(EntryKind.RESET, Reason.NONE, "reset: gate, front_bumper")]


def test_a_hole_between_the_states_is_told() -> None:
    """When it was is not known any better."""
    (change,) = changes(state(0, 0), state(300, 9, latched=[Reason.GATE]))
    assert change.text.endswith("(within 3.0 s of which the log holds no state)")


def test_events_are_found_between_two_ticks() -> None:
    """Behind the first, and up to the second; in whatever order they came."""
    ticks = EventTicks()
    for tick in (30, 10, 20):
        ticks.add(EntryKind.STOP, tick)
    assert ticks.tells(EntryKind.STOP, 19, 20)
    assert not ticks.tells(EntryKind.STOP, 20, 29)
    assert not ticks.tells(EntryKind.LATCH, 0, 100)


def test_the_ticks_of_events_are_bounded() -> None:
    """The oldest are forgotten."""
    ticks = EventTicks()
    for tick in range(TICKS_MAX + 10):
        ticks.add(EntryKind.STOP, tick)
    assert not ticks.tells(EntryKind.STOP, -1, 9)
    assert ticks.tells(EntryKind.STOP, 9, 10)
