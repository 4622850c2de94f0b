"""``cruiser drive``: drive a robot with the keys of a terminal, or for a while from a script.

Hold to move: a terminal reports no release of a key, so a key counts as held while it repeats. Motion starts with
the first repeat, and ends soon after the last. A link that stalls delivers old key strokes in a burst: after a
pause or a burst a key must be released and pressed again.
"""

from __future__ import annotations

import argparse
import os
import re
import select
import sys
import termios
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, Self

import msgspec
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.text import Text

from gateway.choice.chassis import CHASSIS
from gateway.cli.operator_arguments import (
    add_robot_arguments,
    add_take_arguments,
    come_to_rest,
    connect,
    engaged,
    wanted_lease,
)
from gateway.client.fleet import BAD, GOOD, LOUD, NO_VALUE
from gateway.client.link import Sighting
from gateway.client.refusal import Refused, Stopped, link_line, reason_line, state_line
from gateway.client.robot import Lease, Robot
from schemas.arguments import number, seconds
from schemas.command_line import CommandError, ExitCode, plain
from schemas.decisions import ArbiterState
from schemas.reasons import Reason
from schemas.settings import DEADMAN_MAX_S, Settings

_READ_BYTES: Final = 1024


class Terminal:
    """A terminal without echo, lines and signals during the block; restored afterwards."""

    def __init__(self, read_from: int) -> None:
        self._in = read_from
        self._saved: list[Any] = []

    def __enter__(self) -> Self:
        self._saved = termios.tcgetattr(self._in)
        changed = termios.tcgetattr(self._in)
        # Ctrl-C is a key like the others: it stops the robot first. Ctrl-S shall not hold up what is drawn.
        changed[tty.LFLAG] &= ~(termios.ICANON | termios.ECHO | termios.ISIG | termios.IEXTEN)
        changed[tty.IFLAG] &= ~(termios.IXON | termios.ICRNL)
        changed[tty.CC][termios.VMIN], changed[tty.CC][termios.VTIME] = 0, 0
        termios.tcsetattr(self._in, termios.TCSADRAIN, changed)
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(termios.error):  # The terminal may have gone.
            # What was typed for the robot is no command for the shell.
            termios.tcsetattr(self._in, termios.TCSAFLUSH, self._saved)

    def read(self, timeout_s: float) -> bytes | None:
        """Return what was typed; b"" if nothing was in time; None once the terminal has gone."""
        try:
            if not select.select([self._in], [], [], timeout_s)[0]:
                return b""
            return os.read(self._in, _READ_BYTES) or None
        except OSError:
            return None


REPEAT_NS: Final = 200_000_000  # a key that repeats comes again within this time; slow keyboards take 90 ms
BEGIN_NS: Final = 800_000_000  # a held key starts to repeat within this time; keyboards wait for up to 660 ms
BEGIN_MIN_NS: Final = 150_000_000  # no keyboard begins to repeat sooner
BURST_STROKES: Final = (
    6  # more strokes of a key in one read were delayed: the fastest keyboards take 15 ms for each
)

LONGEST: Final = 64  # no sequence that a terminal sends is longer
_ESCAPE: Final = 0x1B
_SEQUENCE: Final = re.compile(rb"\x1b(?:\[[0-9:;<=>?]*[ -/]*([@-~])|O([A-Z]))")
_BEGUN: Final = re.compile(rb"\x1b(\[[0-9:;<=>?]*[ -/]*|O)?")
_ARROWS: Final = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}
_ARROW_BYTES: Final = 3  # a longer sequence is an arrow with Ctrl, Alt or Shift: another key
_CHARACTERS: Final = {0x03: "ctrl-c", 0x20: "space"}


class Wish(msgspec.Struct, frozen=True):
    """The requested motion, as fractions of the chosen speed and angle. Forward and left are positive."""

    forward: int = 0
    left: int = 0


NOTHING: Final = Wish()

