"""``cruiser list``: the robots that are connected, and their health."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from gateway.client import view
from gateway.client.fleet import Fleet, RobotStatus
from gateway.client.robot_word import summary
from gateway.client.roll import RollCall
from gateway.telemetry.received import TokenChange
from gateway.zenoh.client import RobotListener, place
from schemas import keys
from schemas.arguments import add_zenoh_arguments, robot_names, seconds
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.settings import Settings

EXAMPLE = """\
  cruiser list
  cruiser list 'cruiser-1*'
  cruiser list --json --connect tcp/10.0.0.5:7447 | jq -r .robot"""

BLIND_ROLES: Final = frozenset({"robot", "router"})
"""Roles whose certificates see no telemetry of robots."""

POLL_S: Final = 0.02
"""The period in which arrivals are taken from Zenoh."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "robots",
        nargs="?",
        default=keys.ALL,
        type=robot_names,
        metavar="ROBOT",
        help="the robot, or several by '*', as 'cruiser-1*'; all of them if left out",
    )
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
    """List the robots, several after a line on all of them.

    Exit code 0 if there are any, 1 if there are none, 3 if not all may be in the list.

    Raises:
        CommandError: no Zenoh node answers, or it does not say in time who is connected.
    """
    where = place(settings.zenoh)
    with RobotListener.open(settings, arguments.robots) as listener:
        search = _Search(listener, settings.robot.root)
        reports = search.run(time.monotonic() + arguments.timeout, stopped)
    if stopped():
        # Who has not answered yet is not known to be silent.
        raise KeyboardInterrupt
    if not reports and settings.zenoh.config:
        check_role(settings.zenoh.config)
    if not search.linked:
        text = f"no Zenoh node answered within {arguments.timeout:g} s at {where}"
        raise CommandError(text, ExitCode.UNREACHABLE)
    if not reports and not search.is_complete:
        text = f"the Zenoh node at {where} did not say within {arguments.timeout:g} s which robots are connected"
        raise CommandError(text, ExitCode.UNREACHABLE)
    if len(reports) > 1 and not arguments.json:
        sys.stdout.write(f"{summary(reports)}\n")
    for report in reports:
        text = msgspec.json.encode(report).decode() if arguments.json else view.health_line(report)
        notes = [] if arguments.json else _notes(report)
        sys.stdout.write("\n  see to: ".join([text, *map(plain, notes)]) + "\n")
    sys.stdout.flush()
    if not reports:
        called = f" called {arguments.robots}" if arguments.robots != keys.ALL else ""
        sys.stderr.write(f"no robot{called} is connected at {where}\n")
        return int(ExitCode.FAILURE)
    if not search.is_complete:
        sys.stderr.write(f"there may be more: not everybody answered within {arguments.timeout:g} s at {where}\n")
        return int(ExitCode.PARTIAL)
    return int(ExitCode.OK)


def check_role(config: str) -> None:
    """Check that the certificate of a Zenoh file is not of a role that sees no robot.

    Raises:
        CommandError: it is.
    """
    from gateway.provisioning.tls_files import role_of  # noqa: PLC0415 - only where nobody is seen

    if (role := role_of(Path(config))) in BLIND_ROLES:
        raise CommandError(
            f"these are the settings of a {role} ({plain(config)}), whose certificate sees no robot: list with "
            "those of an operator or a viewer, 'cruiser list --config operator.toml'",
            ExitCode.USAGE,
        )


def _notes(report: RobotStatus) -> list[str]:
    """The things that somebody has to see to, as the robot publishes them."""
    latched = [] if report.safety is None else [reason.value for reason in report.safety.latched]
    notes = [f"latched: {', '.join(latched)}"] if latched else []
    return notes if report.health is None else [*notes, *report.health.notes]


class _Search:
    """Looks for robots until all have sent their health and no other appears.

    Attributes:
        linked: a Zenoh node is connected.
    """

    def __init__(self, listener: RobotListener, root: str) -> None:
        self.linked = False
        self._listener = listener
        self._root = root
        self._fleet = Fleet(root)
        self._roll = RollCall(listener, root)

    @property
    def is_complete(self) -> bool:
        """Everybody who is connected has been asked which robots are there, and has answered."""
        return self._roll.is_answered

    def run(self, deadline_s: float, stopped: Callable[[], bool]) -> list[RobotStatus]:
        """Return every robot's report."""
        while not stopped() and (now_s := time.monotonic()) < deadline_s and not self._step(now_s):
            time.sleep(POLL_S)
        return self._reports(time.monotonic_ns())

    def _reports(self, now_ns: int) -> list[RobotStatus]:
        return [self._fleet.report(robot, now_ns) for robot in self._fleet.robots(now_ns)]

    def _step(self, now_s: float) -> bool:
        """Take what has arrived. Return whether nothing more is to be waited for."""
        now_ns = time.monotonic_ns()
        for arrival in self._listener.drain():
            self._fleet.receive(arrival, now_ns)
        for robot in self._roll.step(now_s):
            self._fleet.receive(TokenChange(keys.liveliness(self._root, robot), present=True), now_ns)
        self.linked = self.linked or bool(self._listener.links())
        return self._roll.is_complete(now_s) and all(report.health for report in self._reports(now_ns))
