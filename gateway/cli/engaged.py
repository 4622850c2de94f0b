"""A robot that is engaged for a while by a command, and is at rest when the command ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from gateway.client.reasons_text import LOOK
from gateway.client.refusal import Unreachable
from gateway.client.robot import Lease, Robot
from schemas.decisions import ArbiterState
from schemas.exit_codes import CommandError

REST_S: Final = 8.0
"""From full speed to standing by takes less: the ramp, a second of holding, half a second of disabling."""

POLL_S: Final = 0.05


@contextmanager
def engaged(lease: Lease, robot: Robot, deadman_s: float | None = None) -> Iterator[None]:
    """The robot is engaged within the block, and stands by after it. A stop under way is waited for.

    Raises:
        CommandError: it is refused, is stopped, or was not seen to come to rest.
        Unreachable: it is not heard any more, so that nobody knows whether it stands.
    """
    robot.wait_for(lambda state: state.state is ArbiterState.STANDBY, REST_S)
    lease.engage(deadman_s=deadman_s)
    try:
        yield
        lease.check()
    except BaseException as error:
        # Why the block ended is the news; that the robot does not answer now either is none.
        with suppress(CommandError):
            come_to_rest(lease, robot)
        if isinstance(error, Unreachable):
            raise Unreachable(f"{error}. {LOOK}") from error
        raise
    come_to_rest(lease, robot)
    if latched := robot.state().state.latched:
        raise CommandError(
            f"{robot.name} was stopped ({', '.join(one.value for one in latched)}): see 'cruiser why'"
        )


def come_to_rest(lease: Lease, robot: Robot) -> None:
    """Disengage, if the robot is engaged, and wait until its stop sequence has ended.

    Raises:
        CommandError: it has not, after ``REST_S``.
    """
    if lease.is_engaged:
        lease.disengage()
    if not robot.wait_for(lambda state: state.state is ArbiterState.STANDBY, REST_S):
        raise CommandError(f"{robot.name} was not seen to come to rest within {REST_S:g} s: see 'cruiser why'")
