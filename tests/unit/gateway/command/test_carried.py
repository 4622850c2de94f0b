"""A gateway that is started again clears no latch, and it stays while it is needed."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from gateway.choice import CHASSIS
from gateway.command.restart import QUIET_NS, Carried
from gateway.core import Core
from gateway.journal import inputs_of
from gateway.rerun import run_again
from schemas.decisions import ArbiterState, EventKind
from schemas.journal import Kind
from schemas.reasons import Reason
from schemas.settings import LATE_NS, CommandSettings
from tests.support.rigs.gateway import GUARDED, GatewayRig, Operator, driving

SETTLED_S = QUIET_NS / 1e9 + 0.1
BEFORE = 7, 8
"""The numbers of a run, and of the one after it."""


def may_start_again(rig: GatewayRig) -> bool:
    """By the gateway's own word."""
    return rig.core.may_start_again(rig.now_ns)


def start_again(rig: GatewayRig) -> Carried:
    """The gateway is started again, as the command does it: another core begins with the note of latches."""
    rig.core.shut_down(rig.now_ns)
    rig.tick()
    latches = rig.core.command.arbiter.engagement.latches  # type: ignore[union-attr]
    carried = Carried({reason.value: detail for reason, detail in latches.details.items()})
    rig.core = Core(CHASSIS, rig.settings, "1.2.3", rig.now_ns, BEFORE[1])
    rig.core.take_over(carried, rig.now_ns)
    rig.events.clear()
    rig.recorded.clear()
    rig._counters.clear()
    rig.run(1)
    return carried


def _stop(rig: GatewayRig) -> None:
    rig.put("stranger", "stop", b"")


def _press(rig: GatewayRig) -> None:
    rig.fault("bumper front on for 100ms")


def _let_the_guard_act(rig: GatewayRig) -> None:
    rig.links = msgspec.structs.replace(GUARDED, guard_stops=1, guard_says="the gateway was late")
    rig.tick()
    rig.links = msgspec.structs.replace(GUARDED, guard_stops=1)


@pytest.mark.parametrize(
    ("strike", "reason"),
    [(_stop, Reason.REMOTE_STOP), (_press, Reason.FRONT_BUMPER), (_let_the_guard_act, Reason.GUARD)],
)
def test_what_is_latched_stays_latched_until_a_reset(strike: Callable[[GatewayRig], None], reason: Reason) -> None:
    """With its reason and its words; it is no hindrance to a restart, and a restart is none to a reset."""
    rig, operator = driving()
    strike(rig)
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 10)
    assert rig.says.latched == [reason]
    operator.reason("release")
    rig.run(SETTLED_S)
    assert may_start_again(rig)
    carried = start_again(rig)
    assert list(carried.latched) == [reason.value]
    assert rig.says.latched == [reason]
    (event,) = [event for event in rig.events if event.kind is EventKind.LATCH]
    assert carried.latched[reason.value] in event.text
    operator = Operator(rig, "second")
    assert operator.take_lease() is Reason.NONE
    assert operator.reason("engage") is reason
    assert operator.reset() is Reason.NONE
    operator.engage()


def test_nothing_is_latched_that_was_not() -> None:
    """A robot at rest starts again as it was."""
    rig = GatewayRig()
    rig.run(SETTLED_S)
    assert start_again(rig) == Carried()
    assert rig.says.latched == []


def _owe_a_stop(rig: GatewayRig) -> None:
    rig.core.command.arbiter.engagement.owes_stop = True  # type: ignore[union-attr]


def _leave_the_horn_on(rig: GatewayRig) -> None:
    rig.core.command.arbiter.engagement.auxiliary.restore({}, horn=True)  # type: ignore[union-attr]


def _hold_lease(rig: GatewayRig) -> None:
    """For longer than it takes to be quiet: what was asked last is forgotten, the lease is not."""
    Operator(rig, "third").take_lease()
    rig.run(SETTLED_S)
    assert rig.says.lease_holder == "third"


def _ask_in_vain(rig: GatewayRig) -> None:
    rig.put("stranger", "drive", b"")
    rig.tick()


def _lose_bus(rig: GatewayRig) -> None:
    rig.links = msgspec.structs.replace(GUARDED, bus_up=False, bus_losses=1)
    rig.run(SETTLED_S)


def _blind(rig: GatewayRig) -> None:
    rig.fault("silence Auto_WheelSpdFeedback")
    rig.run(SETTLED_S)


def _move(rig: GatewayRig) -> None:
    rig.fault("transmitter remote")
    rig.fault("sticks 0.5 0")
    rig.run(SETTLED_S)


def _stop_in_somebodys_hand(rig: GatewayRig) -> None:
    rig.fault("transmitter remote")
    rig.run(0.5)
    _stop(rig)
    rig.run(SETTLED_S)


def _close(rig: GatewayRig) -> None:
    rig.core.shut_down(rig.now_ns)
    rig.run(SETTLED_S)


@pytest.mark.parametrize(
    "disturb",
    [
        _hold_lease,
        _ask_in_vain,
        _lose_bus,
        _blind,
        _move,
        _stop_in_somebodys_hand,
        _close,
        _owe_a_stop,
        _leave_the_horn_on,
    ],
)
def test_a_gateway_that_is_needed_does_not_start_again(disturb: Callable[[GatewayRig], None]) -> None:
    """Somebody commands the robot or asks, it is not seen to stand, or a stop waits for its turn."""
    rig = GatewayRig(command=CommandSettings(lease_s=2 * SETTLED_S - 1))
    rig.run(SETTLED_S)
    assert may_start_again(rig)
    disturb(rig)
    assert not may_start_again(rig)


def test_a_busy_computer_does_not_keep_a_gateway_from_starting_again() -> None:
    """The loop is late all the time, and says so in events; nobody asks anything."""
    rig = GatewayRig()
    rig.run(SETTLED_S)
    rig.events.clear()
    end_ns = rig.now_ns + 2 * QUIET_NS
    while rig.now_ns < end_ns:
        rig.late_ns = 2 * LATE_NS
        rig.tick()
        rig.late_ns = 0
        rig.run(0.5)
        assert may_start_again(rig)
    assert Reason.LOOP_LATE in {event.reason for event in rig.events}


def test_a_chassis_that_was_left_with_a_command_is_not_left_alone() -> None:
    """The remote control took it over in a drive, and may give it back: the guard needs the gateway for that."""
    rig, operator = driving()
    rig.fault("transmitter remote")
    rig.run(1)
    operator.reason("release")
    rig.run(SETTLED_S)
    assert not may_start_again(rig)
    rig.fault("transmitter command")
    rig.until(lambda: rig.says.stop_reason is Reason.FOUND_MOVING, 2)
    rig.run(SETTLED_S + 2)
    assert may_start_again(rig)


def test_the_journal_of_the_second_run_begins_with_what_was_carried_over() -> None:
    """Run again from it, the core is latched as it was."""
    rig, operator = driving()
    _stop(rig)
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 10)
    operator.reason("release")
    rig.run(SETTLED_S)
    start_again(rig)
    said = [one for _, one in rig.recorded if one.subject.startswith("safety/")]
    inputs = [one for journal in rig.journals for one in inputs_of(journal)]
    assert inputs[0][0] == Kind.CARRIED
    again = Core(CHASSIS, rig.settings, "", inputs[0][1], BEFORE[1])
    repeated = [one for _, samples in run_again(again, inputs) for one in samples]
    repeated = [one for one in repeated if one.subject.startswith("safety/")]
    assert len(repeated) > 10
    assert repeated == said[: len(repeated)]
