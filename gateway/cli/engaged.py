"""A robot that is engaged for a while by a command, and is at rest when the command ends."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import msgspec

from gateway.cli.operator_arguments import add_robot_arguments, connect, lease_number
from gateway.client.reply import BY_REQUEST
from gateway.client.robot import Lease, Robot
from schemas.arguments import ending_after, seconds
from schemas.decisions import ArbiterState
from schemas.exit_codes import ExitCode
from schemas.requests import Request
from schemas.settings import Settings

REST_S: Final = 8.0
"""From full speed to standing by takes less: the ramp, a second of holding, half a second of disabling."""

POLL_S: Final = 0.05

BUT_FOR_A_LEASE: Final = """\
This wants an engaged robot. With --lease, that of another command of the same operator is used ('cruiser drive'
and 'cruiser lease --engage' show its number). Without it the lease is acquired, the robot engaged, and afterwards
it is stopped and the lease given back."""


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


def add_action_arguments(parser: argparse.ArgumentParser, *, lasts: bool, default_s: float | None = None) -> None:
    """The flags of a verb that wants an engaged robot.

    Args:
        parser: the command's.
        lasts: what the verb does ends when the robot is disengaged, so that there is something to keep.
        default_s: how long to keep it; None is until Ctrl-C.
    """
    parser.description = f"{parser.description or ''}\n\n{BUT_FOR_A_LEASE}"
    add_robot_arguments(parser)
    parser.add_argument("--lease", type=lease_number, metavar="N", help="use this lease of the same operator")
    parser.add_argument("--json", action="store_true", help="one JSON object, once it is done")
    if lasts:
        until = "until Ctrl-C" if default_s is None else f"{default_s:g}"
        parser.add_argument(
            "--seconds",
            type=seconds,
            default=default_s,
            metavar="S",
            help=f"without --lease: how long to keep it ({until})",
        )


def run_action(
    arguments: argparse.Namespace,
    settings: Settings,
    stopped: Callable[[], bool],
    request: Callable[[int], Request],
    *,
    lasts: bool,
) -> int:
    """Ask an engaged robot for something.

    Raises:
        CommandError: it is refused, or nobody answers.
    """
    with connect(arguments, settings, stopped) as robot:
        if arguments.lease is not None:
            _ask(robot, arguments, request(arguments.lease))
            return int(ExitCode.OK)
        with robot.lease() as lease, engaged(lease, robot):
            _ask(robot, arguments, request(lease.number))
            if lasts:
                _keep(lease, ending_after(stopped, arguments.seconds, time.monotonic))
    return int(ExitCode.OK)


def _ask(robot: Robot, arguments: argparse.Namespace, request: Request) -> None:
    reply = robot.ask(request)
    if arguments.json:
        record = {"robot": robot.name, "verb": BY_REQUEST[type(request)].verb, **msgspec.structs.asdict(reply)}
        sys.stdout.write(f"{msgspec.json.encode(record).decode()}\n")
        sys.stdout.flush()


def _keep(lease: Lease, stopped: Callable[[], bool]) -> None:
    sys.stderr.write(f"done; lease {lease.number} keeps the robot engaged; Ctrl-C ends it\n")
    sys.stderr.flush()
    while not stopped():
        lease.check()
        time.sleep(POLL_S)
