"""A drive of real processes, recorded, and run again from its log."""

import json
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from gateway.client.robot import Robot
from schemas.reasons import Reason
from schemas.settings import Settings, ZenohSettings
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, chassis, gateway, run
from tests.support.waiting import DEADLINE_S, wait_until


def drive(endpoint: str) -> None:
    settings = Settings(zenoh=ZenohSettings(connect=[endpoint]))
    with Robot.connect("cruiser-1", settings=settings, timeout_s=DEADLINE_S) as robot, robot.lease() as lease:
        wait_until(lambda: robot.state().state.blocked_by == [Reason.NOT_ENGAGED])
        lease.engage()
        lease.unpark()
        wait_until(
            lambda: abs(robot.state().state.output_speed_mps) > 0.2, lambda: lease.drive(0.4, angle_deg=5.0)
        )
        robot.stop(30)


def rerun(logs: Path) -> dict[str, Any]:
    """Return the number of identical records by subject, if all are."""
    done = run(["review", "rerun", "--json", str(logs)])
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[0]) if not done.returncode else {"same": {}}
    return found


@pytest.mark.parametrize("is_late", [False, True], ids=["first", "late"])
def test_a_recorded_drive_runs_again_as_it_was(tmp_path: Path, is_late: bool) -> None:  # noqa: FBT001
    """Byte for byte. A late recorder gets journal, decisions and events from before."""
    endpoint = free_endpoint()
    recorder = ["record", "-o", str(tmp_path), "--connect", endpoint]
    with ExitStack() as stack:
        early = None if is_late else stack.enter_context(Running(*recorder))
        if early is not None:
            early.wait_says("waiting")
        _, address = stack.enter_context(chassis())
        stack.enter_context(gateway(address, endpoint))
        drive(endpoint)
        recording = early or stack.enter_context(Running(*recorder))
        wait_until(lambda: rerun(tmp_path)["same"].get("safety/decision", 0) > 5)
        assert recording.stop(signal.SIGINT) == 0, recording.said
    found = rerun(tmp_path)
    assert found["same"]["safety/event"] > 2
    frames = found["unrecorded"] if is_late else found["same"]
    assert frames["can/{bus}/tx"] > 100
