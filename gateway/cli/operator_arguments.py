"""Arguments of commands to one robot, and how these connect, engage and come to rest."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from gateway.client.refusal import LOOK, Unreachable
from gateway.client.remote_stop import who_is_there
from gateway.client.robot import CONNECT_TIMEOUT_S, Lease, Robot
from schemas.arguments import add_zenoh_arguments, operator_name, robot_name, seconds, whole_number
from schemas.command_line import CommandError
from schemas.requests import LEASE_MAX, Role
from schemas.settings import Settings


def add_operator_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--operator", type=operator_name, metavar="NAME", help="operator's name (default: login name)"
    )
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=CONNECT_TIMEOUT_S,
        metavar="S",
        help=f"time to wait for the robot (default {CONNECT_TIMEOUT_S:g})",
    )
    add_zenoh_arguments(parser)


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("robot", type=robot_name, metavar="ROBOT", help="the robot")
    add_operator_arguments(parser)


def add_take_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags that ``wanted_lease`` reads."""
    parser.add_argument(
        "--role",
        type=Role,
        choices=list(Role),
        default=Role.OPERATOR,
        metavar="ROLE",
        help=f"{', '.join(role.value for role in Role)} (default operator); a lower role cannot take the lease",
    )
    parser.add_argument("--take", action="store_true", help="take the lease of another while the robot stands")
    parser.add_argument(
        "--override", action="store_true", help="take the lease of a moving robot, which is stopped first"
    )


def wanted_lease(robot: Robot, arguments: argparse.Namespace) -> Lease:
    if arguments.take or arguments.override:
        return robot.take(arguments.role, override=arguments.override)
    return robot.lease(arguments.role)


def connect(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> Robot:
    """Connect as the arguments say. The error for an unknown robot lists those that are connected."""
    try:
        return Robot.connect(arguments.robot, arguments.operator or "", settings, arguments.timeout, stopped)
    except Unreachable as error:
        if stopped():
            raise
        raise Unreachable(f"{error}{who_is_there(settings, arguments.robot)}") from error


lease_number: Final = whole_number(0, LEASE_MAX)

POLL_S: Final = 0.05


@contextmanager
def engaged(lease: Lease, robot: Robot, deadman_s: float | None = None) -> Iterator[None]:
    """Engage the robot for the block, and bring it back to standby."""
    lease.engage(deadman_s=deadman_s)
    try:
        yield
        lease.check()
    except BaseException as error:
        # The first error is the cause; a silent robot causes another one here.
        with suppress(CommandError):
            come_to_rest(lease, robot)
        if isinstance(error, Unreachable):
            raise Unreachable(f"{error}. {LOOK}") from error
        raise
    come_to_rest(lease, robot)
    if latched := robot.state().state.latched:
        raise CommandError(
            f"{robot.name} was stopped ({', '.join(one.value for one in latched)}); see 'cruiser why {robot.name}'"
        )


def come_to_rest(lease: Lease, robot: Robot) -> None:
    """Disengage, if engaged, and wait for the end of the stop sequence."""
    if lease.is_engaged:
        lease.disengage(wait=False)
    robot.wait_for_rest()
