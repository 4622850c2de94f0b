"""A robot that is engaged for a while by a command, and is at rest when the command ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from gateway.client.robot import Lease, Robot
from schemas.decisions import ArbiterState

REST_S: Final = 8.0
"""From full speed to standing by takes less: the ramp, a second of holding, half a second of disabling."""

POLL_S: Final = 0.05


@contextmanager
def engaged(lease: Lease, robot: Robot, deadman_s: float | None = None) -> Iterator[None]:
    """The robot is engaged within the block, and stands by after it. A stop under way is waited for."""
    robot.wait_for(lambda state: state.state is ArbiterState.STANDBY, REST_S)
    lease.engage(deadman_s=deadman_s)
    try:
        yield
    finally:
        come_to_rest(lease, robot)


def come_to_rest(lease: Lease, robot: Robot) -> bool:
    """Disengage, if the robot is engaged, and wait until its stop sequence has ended. False if it does not."""
    if lease.is_engaged:
        lease.disengage()
    return robot.wait_for(lambda state: state.state is ArbiterState.STANDBY, REST_S)
