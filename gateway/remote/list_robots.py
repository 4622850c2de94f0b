"""``cruiser list``: the robots that are connected, and their health."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Final

import msgspec

from gateway.ports.zenoh_client import RobotListener, place
from gateway.remote import view
from gateway.remote.fleet import Fleet, RobotReport
from schemas.arguments import add_zenoh_arguments, seconds
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings

EXAMPLE = """\
  cruiser list
  cruiser list --json --connect tcp/10.0.0.5:7447 | jq -r .robot"""

POLL_S: Final = 0.02
"""How often what has arrived is taken from Zenoh."""

SETTLE_S: Final = 0.7
"""When nothing new was heard for this long, nobody else is expected: nodes find each other by gossip in less."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=3.0,
        metavar="S",
        help="how long to wait for robots and their health (3)",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a robot, one a line")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """List the robots. Exit code 0 if there are any, 1 if there are none.

    Raises:
        CommandError: no Zenoh node answers.
    """
    deadline_s = time.monotonic() + arguments.timeout
    with RobotListener.open(settings) as listener:
        reports = _collect(listener, Fleet(settings.robot.root), deadline_s, stopped)
    if reports is None:
        raise CommandError(
            f"no Zenoh node answered within {arguments.timeout:g} s at {place(settings.zenoh)}",
            ExitCode.UNREACHABLE,
        )
    for report in reports:
        text = msgspec.json.encode(report).decode() if arguments.json else view.health_line(report)
        sys.stdout.write(f"{text}\n")
    if not reports:
        sys.stderr.write(f"no robot is connected at {place(settings.zenoh)}\n")
    return int(ExitCode.OK if reports else ExitCode.FAILURE)


def _collect(
    listener: RobotListener, fleet: Fleet, deadline_s: float, stopped: Callable[[], bool]
) -> list[RobotReport] | None:
    """Every robot's report, once all have sent their health and no other appears; None if nobody answers."""
    connected = False
    settled_s = 0.0
    known: set[str] = set()
    while not stopped() and time.monotonic() < deadline_s:
        now_ns = time.monotonic_ns()
        for heard in listener.drain():
            fleet.hear(heard, now_ns)
        robots = set(fleet.robots(now_ns))
        if robots != known or not connected:
            known = robots
            connected = listener.connected()
            settled_s = time.monotonic() + SETTLE_S
        silent = [robot for robot in known if fleet.report(robot, now_ns).health is None]
        if connected and not silent and time.monotonic() >= settled_s:
            break
        time.sleep(POLL_S)
    now_ns = time.monotonic_ns()
    return [fleet.report(robot, now_ns) for robot in fleet.robots(now_ns)] if connected else None
