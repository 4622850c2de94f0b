"""``cruiser watch``: a live view of a robot, or ``cruiser list`` live."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterable
from typing import Final

import msgspec
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from gateway.cli.list_robots import Expected, Sightings
from gateway.client import fleet as view
from gateway.client.fleet import RobotStatus
from gateway.client.remote_stop import who_is_there
from gateway.zenoh.client import RobotListener
from schemas import keys
from schemas.arguments import add_zenoh_arguments, ending_after, robot_names, seconds
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings
from schemas.zenoh_session import place

EXAMPLE = """\
  cruiser watch                                   all robots, one a row
  cruiser watch cruiser-1                         one robot
  cruiser watch 'cruiser-1*'                      several
  cruiser watch --connect tcp/10.0.0.5:7447 --json | jq .state.speed_mps"""

POLL_S: Final = 0.02  # the period in which arrivals are taken from Zenoh
REFRESH_S: Final = 0.1  # the period in which the terminal is drawn
LINE_S: Final = 1.0  # the period in which a line is written for each robot when there is no terminal
Draw = Callable[[list[RobotStatus]], None]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "robot",
        nargs="?",
        default=keys.ALL,
        type=robot_names,
        metavar="ROBOT",
        help="robot, or several, as in 'cruiser-1*' (default: all)",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="duration")
    parser.add_argument(
        "--timeout", type=seconds, default=5.0, metavar="S", help="time to wait for the robot (default 5)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per robot and second, one per line")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    robot = "" if keys.ALL in arguments.robot else arguments.robot
    ends = ending_after(stopped, arguments.seconds, time.monotonic)
    with RobotListener.open(settings, arguments.robot) as listener:
        expected = [] if robot else Expected(settings).matching(arguments.robot)
        sightings = Sightings(listener, settings.robot.root, expected)
        problem = _wait(sightings, robot, ending_after(ends, arguments.timeout, time.monotonic))
        if problem and not stopped():
            text = f"{problem} within {arguments.timeout:g} s at {place(settings.zenoh)}"
            raise CommandError(f"{text}{who_is_there(settings, robot)}", ExitCode.UNREACHABLE)
        console = Console()
        if arguments.json:
            show(sightings, lambda reports: _write(map(_json_line, reports)), LINE_S, ends)
        elif console.is_terminal and not console.is_dumb_terminal:
            _live(sightings, console, ends, is_one=bool(robot))
        else:
            show(sightings, lambda reports: _write(one.plain for one in view.list_view(reports)), LINE_S, ends)
    return int(ExitCode.OK)


def _wait(sightings: Sightings, robot: str, ends: Callable[[], bool]) -> str:
    """Wait for the robot, or for any Zenoh node if all are wanted. Returns what is missing, or ''."""
    while True:
        sightings.poll()
        connected = sightings.listener.connected()
        if connected and (not robot or sightings.reports()):
            return ""
        if ends():
            return f"robot {robot!r} did not appear" if connected else "no Zenoh node answered"
        time.sleep(POLL_S)


def show(sightings: Sightings, draw: Draw, every_s: float, ends: Callable[[], bool]) -> None:
    """Draw the reports at once and then periodically, until the end. Missed periods are skipped."""
    due_s = time.monotonic() + min(every_s, 2 * REFRESH_S)  # The first state is on its way.
    while not ends():
        sightings.poll()
        late_s = time.monotonic() - due_s
        if late_s >= 0:
            due_s += every_s * (1 + late_s // every_s)
            draw(sightings.reports())
        time.sleep(POLL_S)


def _live(sightings: Sightings, console: Console, ends: Callable[[], bool], *, is_one: bool) -> None:
    # Drawn from this thread, so that rich starts no other. On the terminal's other screen: neither a
    # window that changes its size nor the end of the view may leave old values that somebody reads as current.
    with Live(console=console, auto_refresh=False, screen=True) as live:

        def draw(reports: list[RobotStatus]) -> None:
            lines = view.detail_view(reports[0]) if is_one else view.list_view(reports)
            live.update(Group(*(lines or [Text("no robot is connected", style=view.BAD)])), refresh=True)

        show(sightings, draw, REFRESH_S, ends)


def _json_line(report: RobotStatus) -> str:
    return msgspec.json.encode({"time_ns": time.time_ns(), **msgspec.structs.asdict(report)}).decode()


def _write(lines: Iterable[str]) -> None:
    sys.stdout.writelines(f"{text}\n" for text in lines)
    sys.stdout.flush()
