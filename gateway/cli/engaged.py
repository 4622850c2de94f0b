"""A robot that is engaged for a while by a command, and is at rest when the command ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from gateway.client.reasons_text import LOOK
from gateway.client.refusal import Unreachable
from gateway.client.robot import Lease, Robot
from schemas.command_line import CommandError

POLL_S: Final = 0.05


@contextmanager
def engaged(lease: Lease, robot: Robot, deadman_s: float | None = None) -> Iterator[None]:
    """The robot is engaged within the block, and stands by after it. A stop under way is waited for.

    Raises:
        CommandError: it is refused, is stopped, or was not seen to come to rest.
        Unreachable: it is not heard any more, so that nobody knows whether it stands.
    """
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
        CommandError: it has not.
    """
    if lease.is_engaged:
        lease.disengage(wait=False)
    robot.wait_for_rest()