BINDINGS: Final[dict[str, Wish]] = {
    "w": Wish(1, 0),
    "up": Wish(1, 0),
    "s": Wish(-1, 0),
    "down": Wish(-1, 0),
    "a": Wish(0, 1),
    "left": Wish(0, 1),
    "d": Wish(0, -1),
    "right": Wish(0, -1),
    "u": Wish(1, 1),
    "o": Wish(1, -1),
    "m": Wish(-1, 1),
    ".": Wish(-1, -1),
}
"""Keys that drive; any other key means zero speed. Curves are where ROS's teleop_twist_keyboard has them: a
terminal repeats only one key, so one key must give speed and angle.
"""


class KeyDecoder:
    """Decodes keys from bytes, in pieces of any size.

    A key is a lower-case letter, ``up``, ``space``, ``ctrl-c``; any other is ''.
    """

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the keys of these bytes. Without bytes, an unfinished sequence is a key (Escape)."""
        if not data:
            begun, self._rest = self._rest, b""
            return [""] if begun else []
        buffer, self._rest = self._rest + data, b""
        keys: list[str] = []
        while buffer:
            length = 1
            if buffer[0] != _ESCAPE:
                keys.append(_character(buffer[0]))
            elif (match := _SEQUENCE.match(buffer)) is not None:
                length = match.end()
                keys.append(_ARROWS.get(match[1] or match[2], "") if length == _ARROW_BYTES else "")
            elif len(buffer) < LONGEST and _BEGUN.fullmatch(buffer) is not None:
                self._rest = buffer
                break
            else:
                keys.append("")
            buffer = buffer[length:]
        return keys


class HeldKeys:
    """The key that is held."""

    def __init__(self) -> None:
        self._last = ""
        self._last_ns = 0
        self._is_press = False
        self._until_ns = 0

    def receive(self, keys: list[str], now_ns: int) -> list[str]:
        """Process keys that were read together. Returns those that do not drive."""
        pressed, strokes = "", 0
        for key in keys:
            if key in BINDINGS:
                strokes = strokes + 1 if key == pressed else 1
                pressed = key
            else:
                self.release_all()
                pressed = ""
        if pressed:
            self._repeat(pressed, strokes, now_ns)
        return [key for key in keys if key not in BINDINGS]

    def wish(self, now_ns: int) -> Wish:
        return BINDINGS[self._last] if self._last and now_ns < self._until_ns else NOTHING

    def release_all(self) -> None:
        """Forget the held key: it must be pressed again."""
        self._last = ""
        self._until_ns = 0

    def _repeat(self, key: str, strokes: int, now_ns: int) -> None:
        """Decide whether a key is held: a terminal does not say, but a held key repeats as keyboards do.

        A stroke after a silence is a press, the first repeat comes after a delay, the others without a pause.
        """
        same, since_ns = key == self._last, now_ns - self._last_ns
        goes_on = same and now_ns < self._until_ns
        begins = same and self._is_press and BEGIN_MIN_NS <= since_ns <= BEGIN_NS
        is_burst = strokes >= BURST_STROKES
        self._is_press = not (is_burst or goes_on or begins) and (since_ns > REPEAT_NS or not same)
        self._last, self._last_ns = key, now_ns
        self._until_ns = now_ns + REPEAT_NS if (goes_on or begins) and not is_burst else 0


def _character(code: int) -> str:
    if code in _CHARACTERS:
        return _CHARACTERS[code]
    return chr(code).lower() if 0x21 <= code < 0x7F else ""


class Cockpit(msgspec.Struct, frozen=True):
    """The values on the screen."""

    robot: str
    lease: int
    sighting: Sighting
    speed_mps: float
    angle_deg: float
    wish: Wish  # the motion that the held key asks for
    message: str


def panel(cockpit: Cockpit) -> RenderableType:
    state, chassis = cockpit.sighting.state, cockpit.sighting.chassis
    good = state.state is ArbiterState.ENGAGED
    lines = [Text(state_line(state), style=GOOD if good else BAD), Text(_speeds(cockpit))]
    link = link_line(state)
    if link:
        lines.append(Text(link))
    if chassis is not None:
        hit = [side for side, on in (("front", chassis.front_bumper), ("rear", chassis.rear_bumper)) if on]
        text = f"mode {chassis.mode.value}, gear {chassis.gear_position.value}, bumpers {' '.join(hit) or 'clear'}"
        lines.append(Text(text, style=BAD if hit else ""))
    lines += [Text(reason_line(reason, cockpit.robot, state.blocked_by), style=BAD) for reason in state.blocked_by]
    if cockpit.message:
        lines.append(Text(plain(cockpit.message), style=LOUD))
    lines += [Text(text, style="dim") for text in _keys(cockpit)]
    return Panel(Group(*lines), title=Text(f"{cockpit.robot}, lease {cockpit.lease}"), expand=False)


def _speeds(cockpit: Cockpit) -> str:
    state, chassis = cockpit.sighting.state, cockpit.sighting.chassis
    measured = NO_VALUE if chassis is None or chassis.speed_mps is None else f"{chassis.speed_mps:+z.2f} m/s"
    asked = (
        f"{cockpit.speed_mps * cockpit.wish.forward:+z.2f} m/s {cockpit.angle_deg * cockpit.wish.left:+z.0f} deg"
    )
    told = f"{state.output_speed_mps:+z.2f} m/s {state.output_angle_deg:+z.0f} deg"
    return f"requested {asked}, commanded {told}, measured {measured}, limit {state.speed_limit_mps:.2f} m/s"


def _keys(cockpit: Cockpit) -> list[str]:
    return [
        "hold to move (starts when the key repeats): w s or arrows, a d steer; any other key: zero speed",
        "curves: u o forward, m . backward, left and right",
        f"+ - speed ({cockpit.speed_mps:.2f} m/s)",
        "g engage, r reset; x, q or Ctrl-C: stop and quit",
    ]


EXAMPLE = """\
  cruiser drive cruiser-1                                     hold w s a d, arrows, u o m . (curves); x quits
  cruiser drive cruiser-1 --speed 0.3 --angle 10 --seconds 5  for scripts; negative speeds are backward"""

SPEED_MPS: Final = 0.4
ANGLE_DEG: Final = 15.0
SPEED_STEP_MPS: Final = 0.1

KEY_S: Final = 0.02  # the period in which keys are read, and the set point renewed
KEY_HOLD_S: Final = 0.3  # a terminal that blocks our output keeps the robot moving no longer than this

DRAW_S: Final = 0.1

SCRIPT_S: Final = 0.05  # the period in which a script's set point is renewed
_LEAVE: Final = frozenset({"q", "x", "ctrl-c"})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        f"{parser.description or ''}\n\n"
        "The robot moves while a key repeats. Motion starts with the first repeat, half a second after the\n"
        f"press. Zero speed is commanded {REPEAT_NS / 1e9:g} s after the last repeat. Any other key, a closed\n"
        "terminal and a lost link stop the robot. 'cruiser desk' steers more smoothly."
    )
    add_robot_arguments(parser)
    parser.add_argument(
        "--speed",
        type=number(-CHASSIS.top_speed_mps, CHASSIS.top_speed_mps, "a speed in m/s"),
        metavar="M/S",
        help=f"speed, negative is backward (default {SPEED_MPS:g} with keys)",
    )
    parser.add_argument(
        "--angle",
        type=number(-CHASSIS.top_angle_deg, CHASSIS.top_angle_deg, "an angle in degrees"),
        metavar="DEG",
        help=f"steering angle, positive is left (default {ANGLE_DEG:g} with keys, 0 otherwise)",
    )
    parser.add_argument("--seconds", type=seconds, metavar="S", help="duration of a drive without a terminal")
    parser.add_argument(
        "--deadman",
        type=_deadman,
        metavar="S",
        help=f"command timeout, at most {DEADMAN_MAX_S:g}: longer for a link that stalls; lowers the speed limit",
    )
    add_take_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Drive. Exit code 1 if the robot was stopped or did not move; 3 if a script's drive ended early."""
    by_script = arguments.seconds is not None
    if by_script and arguments.speed is None:
        raise CommandError("--seconds needs --speed", ExitCode.USAGE)
    if not by_script and not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise CommandError(
            "no terminal to read keys from; for scripts: --speed, --angle, --seconds", ExitCode.USAGE
        )
    with connect(arguments, settings, stopped) as robot, wanted_lease(robot, arguments) as lease:
        if by_script:
            return int(_by_script(robot, lease, arguments, stopped))
        _Keys(robot, lease, arguments).drive(stopped)
    sys.stdout.write(f"{robot.name}: stopped and on standby; lease released\n")
    return int(ExitCode.OK)


