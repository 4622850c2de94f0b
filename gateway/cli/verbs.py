"""Commands of one verb each: ``park``, ``unpark``, ``light``, ``horn``, ``odometer``, as a table."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import Final

import msgspec

from gateway.cli.operator_arguments import POLL_S, add_robot_arguments, connect, engaged, lease_number
from gateway.client.fleet import BY_REQUEST
from gateway.client.robot import Lease, Robot
from schemas.arguments import ending_after, seconds
from schemas.command_line import ExitCode
from schemas.requests import ClearOdometer, Horn, Light, Park, Request, ResetOdometry, Unpark
from schemas.settings import Settings

LAMPS: Final = ("headlamp", "left", "right")

WANTS_ENGAGED: Final = """\
Acquires the lease and engages the robot; at the end stops the robot and releases the lease. With --lease, uses
the robot that another command of the same operator has engaged ('cruiser drive' and 'cruiser lease --engage' show
the number)."""


class VerbCommand(msgspec.Struct, frozen=True):
    """A command for one request.

    Attributes:
        add_flags: declares its own flags.
        lasts: its effect ends when the robot is disengaged, so it can be kept for a while.
        keep_s: default time to keep it; None: until Ctrl-C.
    """

    EXAMPLE: str
    request: Callable[[argparse.Namespace, int], Request]
    add_flags: Callable[[argparse.ArgumentParser], object] = lambda _parser: None
    lasts: bool = False
    keep_s: float | None = None

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.description = f"{parser.description or ''}\n\n{WANTS_ENGAGED}"
        add_robot_arguments(parser)
        parser.add_argument(
            "--lease", type=lease_number, metavar="N", help="number of a lease held by the same operator"
        )
        parser.add_argument("--json", action="store_true", help="reply as one JSON object")
        if self.lasts:
            until = "until Ctrl-C" if self.keep_s is None else f"{self.keep_s:g}"
            about = f"without --lease: duration (default {until})"
            parser.add_argument("--seconds", type=seconds, default=self.keep_s, metavar="S", help=about)
        self.add_flags(parser)

    def run(self, arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
        with connect(arguments, settings, stopped) as robot:
            if arguments.lease is not None:
                self._ask(robot, arguments, arguments.lease)
                return int(ExitCode.OK)
            verb = BY_REQUEST[type(self.request(arguments, 0))]
            if verb.engaged_only:
                sys.stderr.write(f"{robot.name}: engaging the robot; it returns to standby afterwards\n")
            with robot.lease() as lease, engaged(lease, robot) if verb.engaged_only else nullcontext():
                self._ask(robot, arguments, lease.number)
                if self.lasts:
                    _keep(lease, ending_after(stopped, arguments.seconds, time.monotonic))
        return int(ExitCode.OK)

    def _ask(self, robot: Robot, arguments: argparse.Namespace, lease: int) -> None:
        request = self.request(arguments, lease)
        reply = robot.ask(request)
        if arguments.json:
            record = {"robot": robot.name, "verb": BY_REQUEST[type(request)].verb, **msgspec.structs.asdict(reply)}
            sys.stdout.write(f"{msgspec.json.encode(record).decode()}\n")
            sys.stdout.flush()


def _keep(lease: Lease, stopped: Callable[[], bool]) -> None:
    sys.stderr.write(f"done; lease {lease.number} keeps the robot engaged until Ctrl-C\n")
    while not stopped():
        lease.check()
        time.sleep(POLL_S)


def _add_lamps(parser: argparse.ArgumentParser) -> None:
    for lamp in LAMPS:
        parser.add_argument(
            f"--{lamp}",
            action="store_true",
            help=f"{lamp}{'' if lamp == 'headlamp' else ' indicator'} on (default: off)",
        )


def _add_odometers(parser: argparse.ArgumentParser) -> None:
    which = parser.add_mutually_exclusive_group(required=True)
    about = "total mileage of the chassis to zero; this cannot be undone"
    which.add_argument("--clear", action="store_true", help=about)
    which.add_argument("--reset-pose", action="store_true", help="pose of chassis/odometry to zero")


PARK: Final = VerbCommand(
    "  cruiser park cruiser-1\n  cruiser park cruiser-1 --lease 123456789", lambda _, lease: Park(lease=lease)
)
UNPARK: Final = VerbCommand(
    "  cruiser unpark cruiser-1 --lease 123456789\n"
    "  cruiser unpark cruiser-1 --seconds 10        engaged and unparked for ten seconds",
    lambda _, lease: Unpark(lease=lease),
    lasts=True,
)
LIGHT: Final = VerbCommand(
    "  cruiser light cruiser-1 --headlamp --left --lease 123456789\n"
    "  cruiser light cruiser-1 --lease 123456789        all of them off",
    lambda arguments, lease: Light(lease=lease, **{lamp: getattr(arguments, lamp) for lamp in LAMPS}),
    _add_lamps,
    lasts=True,
)
HORN: Final = VerbCommand(
    "  cruiser horn cruiser-1\n  cruiser horn cruiser-1 on --lease 123456789",
    lambda arguments, lease: Horn(lease=lease, on=arguments.switch == "on"),
    lambda parser: parser.add_argument(
        "switch", nargs="?", choices=["on", "off"], default="on", help="on or off (default on)"
    ),
    lasts=True,
    keep_s=1.0,
)
ODOMETER: Final = VerbCommand(
    "  cruiser odometer cruiser-1 --clear\n"
    "  cruiser odometer cruiser-1 --reset-pose        without engaging the robot",
    lambda arguments, lease: ResetOdometry(lease=lease) if arguments.reset_pose else ClearOdometer(lease=lease),
    _add_odometers,
)
