"""``cruiser watch``: a live view of a robot; of several it is ``cruiser list``, live."""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Final

import msgspec
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from gateway.cli.list_robots import Expected
from gateway.client import fleet as view
from gateway.client.fleet import Fleet, RobotStatus
from gateway.client.remote_stop import who_is_there
from gateway.zenoh.client import RobotListener
from schemas.arguments import add_zenoh_arguments, seconds
from schemas.command_line import CommandError, ExitCode, plain
from schemas.keys import ALL, ROBOTS_PATTERN, in_order
from schemas.settings import Settings
from schemas.zenoh_session import place

EXAMPLE = """\
  cruiser watch                                   all robots, one a row
  cruiser watch cruiser-1                         one robot
  cruiser watch 'cruiser-1*'                      several
  cruiser watch --connect tcp/10.0.0.5:7447 --json | jq .state.speed_mps"""

POLL_S: Final = 0.02
"""The period in which arrivals are taken from Zenoh."""

REFRESH_S: Final = 0.1
"""The period in which the terminal is drawn."""

LINE_S: Final = 1.0
"""The period in which a line is written for each robot when there is no terminal."""

Show = Callable[[list[RobotStatus]], None]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "robot",
        nargs="?",
        default="",
        metavar="ROBOT",
        help="the robot, or several by '*', as 'cruiser-1*'; all of them if left out",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="stop after this time")
    parser.add_argument(
        "--timeout", type=seconds, default=5.0, metavar="S", help="how long to wait for the robot (5)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a second and robot, one a line")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Show the robots' messages until interrupted."""
    robot: str = arguments.robot
    if robot and re.fullmatch(ROBOTS_PATTERN, robot) is None:
        raise CommandError(f"{plain(robot)!r} cannot be a robot: its name is {ROBOTS_PATTERN}", ExitCode.USAGE)
    end_s = time.monotonic() + arguments.seconds if arguments.seconds else float("inf")
    fleet = Fleet(settings.robot.root)
    with RobotListener.open(settings, robot) as listener:
        expected = [] if robot and ALL not in robot else Expected(settings).matching(robot or ALL)
        watching = _Watching(listener, fleet, "" if ALL in robot else robot, expected)
        problem = watching.wait(min(end_s, time.monotonic() + arguments.timeout), stopped)
        if problem and not stopped():
            text = f"{problem} within {arguments.timeout:g} s at {place(settings.zenoh)}"
            raise CommandError(f"{text}{who_is_there(settings, robot)}", ExitCode.UNREACHABLE)
        console = Console()
        if arguments.json:
            watching.show(lambda reports: _write(map(_json_line, reports)), LINE_S, end_s, stopped)
        elif console.is_terminal and not console.is_dumb_terminal:
            _live(watching, console, end_s, stopped)
        else:
            watching.show(lambda reports: _write(_lines(reports, watching.robot)), LINE_S, end_s, stopped)
    return int(ExitCode.OK)


class _Watching:
    """A listener to one robot, or to all of them."""

    def __init__(self, listener: RobotListener, fleet: Fleet, robot: str, expected: Sequence[str]) -> None:
        self._expected = expected
        self._listener = listener
        self._fleet = fleet
        self.robot = robot

    def wait(self, deadline_s: float, stopped: Callable[[], bool]) -> str:
        """Wait for the robot, or, if all are asked for, for any Zenoh node. Returns what is missing, or ''."""
        while not stopped():
            self._poll()
            connected = self._listener.connected()
            if connected and (not self.robot or self.robot in self._fleet.robots.names(time.monotonic_ns())):
                return ""
            if time.monotonic() >= deadline_s:
                return f"robot {self.robot!r} did not appear" if connected else "no Zenoh node answered"
            time.sleep(POLL_S)
        return ""

    def show(self, show: Show, every_s: float, end_s: float, stopped: Callable[[], bool]) -> None:
        """Show the reports at once and then regularly, until the end or until stopped.

        What a pause left out (Ctrl-Z, a machine that slept) is not made up for.
        """
        due_s = time.monotonic() + min(every_s, 2 * REFRESH_S)  # The first state is on its way.
        while not stopped() and time.monotonic() < end_s:
            self._poll()
            late_s = time.monotonic() - due_s
            if late_s >= 0:
                due_s += every_s * (1 + late_s // every_s)
                show(self._reports())
            time.sleep(POLL_S)

    def _reports(self) -> list[RobotStatus]:
        now_ns = time.monotonic_ns()
        names = {self.robot} if self.robot else {*self._fleet.robots.names(now_ns), *self._expected}
        return [self._fleet.report(name, now_ns) for name in sorted(names, key=in_order)]

    def _poll(self) -> None:
        now_ns = time.monotonic_ns()
        self._fleet.linked = self._listener.connected()
        for heard in self._listener.drain():
            self._fleet.receive(heard, now_ns)


def _live(watching: _Watching, console: Console, end_s: float, stopped: Callable[[], bool]) -> None:
    # Drawn from this thread alone, so that rich needs none of its own. On the terminal's other screen: neither a
    # window that changes its size nor the end of the view may leave old values that somebody reads as current.
    with Live(console=console, auto_refresh=False, screen=True) as live:

        def draw(reports: list[RobotStatus]) -> None:
            several = Group(*(view.list_view(reports) or [Text("no robot is connected", style=view.BAD)]))
            live.update(view.panel(reports[0]) if watching.robot else several, refresh=True)

        watching.show(draw, REFRESH_S, end_s, stopped)


def _lines(reports: list[RobotStatus], robot: str) -> Iterable[str]:
    return map(view.line, reports) if robot else (one.plain for one in view.list_view(reports))


def _json_line(report: RobotStatus) -> str:
    return msgspec.json.encode({"time_ns": time.time_ns(), **msgspec.structs.asdict(report)}).decode()


def _write(lines: Iterable[str]) -> None:
    for text in lines:
        sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