def _by_script(robot: Robot, lease: Lease, arguments: argparse.Namespace, stopped: Callable[[], bool]) -> ExitCode:
    fastest_mps = 0.0
    blocked_by: list[Reason] = []
    link = ""
    with engaged(lease, robot, arguments.deadman):
        lease.unpark()
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
    sys.stdout.write(f"{robot.name}: driven for {took_s:.3g} s, top speed {fastest_mps:.2f} m/s\n")
    if link:
        sys.stdout.write(f"  {link}\n")
    if is_early:
        sys.stderr.write(f"{robot.name}: ended before {arguments.seconds:g} s were over\n")
        return ExitCode.PARTIAL
    return ExitCode.OK


class _Keys:
    """A drive with the keyboard."""

    def __init__(self, robot: Robot, lease: Lease, arguments: argparse.Namespace) -> None:
        self._robot = robot
        self._lease = lease
        self._speed_mps = abs(SPEED_MPS if arguments.speed is None else arguments.speed)
        self._angle_deg = abs(ANGLE_DEG if arguments.angle is None else arguments.angle)
        self._deadman_s = arguments.deadman
        self._decoder = KeyDecoder()
        self._keys = HeldKeys()
        self._message = ""
        self._is_leaving = False

    def drive(self, stopped: Callable[[], bool]) -> None:
        """Drive until the user quits, and bring the robot to rest."""
        # On the alternate screen, so that no outdated view stays in the terminal.
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
        for key in self._keys.receive(self._decoder.feed(data), time.monotonic_ns()):
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
            self._speed_mps = round(min(CHASSIS.top_speed_mps, max(SPEED_STEP_MPS, self._speed_mps + step_mps)), 3)

    def _engage(self) -> None:
        try:
            self._lease.engage(deadman_s=self._deadman_s, wait=False)
            self._lease.unpark()
            self._message = ""
        except (Refused, Stopped) as error:
            self._message = str(error)
        self._keys.release_all()

    def _reset(self) -> None:
        try:
            # The names are on the screen.
            of = next((name for name in self._robot.state().state.stopped_by if name != self._robot.operator), "")
            self._message = (
                f"reset: {self._lease.reset(of, wait=False) or 'nothing was latched'}; press g to engage"
            )
        except Refused as error:
            self._message = str(error)
        self._keys.release_all()

    def _move(self) -> None:
        wish = self._keys.wish(time.monotonic_ns())
        try:
            self._lease.check()
            if self._lease.is_engaged:
                speed_mps, angle_deg = self._speed_mps * wish.forward, self._angle_deg * wish.left
                self._lease.drive(speed_mps, angle_deg=angle_deg, hold_s=KEY_HOLD_S)
        except Stopped as error:
            self._message = str(error)
            self._keys.release_all()

    def _cockpit(self) -> Cockpit:
        return Cockpit(
            robot=self._robot.name,
            lease=self._lease.number,
            sighting=self._robot.state(),
            speed_mps=self._speed_mps,
            angle_deg=self._angle_deg,
            wish=self._keys.wish(time.monotonic_ns()),
            message=self._message,
        )


def _deadman(text: str) -> float:
    value = seconds(text)
    if value > DEADMAN_MAX_S:
        raise argparse.ArgumentTypeError(f"{text} s is longer than the maximum timeout, {DEADMAN_MAX_S:g} s")
    return value
