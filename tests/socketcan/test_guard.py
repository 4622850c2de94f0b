"""A gateway that fails while it drives, on a real interface: what the guard sends, as candump sees it."""

import signal
from typing import Final

import pytest

from tests.socketcan import commands
from tests.socketcan.can_utils import Candump, Dumped
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis, driving, gateway, operator
from tests.support.fakes.peer import free_endpoint
from tests.support.waiting import wait_until

SPEED_MPS: Final = 1.0
SPEED_RAW: Final = 1000
SILENCE_US: Final = 1_000_000


def rests(witness: Candump) -> bool:
    """Somebody has told the chassis that nothing is enabled, which ends a stop, and has fallen silent."""
    sent = commands.of(witness.frames)
    disabled = [frame for frame in sent[-5:] if not frame.data[0] & 1]
    return len(disabled) == 5 and witness.frames[-1].at_us - sent[-1].at_us > SILENCE_US


def check_stop(sent: list[Dumped]) -> None:
    """The last of these commands are a whole stop, which went on where the gateway had left off."""
    commands.check_bytes(sent)
    commands.check_counters(sent)
    told = commands.bursts(sent, torn=1)
    speeds = [burst.speed_raw for burst in told]
    fastest = len(speeds) - 1 - speeds[::-1].index(SPEED_RAW)
    ramp = speeds[fastest:]
    assert ramp == sorted(ramp, reverse=True)
    assert len(set(ramp)) > 10, "it brakes by a ramp"
    assert ramp[-1] == 0
    parked = [burst.parking for burst in told[fastest:]]
    assert parked == sorted(parked), "the parking brake is not released again"
    assert any(burst.parking and all(burst.enables) for burst in told[fastest:])
    assert told[-1].enables == (False,) * 5


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=lambda number: number.name)
def test_the_guard_stops_the_robot_of_a_gateway_that_fails(
    vcan: Vcan, witness: Candump, number: signal.Signals
) -> None:
    """Killed or stopped at speed: the guard's frames go on with the counters, down to rest and silence.

    A gateway that was only stopped, and comes back, may end the burst in which it was stopped: the robot does
    not move again, and there is silence.
    """
    endpoint = free_endpoint()
    with (
        chassis(vcan.name, "--variant", "fine"),
        gateway(vcan.name, endpoint) as running,
        operator(endpoint) as robot,
    ):
        with driving(robot, SPEED_MPS):
            running.process.send_signal(number)
            wait_until(lambda: rests(witness))
        check_stop(commands.of(witness.frames))
        if number is signal.SIGSTOP:
            heard = len(witness.frames)
            running.process.send_signal(signal.SIGCONT)
            running.wait_says("the guard has stopped the robot")
            wait_until(lambda: len(witness.frames) > heard + 40 and rests(witness))
            wheels = [frame for frame in witness.frames[heard:] if frame.can_id == commands.WHEEL_SPEEDS]
            assert all(commands.stands(frame) for frame in wheels)
