"""``cruiser list``: all robots, including lost ones: state, speed, driver, health, and what needs attention."""

from __future__ import annotations

import argparse
import contextlib
import fnmatch
import logging
import os
import re
import sys
import time
from collections.abc import Callable, Iterable
from typing import Final

import msgspec

from gateway.client import fleet
from gateway.client.fleet import Fleet, RobotStatus
from gateway.client.remote_stop import RollCall
from gateway.host.notes import state_directory, write_whole
from gateway.telemetry.samples import TokenChange
from gateway.zenoh.client import RobotListener
from schemas import keys
from schemas.arguments import add_zenoh_arguments, robot_names, seconds
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings
from schemas.zenoh_session import place

EXAMPLE = """\
  cruiser list
  cruiser list 'cruiser-1*'
  cruiser list --forget cruiser-3                 remove it from the list
  cruiser list --json --connect tcp/10.0.0.5:7447 | jq -r .robot"""

log = logging.getLogger(__name__)

SEEN_KEPT: Final = 1000  # remembered robots per network
NAMED_MAX: Final = 8  # lost robots named on stderr; all are in the list
ARBITER_S: Final = 0.2  # wait for an arbiter's state after the chassis's
POLL_S: Final = 0.02  # the period in which arrivals are taken from Zenoh


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "robots",
        nargs="?",
        default=keys.ALL,
        type=robot_names,
        metavar="ROBOT",
        help="robot, or several, as in 'cruiser-1*' (default: all)",
    )
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=3.0,
        metavar="S",
        help="time to wait for robots and their health (default 3)",
    )
    parser.add_argument(
        "--forget", type=robot_names, metavar="ROBOT", help="lost robot to remove from the list; '*' for several"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per robot and line")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """List the robots. Exit code 1 if there are none, 3 if one is lost or the list may be incomplete."""
    where = place(settings.zenoh)
    expected = Expected(settings)
    if arguments.forget:
        expected.forget(arguments.forget)
    with RobotListener.open(settings, arguments.robots) as listener:
        search = _Search(listener, settings.robot.root, expected.matching(arguments.robots))
        reports = search.run(time.monotonic() + arguments.timeout, stopped)
    if stopped():
        # Robots that have not answered yet may not be silent.
        raise KeyboardInterrupt
    if not search.linked:
        text = f"no Zenoh node answered within {arguments.timeout:g} s at {where}"
        raise CommandError(text, ExitCode.UNREACHABLE)
    if not reports and not search.is_complete:
        text = f"the Zenoh node at {where} did not list its robots within {arguments.timeout:g} s"
        raise CommandError(text, ExitCode.UNREACHABLE)
    shown = (line.plain for line in fleet.list_view(reports))
    lines = (msgspec.json.encode(one).decode() for one in reports) if arguments.json else shown
    sys.stdout.writelines(f"{line}\n" for line in lines)
    sys.stdout.flush()
    expected.keep(report.robot for report in reports if report.state is not None)
    if not reports:
        called = f" called {arguments.robots}" if arguments.robots != keys.ALL else ""
        sys.stderr.write(f"no robot{called} is connected at {where}\n")
        return int(ExitCode.FAILURE)
    lost = [report.robot for report in reports if report.state is None]
    if lost:
        more = f" and {len(lost) - NAMED_MAX} more" if len(lost) > NAMED_MAX else ""
        cure = "look at it, it may be moving; if it was removed: 'cruiser list --forget ROBOT'"
        sys.stderr.write(f"no contact with {', '.join(lost[:NAMED_MAX])}{more}: {cure}\n")
    if not search.is_complete:
        sys.stderr.write(
            f"there may be more robots: not every node answered within {arguments.timeout:g} s at {where}\n"
        )
    return int(ExitCode.OK if search.is_complete and not lost else ExitCode.PARTIAL)


class Expected:
    """The robots that were seen before on this network: a missing one is listed as lost."""

    def __init__(self, settings: Settings) -> None:
        directory = state_directory(settings.gateway.state_dir, os.environ)
        self._file = None if directory is None else directory / "seen.json"
        self._place = f"{settings.robot.root} at {place(settings.zenoh)}"
        self._seen: dict[str, list[str]] = {}
        if self._file is not None:
            with contextlib.suppress(OSError, msgspec.DecodeError, msgspec.ValidationError):
                self._seen = msgspec.json.decode(self._file.read_bytes(), type=dict[str, list[str]])

    @property
    def _here(self) -> list[str]:
        return [robot for robot in self._seen.get(self._place, []) if re.fullmatch(keys.ROBOT_PATTERN, robot)]

    def matching(self, names: str) -> list[str]:
        return fnmatch.filter(self._here, names)

    def keep(self, seen: Iterable[str]) -> None:
        """Add robots; beyond ``SEEN_KEPT`` the oldest go."""
        now = sorted(seen)
        self._write([*(robot for robot in self._here if robot not in now), *now])

    def forget(self, names: str) -> None:
        self._write([robot for robot in self._here if not fnmatch.fnmatchcase(robot, names)])

    def _write(self, robots: list[str]) -> None:
        if self._file is None or robots == self._here:
            return
        self._seen[self._place] = robots[-SEEN_KEPT:]
        try:
            write_whole(self._file, msgspec.json.encode(self._seen))
        except OSError as error:
            log.info("the list of known robots was not saved: %s", error)


class Sightings:
    """The robots that a listener sees, and those that are expected."""

    def __init__(self, listener: RobotListener, root: str, expected: Iterable[str]) -> None:
        self.listener = listener
        self.fleet = Fleet(root)
        self._expected = expected

    def poll(self) -> None:
        now_ns = time.monotonic_ns()
        self.fleet.linked = self.listener.connected()
        for arrival in self.listener.drain():
            self.fleet.receive(arrival, now_ns)

    def reports(self) -> list[RobotStatus]:
        now_ns = time.monotonic_ns()
        names = {*self.fleet.robots.names(now_ns), *self._expected}
        return [self.fleet.report(robot, now_ns) for robot in sorted(names, key=keys.in_order)]


class _Search:
    """Waits until all robots have sent state and health, and no other appears."""

    def __init__(self, listener: RobotListener, root: str, expected: Iterable[str]) -> None:
        self.linked = False
        self._whole_s: float | None = None
        self._root = root
        self._sightings = Sightings(listener, root, expected)
        self._roll = RollCall(listener, root)

    @property
    def is_complete(self) -> bool:
        """All connected nodes have listed their robots."""
        return self._roll.is_answered

    def run(self, deadline_s: float, stopped: Callable[[], bool]) -> list[RobotStatus]:
        while not stopped() and (now_s := time.monotonic()) < deadline_s and not self._step(now_s):
            time.sleep(POLL_S)
        return self._sightings.reports()

    def _step(self, now_s: float) -> bool:
        """Process arrivals. Return True if there is nothing more to wait for."""
        self._sightings.poll()
        for robot in self._roll.step(now_s):
            change = TokenChange(keys.liveliness(self._root, robot), present=True)
            self._sightings.fleet.receive(change, time.monotonic_ns())
        self.linked = self.linked or bool(self._sightings.listener.links())
        reports = self._sightings.reports()
        if not (self._roll.is_complete(now_s) and all(report.health and report.state for report in reports)):
            self._whole_s = None
            return False
        # An arbiter's state comes in the same tick.
        self._whole_s = self._whole_s or now_s
        return all(report.safety for report in reports) or now_s - self._whole_s > ARBITER_S
