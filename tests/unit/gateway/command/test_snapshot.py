"""What a gateway at rest is remembered by."""

from collections.abc import Callable

import msgspec
import pytest

from gateway.choice import CHASSIS
from gateway.command.flow import CommandFlow
from gateway.command.restart import QUIET_NS, Snapshot, is_at_rest, restore, snapshot
from schemas.messages import Variant
from schemas.reasons import Reason
from tests.support.rigs.gateway import GUARDED, GatewayRig, Operator, ready


def flow_of(rig: GatewayRig) -> CommandFlow:
    flow = rig.core.command
    assert flow is not None
    return flow


def rested() -> GatewayRig:
    """A robot that was driven by two operators, one after the other, and that nobody wants any more."""
    rig, operator = ready()
    operator.engage()
    operator.drive(0.5, 3.0, 1.0)
    operator.ask("disengage")
    rig.run(4)
    second = Operator(rig, "second")
    second.take_lease("take", override=True)
    assert second.reason("release") is Reason.NONE
    rig.run(QUIET_NS / 1e9 + 0.1)
    return rig


def test_what_is_remembered_is_restored() -> None:
    """By way of the journal's bytes, and by a flow of the same run that knows nothing."""
    rig = rested()
    memory = snapshot(flow_of(rig))
    assert memory.leases == 2
    assert memory.ended
    assert memory.target_angle_deg == 3.0
    assert not memory.parked
    assert len(memory.sent) == 5
    assert len(memory.challenges) > 50
    read = msgspec.convert(msgspec.msgpack.decode(msgspec.msgpack.encode(memory)), Snapshot)
    assert read == memory
    flow = CommandFlow(CHASSIS, rig.settings, 7)
    restore(flow, read, rig.now_ns)
    assert snapshot(flow) == memory
    assert flow.maker.counters == flow_of(rig).maker.counters
    challenge, published_ns = memory.challenges[-1]
    assert flow.arbiter.link.challenges.age_ns(challenge, published_ns + 5) == 5
    number, reason = memory.ended[-1]
    assert flow.arbiter.leases.refusal(number, "second") is Reason(reason)


def test_the_next_lease_has_the_number_that_it_would_have_had() -> None:
    """It goes on where the run's numbers are."""
    rig = rested()
    flow = CommandFlow(CHASSIS, rig.settings, 7)
    restore(flow, snapshot(flow_of(rig)), rig.now_ns)
    operator = Operator(rig, "third")
    operator.take_lease()
    given = flow.arbiter.leases.acquire("third", rig.says.lease_role, 0)
    assert not isinstance(given, Reason)
    assert given.id == operator.lease


def _hold_lease(rig: GatewayRig) -> None:
    Operator(rig, "third").take_lease()


def _ask_in_vain(rig: GatewayRig) -> None:
    rig.put("stranger", "drive", b"")
    rig.tick()


def _stop(rig: GatewayRig) -> None:
    rig.put("stranger", "stop", b"")
    rig.run(7)


def _press(rig: GatewayRig) -> None:
    rig.fault("bumper front on")
    rig.run(7)


def _lose_feedback(rig: GatewayRig) -> None:
    rig.fault("silence Auto_GearFeedBack")
    rig.run(1)


def _lose_bus(rig: GatewayRig) -> None:
    rig.links = msgspec.structs.replace(GUARDED, bus_up=False, bus_losses=1)
    rig.run(1)


def _move(rig: GatewayRig) -> None:
    rig.fault("transmitter remote")
    rig.fault("sticks 0.5 0")
    rig.run(3)


def _close(rig: GatewayRig) -> None:
    rig.core.shut_down(rig.now_ns)
    rig.tick()


@pytest.mark.parametrize(
    "disturb", [_hold_lease, _ask_in_vain, _stop, _press, _lose_feedback, _lose_bus, _move, _close]
)
def test_whatever_goes_on_is_no_rest(disturb: Callable[[GatewayRig], None]) -> None:
    """Each of them would have to be remembered too."""
    rig = rested()
    assert is_at_rest(flow_of(rig), rig.now_ns)
    disturb(rig)
    assert not is_at_rest(flow_of(rig), rig.now_ns)


def test_lamps_that_were_put_out_before_a_takeover_keep_nobody_from_rest() -> None:
    """Those that shine do: the chassis has them on, and the next engagement puts them out."""
    for is_left_on in (False, True):
        rig, operator = ready()
        operator.engage()
        assert operator.reason("light", headlamp=True) is Reason.NONE
        assert operator.reason("light", headlamp=is_left_on) is Reason.NONE
        rig.fault("transmitter remote")
        rig.run(0.5)
        assert operator.reason("release") is Reason.NONE
        # Another computer commands the chassis for a moment: what it was left on is past.
        rig.fault("foreign 18C4D3D0 every 10ms for 50ms")
        rig.run(QUIET_NS / 1e9 + 1)
        assert is_at_rest(flow_of(rig), rig.now_ns) is not is_left_on


def test_before_the_variant_is_known_there_is_no_rest() -> None:
    """Who begins there could not know it either."""
    rig = GatewayRig(Variant.COARSE)
    rig.fault("silence Auto_WheelSpdFeedback")
    rig.run(QUIET_NS / 1e9 + 1)
    assert not is_at_rest(flow_of(rig), rig.now_ns)
