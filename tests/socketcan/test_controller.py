"""A CAN controller in trouble, as the kernel's error frames tell it."""

from typing import Final

import pytest

from gateway.chassis.frame import ERROR
from gateway.client.refusal import Refused, Stopped
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.messages import ControllerState
from schemas.reasons import Reason
from tests.socketcan import commands
from tests.socketcan.can_utils import Candump, send
from tests.socketcan.hearing import hearing
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis, driving, gateway, operator, wait_standing_by
from tests.support.fakes.peer import free_endpoint
from tests.support.waiting import wait_until

SPEED_MPS: Final = 0.5
SPEED_RAW: Final = 500

BUS_OFF: Final = ERROR | 0x40, bytes(8)
RESTARTED: Final = ERROR | 0x100, bytes(8)
RECEIVE_PASSIVE: Final = ERROR | 0x4, bytes.fromhex("0010000000000080")
"""As linux/can/error.h has them."""


def of_controller(events: list[SafetyEvent]) -> list[tuple[Severity, Reason, str]]:
    """What was told of it."""
    reasons = {Reason.BUS_OFF, Reason.BUS_ERRORS}
    return [
        (event.severity, event.reason, event.text)
        for event in events
        if event.reason in reasons and event.kind is EventKind.FAULT
    ]


def test_off_the_bus_a_driven_robot_stops_and_may_be_engaged_again_when_it_is_back(
    vcan: Vcan, witness: Candump
) -> None:
    """The stop has that reason, and engaging is refused for it until the controller has started again."""
    endpoint = free_endpoint()
    with (
        chassis(vcan.name, "--variant", "fine"),
        gateway(vcan.name, endpoint),
        hearing(endpoint, "gateway/health") as heard,
        operator(endpoint) as robot,
    ):
        with driving(robot, SPEED_MPS) as drive:
            assert heard.health.controller is ControllerState.UNKNOWN
            send(vcan.name, *BUS_OFF)
            with pytest.raises(Stopped) as stop:
                wait_until(lambda: False, drive.keep)
            assert stop.value.reason is Reason.BUS_OFF
            wait_standing_by(robot)
            assert robot.state().state.stop_reason is Reason.BUS_OFF
            assert Reason.BUS_OFF in robot.state().state.blocked_by
            with pytest.raises(Refused) as refusal:
                drive.lease.engage()
            assert refusal.value.reason is Reason.BUS_OFF
        heard.wait_healthy(lambda health: health.controller is ControllerState.BUS_OFF)
        send(vcan.name, *RESTARTED)
        health = heard.wait_healthy(lambda health: health.controller is ControllerState.ACTIVE)
        assert (health.bus_up, health.bus_losses) == (True, 0)
        with driving(robot, SPEED_MPS):
            assert robot.state().state.engaged
        assert of_controller(robot.events()) == [
            (Severity.ERROR, Reason.BUS_OFF, "the CAN controller: unknown before, bus_off now"),
            (Severity.INFO, Reason.BUS_ERRORS, "the CAN controller: bus_off before, active now"),
        ]
    drives = [frame.data for frame in witness.frames if frame.can_id == commands.DRIVE]
    assert max(int.from_bytes(data[1:3], "little") for data in drives) == SPEED_RAW
