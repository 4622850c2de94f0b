"""``cruiser lease``: show, acquire, take and keep the lease of a robot."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Final

import msgspec

from gateway.cli.operator_arguments import add_robot_arguments, add_take_arguments, connect, engaged, wanted_lease
from gateway.client.refusal import holder_line
from gateway.client.robot import Lease, Robot
from schemas.arguments import ending_after, seconds
from schemas.command_line import ExitCode
from schemas.settings import Settings

EXAMPLE = """\
  cruiser lease cruiser-1                             who holds it
  cruiser lease cruiser-1 --hold                      acquire it and keep it until Ctrl-C; prints its number
  cruiser lease cruiser-1 --take --role supervisor    take it from its holder and keep it
  cruiser lease cruiser-1 --hold --engage             keep the robot engaged, at standstill
  cruiser light cruiser-1 --headlamp --lease N        use this lease from another terminal"""

POLL_S: Final = 0.05


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_robot_arguments(parser)
    parser.add_argument(
        "--hold", action="store_true", help="acquire the lease, print its number, keep it until Ctrl-C"
    )
    add_take_arguments(parser)
    parser.add_argument(
        "--engage", action="store_true", help="engage the robot too, at zero speed, for at most command.idle_s"
    )
    parser.add_argument("--seconds", type=seconds, metavar="S", help="time to keep the lease")
    parser.add_argument("--json", action="store_true", help="one JSON object")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    with connect(arguments, settings, stopped) as robot:
        if arguments.hold or arguments.take or arguments.override or arguments.engage:
            with wanted_lease(robot, arguments) as lease:
                _keep(robot, lease, arguments, stopped)
            return int(ExitCode.OK)
        state = robot.state().state
    if arguments.json:
        record = {
            "robot": arguments.robot,
            "lease_holder": state.lease_holder,
            "lease_role": state.lease_role if state.lease_holder else None,
            "lease_expires_s": state.lease_expires_s,
        }
        sys.stdout.write(f"{msgspec.json.encode(record).decode()}\n")
    else:
        sys.stdout.write(f"{arguments.robot}: {holder_line(state)}\n")
    return int(ExitCode.OK)


def _keep(robot: Robot, lease: Lease, arguments: argparse.Namespace, stopped: Callable[[], bool]) -> None:
    with ExitStack() as stack:
        if arguments.engage:
            stack.enter_context(engaged(lease, robot))
        number = {"robot": robot.name, "operator": robot.operator, "lease": lease.number}
        sys.stdout.write(f"{msgspec.json.encode(number).decode() if arguments.json else lease.number}\n")
        sys.stdout.flush()
        ended = ending_after(stopped, arguments.seconds, time.monotonic)
        while not ended():
            lease.check()
            time.sleep(POLL_S)
