"""``cruiser drive``: drive a robot with the keys of a terminal, or for a while from a script."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator
from typing import Final

from rich.console import Console
from rich.live import Live

from gateway.cli.drive_view import Cockpit, panel
from gateway.cli.engaged import come_to_rest, engaged
from gateway.cli.held_keys import BINDINGS, REPEAT_NS, HeldKeys, KeyDecoder, Wish
from gateway.cli.operator_arguments import add_robot_arguments, add_take_arguments, connect, wanted_lease
from gateway.cli.terminal import Terminal
from gateway.client.reasons_text import link_line, reason_line
from gateway.client.refusal import Refused, Stopped
from gateway.client.robot import Lease, Robot
from schemas.arguments import seconds
from schemas.command_line import CommandError, ExitCode
from schemas.cruiser import SPEED_TOP_MPS, STEERING_TOP_DEG
from schemas.decisions import SafetyState
from schemas.reasons import Reason
from schemas.settings import DEADMAN_MAX_S, Settings

EXAMPLE = """\
  cruiser drive cruiser-1                                     hold w s a d, arrows, u o m . (curves); x leaves
  cruiser drive cruiser-1 --speed 0.3 --angle 10 --seconds 5  for scripts; negative speeds are backward"""

SPEED_MPS: Final = 0.4
ANGLE_DEG: Final = 15.0
SPEED_STEP_MPS: Final = 0.1

KEY_S: Final = 0.02
"""The period in which keys are read, and the set point renewed."""

KEY_HOLD_S: Final = 0.3
"""A terminal that takes no output, and holds us up, does not keep the robot moving for longer."""

DRAW_S: Final = 0.1

FIRST_KEY: Final = (
    "no terminal reports that a key is let go: motion begins when the key repeats, and ends "
    f"{REPEAT_NS / 1e9:g} s after the last repeat. To hold and steer freely: cruiser desk"
)

SCRIPT_S: Final = 0.05
"""The period in which a script's set point is renewed."""

_LEAVE: Final = frozenset({"q", "x", "ctrl-c"})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.description = (
        f"{parser.description or ''}\n\n"
        "The robot moves while a key repeats: motion begins with the first repeat, half a second after the key\n"
        f"was pressed, and zero speed is commanded {REPEAT_NS / 1e9:g} s after the last. It stops on\n"
        "any other key, and when the terminal is closed, or this program or its link ends. To hold and steer\n"
        "freely: cruiser desk."
    )
    add_robot_arguments(parser)
    parser.add_argument(
        "--speed", type=_speed, metavar="M/S", help=f"backward if negative ({SPEED_MPS:g} with keys)"
    )
    parser.add_argument(
        "--angle",
        type=_angle,
        metavar="DEG",
        help=f"left is positive ({ANGLE_DEG:g} with keys, 0 else)",
    )
    parser.add_argument("--seconds", type=seconds, metavar="S", help="drive for this time, without a terminal")
    parser.add_argument(
        "--deadman",
        type=_deadman,
        metavar="S",
        help=f"stop no sooner than after S without a command, at most {DEADMAN_MAX_S:g}: for a link that stalls; "
        "the robot drives the slower for it",
    )
    add_take_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Drive. Exit code 1 if the robot was stopped, or did not move; 3 if a script's drive was ended early.

    Raises:
        CommandError: it is refused, is stopped, does not come to rest, or does not answer.
    """
    by_script = arguments.seconds is not None
    if by_script and arguments.speed is None:
        raise CommandError("--seconds wants --speed too", ExitCode.USAGE)
    if not by_script and not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise CommandError(
            "no terminal to read keys from; for scripts: --speed, --angle, --seconds", ExitCode.USAGE
        )
    with connect(arguments, settings, stopped) as robot, wanted_lease(robot, arguments) as lease:
        if by_script:
            return int(_by_script(robot, lease, arguments, stopped))
        _Keys(robot, lease, arguments).drive(stopped)
    sys.stdout.write(f"{robot.name}: left; it stands by, and the lease is given back\n")
    return int(ExitCode.OK)


def _by_script(robot: Robot, lease: Lease, arguments: argparse.Namespace, stopped: Callable[[], bool]) -> ExitCode:
    fastest_mps = 0.0
    blocked_by: list[Reason] = []
    link = ""
    with engaged(lease, robot, arguments.deadman):
        lease.unpark()
        sys.stderr.writelines(f"{robot.name}: {text}\n" for text in _bounds(arguments, robot.state().state))
        begun_s = time.monotonic()
        while not (is_early := stopped()) and time.monotonic() < begun_s + arguments.seconds:
            lease.drive(arguments.speed, angle_deg=arguments.angle or 0.0)
            time.sleep(SCRIPT_S)
            state = robot.state().state
            fastest_mps = max(fastest_mps, abs(state.output_speed_mps))
            blocked_by = state.blocked_by
            link = link_line(state) or link
        took_s = time.monotonic() - begun_s if is_early else arguments.seconds
    if arguments.speed and not fastest_mps:
        sys.stderr.write(f"{robot.name} did not move\n")
        sys.stderr.writelines(f"  {reason_line(reason, robot.name, blocked_by)}\n" for reason in blocked_by)
        return ExitCode.FAILURE
    sys.stdout.write(f"{robot.name}: driven for {took_s:.3g} s, at most {fastest_mps:.2f} m/s\n")
    if link:
        sys.stdout.write(f"  {link}\n")
    if is_early:
        sys.stderr.write(f"{robot.name}: ended early, of {arguments.seconds:g} s\n")
        return ExitCode.PARTIAL
    return ExitCode.OK


def _bounds(arguments: argparse.Namespace, state: SafetyState) -> Iterator[str]:
    """Yield a line for each of a script's speed and angle that the limits in force reduce."""
    wanted = (
        (arguments.speed, state.speed_limit_mps, "m/s"),
        (arguments.angle or 0.0, state.steering_limit_deg, "deg"),
    )
    for value, limit, unit in wanted:
        if abs(value) > limit:
            yield f"of {value:g} {unit} the limit in force leaves {math.copysign(limit, value):g} {unit}"


