"""``cruiser reset``: clear a robot's latches. Short, as each command is a file."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import msgspec

from gateway.cli.operator_arguments import add_robot_arguments, connect, lease_number
from schemas.command_line import ExitCode
from schemas.settings import Settings

EXAMPLE = """\
  cruiser reset cruiser-1
  cruiser reset cruiser-1 --of bob                 clear bob's remote stop, after asking him
  cruiser reset cruiser-1 --lease 123456789        while another command of the same operator holds the lease"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        f"{parser.description or ''}\n\n"
        "The robot must stand, and the cause must be gone. Waits for the end of a stop that is under way.\n"
        "Without --lease, acquires the lease if it is free, and releases it. Then engage the robot again."
    )
    add_robot_arguments(parser)
    parser.add_argument(
        "--lease", type=lease_number, metavar="N", help="number of a lease held by the same operator"
    )
    parser.add_argument(
        "--of", default="", metavar="NAME", help="operator whose remote stop is cleared, if it is not yours"
    )
    parser.add_argument(
        "--no-wait", dest="wait", action="store_false", help="no wait for the end of a stop that is under way"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    with connect(arguments, settings, stopped) as robot:
        if arguments.lease is not None:
            cleared = robot.reset(arguments.lease, arguments.of, wait=arguments.wait)
        else:
            with robot.lease() as lease:
                cleared = lease.reset(arguments.of, wait=arguments.wait)
    if arguments.json:
        record = {"robot": arguments.robot, "cleared": cleared.split(", ") if cleared else []}
        sys.stdout.write(f"{msgspec.json.encode(record).decode()}\n")
        return int(ExitCode.OK)
    sys.stdout.write(f"{arguments.robot}: {f'cleared {cleared}' if cleared else 'nothing was latched'}\n")
    return int(ExitCode.OK)
