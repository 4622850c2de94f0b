"""Inside the box: an operator who drives the robot straight on, until it is stopped.

Whatever holds the box up for a tenth of a second stops a robot: until it has driven steadily for a while, it is
reset and engaged again. Once it has, the first stop ends the drive: nobody engages again.
"""

import os
import sys
import time
from pathlib import Path
from typing import Final

from gateway.client.robot import Lease, Robot
from schemas.decisions import ArbiterState
from schemas.exit_codes import CommandError
from schemas.reasons import Reason
from schemas.settings import Settings

SPEED_MPS: Final = 0.5
STEADY_S: Final = 3.0
READY_S: Final = 60.0
DRIVE_S: Final = 300.0
OVERCOME: Final = frozenset({Reason.NO_LEASE, Reason.NOT_ENGAGED})
DONE: Final = Path("/run/box/operator")
"""How the drive ended: the tests read it."""


def drive(robot: Robot, lease: Lease) -> bool:
    """One try. Returns that it drove steadily before it ended."""
    if not robot.wait_for(lambda state: state.guarded and set(state.blocked_by) <= OVERCOME, READY_S):
        say(f"blocked: {robot.state().state.blocked_by}")
        lease.reset()
        return False
    lease.engage()
    lease.unpark()
    since_s = None
    end_s = time.monotonic() + DRIVE_S
    try:
        while time.monotonic() < end_s:
            lease.drive(SPEED_MPS)
            if since_s is None and robot.state().state.output_speed_mps == SPEED_MPS:
                since_s = time.monotonic()
            time.sleep(0.1)
    except CommandError as error:
        say(f"ended: {error}")
    robot.wait_for(lambda state: state.state is ArbiterState.STANDBY, READY_S)
    return since_s is not None and time.monotonic() - since_s > STEADY_S


def say(line: str) -> None:
    """A line for the journal."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """Drive; try again while it was not steady."""
    end_s = time.monotonic() + DRIVE_S
    with Robot.connect("cruiser-1", "tester", Settings(), READY_S) as robot:
        while time.monotonic() < end_s:
            try:
                with robot.lease() as lease:
                    if robot.state().state.latched:
                        lease.reset()
                    if drive(robot, lease):
                        break
            except CommandError as error:
                say(f"again: {error}")
                time.sleep(1)
    DONE.write_text("done\n", encoding="ascii")
    os.sync()


if __name__ == "__main__":
    main()