class _Keys:
    """A drive by keys."""

    def __init__(self, robot: Robot, lease: Lease, arguments: argparse.Namespace) -> None:
        self._robot = robot
        self._lease = lease
        self._speed_mps = abs(SPEED_MPS if arguments.speed is None else arguments.speed)
        self._angle_deg = abs(ANGLE_DEG if arguments.angle is None else arguments.angle)
        self._deadman_s = arguments.deadman
        self._decoder = KeyDecoder()
        self._keys = HeldKeys()
        self._message = ""
        self._was_told = False
        self._is_leaving = False

    def drive(self, stopped: Callable[[], bool]) -> None:
        """Drive until the person leaves, and bring the robot to rest.

        Raises:
            CommandError: the lease is lost, the robot is not heard any more, or was not seen to come to rest.
        """
        # On the other screen, as in 'cruiser watch': nobody reads an old view as the present one.
        with (
            Live(console=Console(), auto_refresh=False, screen=True) as live,
            Terminal(sys.stdin.fileno()) as terminal,
        ):
            self._engage()
            draw_s = 0.0
            while not self._is_leaving and not stopped():
                self._hear(terminal.read(KEY_S))
                self._move()
                now_s = time.monotonic()
                if now_s >= draw_s:
                    draw_s = now_s + DRAW_S
                    live.update(panel(self._cockpit()), refresh=True)
        come_to_rest(self._lease, self._robot)

    def _hear(self, data: bytes | None) -> None:
        if data is None:
            self._is_leaving = True
            return
        keys = self._decoder.feed(data)
        if not self._was_told and not BINDINGS.keys().isdisjoint(keys):
            self._was_told, self._message = True, FIRST_KEY
        for key in self._keys.receive(keys, time.monotonic_ns()):
            self._press(key)

    def _press(self, key: str) -> None:
        if key in _LEAVE:
            self._is_leaving = True
        elif key == "g":
            self._engage()
        elif key == "r":
            self._reset()
        elif key in {"+", "-"}:
            step_mps = SPEED_STEP_MPS if key == "+" else -SPEED_STEP_MPS
            self._speed_mps = round(min(SPEED_TOP_MPS, max(SPEED_STEP_MPS, self._speed_mps + step_mps)), 3)

    def _engage(self) -> None:
        try:
            self._lease.engage(deadman_s=self._deadman_s, wait=False)
            self._lease.unpark()
            self._message = ""
        except (Refused, Stopped) as error:
            self._message = error.line
        self._keys.release_all()

    def _reset(self) -> None:
        try:
            # Whoever presses the key has the names before them.
            of = next((name for name in self._robot.state().state.stopped_by if name != self._robot.operator), "")
            self._message = f"reset: {self._lease.reset(of, wait=False) or 'nothing was latched'}; g engages"
        except Refused as error:
            self._message = error.line
        self._keys.release_all()

    def _move(self) -> None:
        wish = self._wish()
        try:
            self._lease.check()
            if self._lease.is_engaged:
                speed_mps, angle_deg = self._speed_mps * wish.forward, self._angle_deg * wish.left
                self._lease.drive(speed_mps, angle_deg=angle_deg, hold_s=KEY_HOLD_S)
        except Stopped as error:
            self._message = error.line
            self._keys.release_all()

    def _wish(self) -> Wish:
        return self._keys.wish(time.monotonic_ns())

    def _cockpit(self) -> Cockpit:
        return Cockpit(
            robot=self._robot.name,
            lease=self._lease.number,
            sighting=self._robot.state(),
            speed_mps=self._speed_mps,
            angle_deg=self._angle_deg,
            wish=self._wish(),
            message=self._message,
        )


def _deadman(text: str) -> float:
    value = seconds(text)
    if value > DEADMAN_MAX_S:
        raise argparse.ArgumentTypeError(f"{text} s is longer than a deadman may be, {DEADMAN_MAX_S:g} s")
    return value


def _speed(text: str) -> float:
    return _number(text, SPEED_TOP_MPS, "m/s")


def _angle(text: str) -> float:
    return _number(text, STEERING_TOP_DEG, "deg")


def _number(text: str, top: float, unit: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    if abs(value) > top:
        raise argparse.ArgumentTypeError(f"{text} {unit} is more than the chassis can do, {top:g} {unit}")
    return value
