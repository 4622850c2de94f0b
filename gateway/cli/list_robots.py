"""``cruiser list``: the robots that are connected, and their health."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Final

import msgspec

from gateway.client import view
from gateway.client.fleet import Fleet, RobotStatus
from gateway.telemetry.received import TokenChange
from gateway.zenoh.client import PendingQuery, RobotListener, place
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
    """List the robots. Exit code 0 if there are any, 1 if there are none, 3 if not all may be in the list.

    Raises:
        CommandError: no Zenoh node answers, or it does not say in time who is connected.
    """
    where = place(settings.zenoh)
    with RobotListener.open(settings) as listener:
        search = _Search(listener, Fleet(settings.robot.root), time.monotonic() + arguments.timeout)
        reports = search.run(stopped)
    if not search.linked:
        text = f"no Zenoh node answered within {arguments.timeout:g} s at {where}"
        raise CommandError(text, ExitCode.UNREACHABLE)
    if not reports and not search.is_complete:
        text = f"the Zenoh node at {where} did not say within {arguments.timeout:g} s which robots are connected"
        raise CommandError(text, ExitCode.UNREACHABLE)
    for report in reports:
        text = msgspec.json.encode(report).decode() if arguments.json else view.health_line(report)
        sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
    if not reports:
        sys.stderr.write(f"no robot is connected at {where}\n")
        return int(ExitCode.FAILURE)
    if not search.is_complete:
        sys.stderr.write(f"there may be more: not everybody answered within {arguments.timeout:g} s at {where}\n")
        return int(ExitCode.PARTIAL)
    return int(ExitCode.OK)


class _Search:
    """Looks for robots until all have sent their health and no other appears.

    Attributes:
        linked: a Zenoh node is connected.
        is_complete: everybody who is connected has been asked which robots are there, and has answered.
    """

    def __init__(self, listener: RobotListener, fleet: Fleet, deadline_s: float) -> None:
        self.linked = False
        self.is_complete = False
        self._listener = listener
        self._fleet = fleet
        self._deadline_s = deadline_s
        self._settled_s = 0.0
        self._links: frozenset[str] = frozenset()
        self._roll: PendingQuery | None = None
        self._known: set[str] = set()

    def run(self, stopped: Callable[[], bool]) -> list[RobotStatus]:
        """Every robot's report."""
        while not stopped() and time.monotonic() < self._deadline_s and not self._step(time.monotonic_ns()):
            time.sleep(POLL_S)
        now_ns = time.monotonic_ns()
        return [self._fleet.report(robot, now_ns) for robot in self._fleet.robots(now_ns)]

    def _step(self, now_ns: int) -> bool:
        """Take in what has arrived. Is there nothing more to wait for?"""
        for heard in self._listener.drain():
            self._fleet.hear(heard, now_ns)
        robots = set(self._fleet.robots(now_ns))
        links = self._listener.links()
        if robots != self._known or links != self._links:
            self._known = robots
            self._settled_s = time.monotonic() + SETTLE_S
        if links != self._links:
            # A link that is lost ends the question too, and one that is new was not asked.
            self._links, self._roll, self.is_complete = links, None, False
        silent = any(self._fleet.report(robot, now_ns).health is None for robot in robots)
        if self.is_complete and not silent and time.monotonic() >= self._settled_s:
            return True
        if links:
            self.linked = True
            self._call_roll(now_ns)
        return False

    def _call_roll(self, now_ns: int) -> None:
        """Ask who is there. On a busy network the answer takes longer than robots follow each other."""
        if self._roll is None:
            self._roll = self._listener.call_roll(max(self._deadline_s - time.monotonic(), POLL_S))
        for received in self._roll.poll():
            self._fleet.hear(TokenChange(received.key, present=True), now_ns)
        self.is_complete = self._roll.is_over and not self._roll.timed_out
