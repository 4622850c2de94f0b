"""The loss and return of a gateway's interface."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

from gateway.client.refusal import Stopped
from gateway.client.robot import Robot
from schemas.command_line import ExitCode
from schemas.decisions import ArbiterState
from schemas.messages import Mode
from schemas.reasons import Reason
from tests.socketcan import commands
from tests.socketcan.can_utils import Candump
from tests.socketcan.hearing import Hearing, hearing
from tests.socketcan.interface import Cable, Vcan
from tests.socketcan.road import chassis, driving, gateway, operator, wait_engageable
from tests.support.bus_rules import DRIVE, value
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import run
from tests.support.waiting import wait_until

SPEED_MPS: Final = 0.5
SPEED_RAW: Final = 500
SILENT_US: Final = 500_000
LONG_STATES: Final = 80  # at 20 Hz: longer than the longest pause before the bus is tried again


def changes(values: list[bool]) -> list[bool]:
    """Return each value once per run of equal values."""
    return [value for value, _ in itertools.groupby(values)]


def wait_long(heard: Hearing) -> None:
    """Wait longer than the longest pause between retries."""
    heard.hear()
    begun = len(heard.bus_up)
    heard.wait(lambda: len(heard.bus_up) >= begun + LONG_STATES)


def is_at_rest(robot: Robot, witness: Candump) -> bool:
    seen = robot.state()
    stands = seen.chassis is not None and (seen.chassis.mode, seen.chassis.speed_mps) == (Mode.STOP, 0)
    told = commands.of(witness.frames)
    is_silent = not told or witness.frames[-1].at_us - told[-1].at_us > SILENT_US
    return stands and is_silent and seen.state.state is ArbiterState.STANDBY


def wait_cleared(robot: Robot) -> None:
    """Wait until it can be engaged, after a reset if the guard was the first to stop it."""
    if robot.state().state.latched:
        with robot.lease() as lease:
            lease.reset()
    wait_engageable(robot)


def test_a_cable_that_is_off_for_a_while_is_one_loss_and_its_robot_is_stopped(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with (
        Cable() as cable,
        Candump(cable.far, tmp_path / "far.log", commands.FILTER, commands.LAMP_FEEDBACK) as witness,
        chassis(cable.far, "--variant", "fine"),
        gateway(cable.near, endpoint),
        hearing(endpoint, "state", "gateway/health") as heard,
        operator(endpoint) as robot,
    ):
        with driving(robot, SPEED_MPS) as drive:
            heard.wait(lambda: heard.bus_up[-1:] == [True], drive.keep)
            heard.bus_up.clear()
            heard.wait(lambda: bool(heard.bus_up), drive.keep)
            cable.down()
            with pytest.raises(Stopped) as stop:
                wait_until(lambda: False, drive.keep)
            assert stop.value.reason is Reason.BUS_DOWN
            before = len(commands.of(witness.frames))
            wait_long(heard)
            down = f"socketcan {cable.near} is down: ip link set {cable.near} up"
            assert (heard.health.bus_up, heard.health.bus_detail, heard.health.bus_losses) == (False, down, 1)
            assert heard.bus_up[-LONG_STATES // 2 :] == [False] * (LONG_STATES // 2)
            state = robot.state().state
            assert (state.state, state.stop_reason) == (ArbiterState.STANDBY, Reason.BUS_DOWN)
            assert Reason.BUS_DOWN in state.blocked_by
            assert len(commands.of(witness.frames)) == before
            cable.up()
            wait_until(lambda: is_at_rest(robot, witness))
        wait_cleared(robot)
        wait_long(heard)
        assert changes(heard.bus_up) == [True, False, True]
        assert (heard.health.bus_up, heard.health.bus_detail, heard.health.bus_losses) == (True, "", 1)
    speeds_raw = [value(DRIVE, "v", frame.data) for frame in commands.drives(witness.frames)]
    fastest = len(speeds_raw) - 1 - speeds_raw[::-1].index(SPEED_RAW)
    assert speeds_raw[fastest:] == sorted(speeds_raw[fastest:], reverse=True)
    sent = commands.of(witness.frames)
    assert len(sent) > before
    assert not any(frame.data[0] & 1 for frame in sent[-5:])


@pytest.mark.parametrize(
    ("go", "come", "why"),
    [
        (Vcan.down, Vcan.up, "socketcan {0} is down: ip link set {0} up"),
        (Vcan.remove, Vcan.create, "socketcan {0}: No such device"),
    ],
    ids=["down", "missing"],
)
def test_a_gateway_starts_without_its_interface_if_told_to(
    vcan: Vcan, go: Callable[[Vcan], None], come: Callable[[Vcan], None], why: str
) -> None:
    go(vcan)
    why = why.format(vcan.name)
    endpoint = free_endpoint()
    ended = run(["gateway", "--channel", vcan.name, "--listen", endpoint])
    told = f"cruiser gateway: {why} (with --wait-for-bus the gateway starts without it)"
    assert (ended.returncode, ended.stderr.splitlines()[-1]) == (ExitCode.UNREACHABLE, told)
    with (
        gateway(vcan.name, endpoint, "--wait-for-bus"),
        hearing(endpoint, "state", "gateway/health") as heard,
        operator(endpoint) as robot,
    ):
        heard.wait_healthy(lambda health: health.bus_detail == why)
        assert not any(heard.bus_up)
        come(vcan)
        with chassis(vcan.name, "--variant", "fine"):
            wait_engageable(robot)
        assert heard.wait_healthy(lambda health: health.bus_up).bus_losses == 0
        assert changes(heard.bus_up) == [False, True]
