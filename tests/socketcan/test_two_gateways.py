"""Two computers that would command one chassis, on a real interface."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from gateway.client.refusal import LeaseLost, Refused, Unreachable
from gateway.client.robot import Robot
from schemas.reasons import Reason
from tests.socketcan import commands
from tests.socketcan.can_utils import Candump
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis, driving, gateway, operator, wait_engageable, wait_standing_by
from tests.socketcan.turns import come_last
from tests.support.fakes.peer import free_endpoint
from tests.support.waiting import wait_until

SPEED_MPS: Final = 0.5


def is_blocked(robot: Robot, reason: Reason) -> bool:
    """It is heard to say so; one that comes last may be silent for a while."""
    try:
        return reason in robot.state().state.blocked_by
    except Unreachable:
        return False


def refusal_to_engage(robot: Robot) -> str:
    """The refusal in words. Empty where a request is not answered in time, as by a robot that comes last."""
    try:
        with robot.lease() as lease:
            lease.engage()
    except Refused as refusal:
        return str(refusal)
    except (Unreachable, LeaseLost):
        return ""
    raise AssertionError("it engaged beside another commander")


def test_the_second_gateway_does_not_engage_beside_the_first(vcan: Vcan, witness: Candump, tmp_path: Path) -> None:
    """It hears the first one's frames, says so, refuses, and sends none; then the first one rests, and it may.

    The second one stands for another computer: it does not take the processor from the first.
    """
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
            drive.lease.disengage()
            wait_standing_by(first)
        wait_engageable(second)
    commands.check_counters(commands.of(witness.frames))
    commands.bursts(commands.of(witness.frames))
