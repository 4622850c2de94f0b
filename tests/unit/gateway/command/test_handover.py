"""When the output has to cease at once, and what the chassis may obey after that."""

import msgspec
import pytest

from gateway.chassis.port import Actuation, ChassisState
from gateway.command.output import Handover, may_be_stopped, may_obey
from schemas.messages import GearPosition, Mode
from schemas.reasons import Reason
from schemas.settings import LEFT_BLIND_NS

AUTO = ChassisState(bus_up=True, mode=Mode.AUTO, bus_losses=3, guard_stops=2)
TOLD = Actuation(enabled=True, gear=GearPosition.DRIVE, speed_mps=1.0, parking=False)
NOW_NS = 7_000_000_000


def but(**changes: object) -> ChassisState:
    """A chassis in auto, but for this."""
    return msgspec.structs.replace(AUTO, **changes)


def commanding() -> Handover:
    """We tell the chassis something."""
    handover = Handover()
    handover.begin(AUTO)
    return handover


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, Reason.NONE),
        ({"mode": Mode.UNDEFINED}, Reason.NONE),
        ({"guard_sends": True}, Reason.GUARD),
        ({"guard_stops": 3}, Reason.GUARD),
        ({"guard_stops": 3, "bus_up": False, "mode": Mode.REMOTE}, Reason.GUARD),
        ({"bus_up": False}, Reason.BUS_DOWN),
        ({"bus_losses": 4}, Reason.BUS_DOWN),
        ({"bus_losses": 4, "mode": Mode.REMOTE}, Reason.BUS_DOWN),
        ({"mode": Mode.REMOTE}, Reason.HAND_TRANSMITTER),
        ({"mode": Mode.STOP}, Reason.MODE_NOT_AUTO),
    ],
)
def test_what_ends_the_output(changes: dict[str, object], reason: Reason) -> None:
    """The gravest first; losses and stops of before we began are none."""
    handover = commanding()
    assert handover.reason_to_yield(AUTO) is Reason.NONE
    assert handover.reason_to_yield(but(**changes)) is reason


def test_a_chassis_that_was_never_auto_has_not_left_it() -> None:
    """Engaging takes a while, and a stop may begin in mode stop."""
    handover = commanding()
    stopped = but(mode=Mode.STOP)
    assert handover.reason_to_yield(stopped) is Reason.NONE
    assert handover.reason_to_yield(AUTO) is Reason.NONE
    assert handover.reason_to_yield(stopped) is Reason.MODE_NOT_AUTO
    handover.begin(AUTO)
    assert handover.reason_to_yield(stopped) is Reason.NONE


@pytest.mark.parametrize(
    ("reason", "bus_up", "cut_off"),
    [
        (Reason.BUS_DOWN, False, True),
        (Reason.BUS_DOWN, True, False),
        (Reason.GUARD, False, False),
        (Reason.HAND_TRANSMITTER, True, False),
    ],
)
def test_who_has_no_way_to_the_bus_is_cut_off(reason: Reason, bus_up: bool, cut_off: bool) -> None:  # noqa: FBT001
    """And only while it is away: a bus that was lost and is back is a way."""
    handover = commanding()
    assert handover.left is None
    handover.leave(TOLD, reason, but(bus_up=bus_up), NOW_NS)
    assert handover.left == TOLD
    assert handover.is_cut_off is cut_off


@pytest.mark.parametrize(
    ("changes", "obeyed"),
    [
        ({}, True),
        ({"mode": Mode.UNDEFINED}, True),
        ({"mode": Mode.STOP}, False),
        ({"mode": Mode.REMOTE}, False),
        ({"bus_up": False}, False),
        ({"guard_sends": True}, False),
    ],
)
def test_what_may_be_obeyed(changes: dict[str, object], obeyed: bool) -> None:  # noqa: FBT001
    """Unseen counts as obeyed; where nobody can be reached, or the guard is at it, nothing is to be done."""
    assert may_obey(but(**changes)) is obeyed
    handover = commanding()
    assert not handover.is_obeyed_again(but(**changes), NOW_NS, is_taken=False), "nothing was left"
    handover.leave(TOLD, Reason.HAND_TRANSMITTER, AUTO, NOW_NS)
    later_ns = NOW_NS + LEFT_BLIND_NS
    assert handover.is_obeyed_again(but(**changes), later_ns, is_taken=False) is obeyed


@pytest.mark.parametrize(
    ("changes", "stopped"),
    [
        ({}, True),
        ({"mode": Mode.UNDEFINED}, True),
        ({"mode": Mode.STOP}, False),
        ({"mode": Mode.STOP, "pulses": -1}, True),
        ({"mode": Mode.STOP, "fastest_wheel_mps": 0.1}, True),
        ({"mode": Mode.STOP, "turns": True}, True),
        ({"mode": Mode.STOP, "pulses": 1, "bus_up": False}, False),
        ({"mode": Mode.STOP, "pulses": 1, "guard_sends": True}, False),
        ({"mode": Mode.REMOTE, "pulses": 1}, False),
        ({"bus_up": False}, False),
    ],
)
def test_who_can_be_told_a_stop(changes: dict[str, object], stopped: bool) -> None:  # noqa: FBT001
    """Row 'a stop that cannot be carried out: a robot in mode stop that is seen to move is told all the same'."""
    assert may_be_stopped(but(**changes)) is stopped


def test_what_is_not_seen_yet_is_waited_for_from_when_the_bus_is_back() -> None:
    """Right after leaving, and right after each return of the bus."""
    handover = commanding()
    unseen = but(mode=Mode.UNDEFINED)
    handover.leave(TOLD, Reason.BUS_DOWN, but(bus_up=False), NOW_NS)
    assert not handover.is_obeyed_again(unseen, NOW_NS + LEFT_BLIND_NS - 1, is_taken=False)
    back_ns = NOW_NS + 5 * LEFT_BLIND_NS
    assert not handover.is_obeyed_again(but(bus_up=False), back_ns, is_taken=False)
    assert not handover.is_obeyed_again(unseen, back_ns + LEFT_BLIND_NS - 1, is_taken=False)
    assert handover.is_obeyed_again(AUTO, back_ns + 1, is_taken=False), "what is seen is not waited for"
    assert handover.is_obeyed_again(unseen, back_ns + LEFT_BLIND_NS, is_taken=False)


def test_what_another_computer_commands_is_not_ours_any_more() -> None:
    """From then on, also when it falls silent."""
    handover = commanding()
    handover.leave(TOLD, Reason.HAND_TRANSMITTER, AUTO, NOW_NS)
    assert not handover.is_obeyed_again(AUTO, NOW_NS, is_taken=True)
    assert handover.left is None
    assert not handover.is_obeyed_again(AUTO, NOW_NS, is_taken=False)
