"""Inside the box: an operator who drives the robot straight on, until it is stopped.

Whatever holds the box up for a tenth of a second stops a robot: until the test has seen it drive steadily, it is
reset and engaged again. Once the test has, the first stop ends the drive: nobody engages again.
"""

import os
import sys
import time
from pathlib import Path
from typing import Final

from gateway.cli.configuration_file import load_settings
from gateway.client.robot import Lease, Robot
from schemas.command_line import CommandError
from schemas.decisions import ArbiterState
from schemas.reasons import Reason

SPEED_MPS: Final = 0.5
READY_S: Final = 60.0
DRIVE_S: Final = 300.0
OVERCOME: Final = frozenset({Reason.NO_LEASE, Reason.NOT_ENGAGED})
SEEN: Final = Path("/run/box/steady")  # there once the test has seen a steady drive


def drive(robot: Robot, lease: Lease) -> None:
    if not robot.wait_for(lambda state: state.guarded and set(state.blocked_by) <= OVERCOME, READY_S):
        say(f"blocked: {robot.state().state.blocked_by}")
        lease.reset()
        return
    lease.engage()
    lease.unpark()
    end_s = time.monotonic() + DRIVE_S
    try:
        while time.monotonic() < end_s:
            lease.drive(SPEED_MPS)
            time.sleep(0.1)
    except CommandError as error:
        say(f"ended: {error}")
    robot.wait_for(lambda state: state.state is ArbiterState.STANDBY, READY_S)


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    end_s = time.monotonic() + DRIVE_S
    with Robot.connect("cruiser-1", "tester", load_settings(None, os.environ, {}), READY_S) as robot:
        while time.monotonic() < end_s and not SEEN.exists():
            try:
                with robot.lease() as lease:
                    if robot.state().state.latched:
                        lease.reset()
                    drive(robot, lease)
            except CommandError as error:
                say(f"again: {error}")
                time.sleep(1)


if __name__ == "__main__":
    main()
