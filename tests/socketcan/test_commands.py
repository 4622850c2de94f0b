"""What the gateway sends, as candump sees it on a real interface."""

import pytest

from gateway.client.refusal import Refused
from schemas.reasons import Reason
from tests.socketcan import commands
from tests.socketcan.can_utils import Candump
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis, driving, gateway, operator, wait_engageable, wait_standing_by
from tests.support.fakes.peer import free_endpoint
from tests.support.waiting import wait_until

FINE_RAW_PER_MPS = 1000


def test_commands_are_on_the_wire_as_the_manual_has_them(vcan: Vcan, witness: Candump) -> None:
    """Identifiers, layout, XOR, counters, the order of a burst, its period: from the first frame to the last."""
    endpoint = free_endpoint()
    with (
        chassis(vcan.name, "--variant", "fine"),
        gateway(vcan.name, endpoint),
        operator(endpoint) as robot,
        driving(robot, 0.5, angle_deg=10.0) as drive,
    ):
        begun = len(commands.of(witness.frames))
        wait_until(lambda: len(commands.of(witness.frames)) >= begun + 500, drive.keep)
        steady = commands.of(witness.frames)[begun + 5 :]
        drive.lease.light(headlamp=True, left=True)
        drive.lease.horn(on=True)
        wait_until(lambda: any(frame.can_id == commands.SPEAKER for frame in witness.frames), drive.keep)
        drive.lease.disengage()
        wait_standing_by(robot)
    sent = commands.of(witness.frames)
    commands.check_bytes(sent)
    commands.check_counters(sent)
    told = commands.bursts(sent)
    assert 9 <= commands.median_period_ms(told) <= 11
    assert {frame.can_id for frame in sent} == {*commands.BURST, commands.LIGHT, commands.SPEAKER}

    first = steady.index(next(frame for frame in steady if frame.can_id == commands.BURST[0]))
    whole = steady[first : first + 5 * ((len(steady) - first) // 5)]
    for burst in commands.bursts(whole):
        assert burst.enables == (True,) * 5
        assert (burst.gear, burst.speed_raw) == (commands.FORWARD_GEAR, 0.5 * FINE_RAW_PER_MPS)
        assert (burst.pedal_raw, burst.parking) == (0, False)
    assert told[0].speed_raw == 0
    assert abs(max(burst.angle_deg for burst in told) - 10) < commands.ANGLE_DEG_PER_BIT
    # The stop: at the end the robot is parked, then told that nothing is enabled, then nothing.
    assert (told[-1].enables, told[-1].speed_raw) == ((False,) * 5, 0)
    assert any(burst.parking and all(burst.enables) for burst in told[-200:])


def test_a_gateway_that_stands_by_is_silent(vcan: Vcan, witness: Candump) -> None:
    """Not a frame, though it is asked for things that it refuses."""
    endpoint = free_endpoint()
    with chassis(vcan.name), gateway(vcan.name, endpoint) as running, operator(endpoint) as robot:
        wait_engageable(robot)
        with robot.lease() as lease, pytest.raises(Refused) as refusal:
            lease.unpark()
        assert refusal.value.reason is Reason.NOT_ENGAGED
        heard = len(witness.frames)
        wait_until(lambda: len(witness.frames) > heard + 40)
        assert running.stop() == 0
    assert commands.of(witness.frames) == []
