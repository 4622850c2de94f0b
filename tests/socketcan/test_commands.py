"""The gateway's commands as candump sees them, beside another, and off the bus; and ``cruiser doctor``."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

import pytest

from gateway.chassis.frame import ERROR
from gateway.client.refusal import LeaseLost, Refused, Stopped, Unreachable
from gateway.client.robot import Robot
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.messages import ControllerState
from schemas.reasons import Reason
from tests.socketcan import commands
from tests.socketcan.can_utils import Candump, send
from tests.socketcan.hearing import hearing
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis, driving, gateway, operator, wait_engageable, wait_standing_by
from tests.socketcan.turns import come_last
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, run
from tests.support.waiting import wait_until

FINE_RAW_PER_MPS = 1000


def test_commands_are_on_the_wire_as_the_manual_has_them(vcan: Vcan, witness: Candump) -> None:
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


SPEED_MPS: Final = 0.5
SPEED_RAW: Final = 500

PEDAL: Final = commands.BRAKING, bytes.fromhex("0101000000000000")
"""Enabled, the pedal at a bit, with a right checksum: it changes nothing but who commands."""

# As in linux/can/error.h.
BUS_OFF: Final = ERROR | 0x40, bytes(8)
RESTARTED: Final = ERROR | 0x100, bytes(8)
RECEIVE_PASSIVE: Final = ERROR | 0x4, bytes.fromhex("0010000000000080")


def of_controller(events: list[SafetyEvent]) -> list[tuple[Severity, Reason, str]]:
    reasons = {Reason.BUS_OFF, Reason.BUS_ERRORS}
    return [
        (event.severity, event.reason, event.text)
        for event in events
        if event.reason in reasons and event.kind is EventKind.FAULT
    ]


def test_off_the_bus_a_driven_robot_stops_and_may_be_engaged_again_when_it_is_back(
    vcan: Vcan, witness: Candump
) -> None:
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


def is_blocked(robot: Robot, reason: Reason) -> bool:
    """Report whether the robot is blocked for this reason; a late robot may be silent."""
    try:
        return reason in robot.state().state.blocked_by
    except Unreachable:
        return False


def refusal_to_engage(robot: Robot) -> str:
    """Return the refusal; empty if the request is not answered in time."""
    try:
        with robot.lease() as lease:
            lease.engage()
    except Refused as refusal:
        return str(refusal)
    except (Unreachable, LeaseLost):
        return ""
    raise AssertionError("it engaged beside another commander")


def test_the_second_gateway_does_not_engage_beside_the_first(vcan: Vcan, witness: Candump, tmp_path: Path) -> None:
    """The second one stands for another computer, and must not take the processor from the first."""
    settings = tmp_path / "second.toml"
    settings.write_text("[gateway]\nrealtime_priority = 0\n", encoding="ascii")
    endpoints = free_endpoint(), free_endpoint()
    with (
        chassis(vcan.name, "--variant", "fine"),
        gateway(vcan.name, endpoints[0], "--robot", "r-1"),
        gateway(vcan.name, endpoints[1], "--robot", "r-2", "--config", str(settings)) as other,
        operator(endpoints[0], "r-1") as first,
        operator(endpoints[1], "r-2", "second") as second,
    ):
        wait_engageable(second)
        come_last(other.process.pid)
        with driving(first, SPEED_MPS) as drive, ThreadPoolExecutor() as aside:
            wait_until(lambda: is_blocked(second, Reason.OTHER_COMMANDER), drive.keep)
            refused = aside.submit(wait_until, lambda: Reason.OTHER_COMMANDER.value in refusal_to_engage(second))
            wait_until(refused.done, drive.keep)
            refused.result()
            begun = len(commands.of(witness.frames))
            wait_until(lambda: len(commands.of(witness.frames)) > begun + 250, drive.keep)
            send(vcan.name, *PEDAL)
            with pytest.raises(Stopped) as stop:
                wait_until(lambda: False, drive.keep)
            assert stop.value.reason is Reason.OTHER_COMMANDER
            wait_standing_by(first)
        wait_engageable(second)
    own = [frame for frame in commands.of(witness.frames) if (frame.can_id, frame.data) != PEDAL]
    commands.check_counters(own)
    commands.bursts(own)


def findings(channel: str, *words: str) -> dict[str, str]:
    said = json.loads(run(["doctor", "--json", "--channel", channel, *words]).stdout)
    return {one["check"]: one["cure"] for one in said["findings"]}


def test_an_interface_is_missing_down_silent_and_well_in_turn(
    vcan: Vcan, candump: Candump, tmp_path: Path
) -> None:
    logs = ["--logs", str(tmp_path)]
    assert "interface_missing" in findings("nowhere0", *logs)
    vcan.down()
    assert findings(vcan.name, *logs)["interface_down"] == f"ip link set {vcan.name} up"
    vcan.up()
    found = findings(vcan.name, *logs)
    assert "bus_silent" in found
    assert "queue_long" not in found
    assert candump.frames == []
    with chassis(vcan.name, "--variant", "fine"):
        found = findings(vcan.name, *logs)
    assert not {"bus_silent", "feedback_missing", "variant_unknown", "other_commander"} & set(found)
    assert "gateway_missing" in found


def test_error_frames_alone_are_another_bit_rate(vcan: Vcan, tmp_path: Path) -> None:
    with Running("doctor", "--json", "--channel", vcan.name, "--logs", str(tmp_path)) as doctor:
        while doctor.process.poll() is None:
            send(vcan.name, *RECEIVE_PASSIVE)
        assert doctor.process.stdout is not None
        said = json.loads(doctor.process.stdout.read())
    assert "bit_rate" in {one["check"] for one in said["findings"]}
