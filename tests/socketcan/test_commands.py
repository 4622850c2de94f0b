"""The gateway's commands as candump sees them, and ``cruiser doctor``."""

import json
import statistics
from itertools import pairwise
from pathlib import Path

from tests.socketcan import commands
from tests.socketcan.can_utils import Candump
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis, driving, gateway, operator, wait_standing_by
from tests.support.bus_rules import ANGLE_BIT_UDEG, BURST, LIGHT, SPEAKER
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import run
from tests.support.waiting import wait_until


def test_commands_are_on_the_wire_as_the_manual_has_them(vcan: Vcan, witness: Candump) -> None:
    endpoint = free_endpoint()
    with (
        chassis(vcan.name, "--variant", "fine"),
        gateway(vcan.name, endpoint),
        operator(endpoint) as robot,
        driving(robot, 0.5, angle_deg=10.0) as drive,
    ):
        begun = len(commands.drives(witness.frames))
        wait_until(lambda: len(commands.drives(witness.frames)) >= begun + 100, drive.keep)
        drive.lease.light(headlamp=True, left=True)
        drive.lease.horn(on=True)
        wait_until(lambda: any(frame.can_id == SPEAKER for frame in witness.frames), drive.keep)
        drive.lease.disengage()
        wait_standing_by(robot)
    sent = commands.of(witness.frames)
    told = commands.checked(sent)
    assert {frame.can_id for frame in sent} == {*BURST, LIGHT, SPEAKER}
    times_us = [frame.at_us for frame in commands.drives(sent)]
    assert 9_000 <= statistics.median(later - earlier for earlier, later in pairwise(times_us)) <= 11_000
    for burst in told[begun : begun + 100]:
        assert (burst.enables, burst.gear, burst.speed_umps) == ("11111", "D", 500_000)
        assert (burst.has_pedal, burst.is_parked) == (False, False)
    assert told[0].speed_umps == 0
    assert abs(max(burst.angle_udeg for burst in told) - 10_000_000) < ANGLE_BIT_UDEG
    # The stop: at the end the robot is parked, then told that nothing is enabled, then nothing.
    assert (told[-1].enables, told[-1].speed_umps) == ("00000", 0)
    assert any(burst.is_parked and burst.enables == "11111" for burst in told[-200:])


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
