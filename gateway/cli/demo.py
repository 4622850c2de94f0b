"""``cruiser demo``: a robot, a recorder and two operators; with ``--desk`` several robots and the desk."""

from __future__ import annotations

import argparse
import json
import logging
import os
import re
import socket
import subprocess
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Self

import msgspec

from gateway.cli import parent
from gateway.cli.sim_fault import cause
from gateway.client.refusal import RobotError, Stopped, Unreachable, is_idle
from gateway.client.robot import Lease, Robot
from gateway.zenoh.client import open_local_router
from schemas.arguments import ending_after, seconds, whole_number
from schemas.command_line import CommandError, ExitCode, address, module_command, shown_address
from schemas.configuration import CONFIG_VARIABLE
from schemas.decisions import ArbiterState, SafetyState
from schemas.reasons import Reason
from schemas.settings import DEFAULT_ENDPOINT, Settings
from schemas.zenoh_session import close_session, split_endpoint, with_port

CHILD_READY_S: Final = 30.0
CHILD_END_S: Final = 20.0
CRUISER: Final = module_command("gateway")  # the command that runs the ``cruiser`` of this very installation


class Child:
    """A ``cruiser`` command in its own process. Its first line on stderr says that it is ready.

    Ends with this process, even on SIGKILL. ``environment`` is all of it; it need not name a settings file.
    """

    def __init__(self, name: str, words: Sequence[str], environment: Mapping[str, str] = os.environ) -> None:
        self._name = name
        watched, self._held = os.pipe()
        self._process = subprocess.Popen(  # noqa: S603 - our own command
            # Ctrl-C is for the demo, which ends its children in their order.
            [*CRUISER, name, *words],
            start_new_session=True,
            env={CONFIG_VARIABLE: "", **environment, parent.VARIABLE: str(watched)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            pass_fds=[watched],
        )
        os.close(watched)
        self._first = self._last = ""  # lines on stderr
        self._spoke = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        with self._process:
            self._thread.join()
        os.close(self._held)

    def wait_ready(self) -> str:
        if not self._spoke.wait(CHILD_READY_S):
            raise CommandError(f"{self._name} did not start in time")
        if not self._first.startswith(f"{self._name}: "):
            self._process.wait()
            self.check()
        return self._first

    @property
    def is_over(self) -> bool:
        return self._process.poll() is not None

    def check(self) -> None:
        """Raise CommandError with its last line if it has ended."""
        code = self._process.poll()
        if code is None:
            return
        self._thread.join()
        known = ExitCode(code) if 0 < code <= max(ExitCode) else ExitCode.FAILURE
        raise CommandError(self._last or f"{self._name} ended with {code}", known)

    def end(self) -> str:
        """Send SIGTERM, wait, and return its stdout."""
        self.check()
        self._process.terminate()
        try:
            self._process.wait(CHILD_END_S)
        except subprocess.TimeoutExpired as error:
            raise CommandError(f"{self._name} did not stop in time") from error
        # A recorder that dropped samples on a busy machine has a result all the same.
        if self._process.returncode not in {ExitCode.OK, ExitCode.PARTIAL}:
            self.check()
        return self._process.stdout.read() if self._process.stdout else ""

    def _listen(self) -> None:
        """Read its stderr; the first line, or the end, wakes ``wait_ready``."""
        for line in self._process.stderr or ():
            self._last = line.rstrip("\n")
            self._first = self._first or self._last
            self._spoke.set()
        self._spoke.set()


def fresh(directory: Path) -> Path:
    """Return the first of DIR, DIR-2, DIR-3 and so on that is empty or missing."""
    numbered = (directory.with_name(f"{directory.name}-{number}") for number in count(2))
    try:
        return next(path for path in chain([directory], numbered) if not path.exists() or not any(path.iterdir()))
    except OSError as error:
        raise CommandError(f"cannot write in {error.filename or directory}: {error.strerror}") from error


HOST: Final = "127.0.0.1"
DESK_PORT: Final = 8080

ROBOTS: Final = min(12, 3 * (os.cpu_count() or 1))
"""A robot takes an eighth of a processor at rest, and more while driven; desk and browser need the rest."""

ROBOTS_MOST: Final = 64

DESK_OUT: Final = Path("demo-desk")

POLL_S: Final = 0.2

STARTS_MAX: Final = 5  # a gateway that was started more often is not started again
ENDED_AT_ONCE: Final = 8  # processes that are ended at the same time


def add_desk_arguments(parser: argparse._ArgumentGroup) -> None:
    parser.add_argument(
        "--robots",
        type=whole_number(1, ROBOTS_MOST),
        default=ROBOTS,
        metavar="N",
        help="number of robots (default on this machine %(default)s)",
    )
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="no browser")
    parser.add_argument(
        "--listen",
        type=address,
        metavar="ADDRESS:PORT",
        help=f"address of the desk (default 127.0.0.1:{DESK_PORT}, or a free port)",
    )
    parser.add_argument(
        "--endpoint",
        metavar="ENDPOINT",
        help=f"Zenoh endpoint on this machine (default {DEFAULT_ENDPOINT}, or a free port)",
    )


def run_desk(arguments: argparse.Namespace, stopped: Callable[[], bool]) -> int:
    endpoint = arguments.endpoint or with_port(DEFAULT_ENDPOINT, _port(split_endpoint(DEFAULT_ENDPOINT)[2]))
    listen = shown_address(*(arguments.listen or (HOST, _port(DESK_PORT))))
    configuration = [] if arguments.config is None else ["--config", arguments.config]
    sys.stderr.write(f"demo: starting {arguments.robots} robots, a recorder and the desk\n")
    with ExitStack() as stack:
        stack.callback(close_session, open_local_router(endpoint))
        # A stop by the guard in another run latches none of these; one in this run does.
        state = Path(stack.enter_context(TemporaryDirectory(prefix="cruiser-")))
        meets = [*configuration, "--connect", endpoint]
        names = [f"cruiser-{number}" for number in range(1, arguments.robots + 1)]
        robots = [VirtualRobot(name, configuration, endpoint, state, stack) for name in names]
        for robot in robots:
            robot.start_gateway()
        for robot in robots:
            robot.gateway.wait_ready()
        directory = fresh(arguments.out or DESK_OUT)
        recorder = stack.enter_context(Child("record", ["-o", str(directory), *meets]))
        recorder.wait_ready()
        desk = stack.enter_context(Child("desk", ["--listen", listen, "--logs", str(directory), *meets]))
        page = re.search(r"http://\S+/", desk.wait_ready())
        if page is None:
            raise CommandError("the desk did not report its address")
        connect = "" if endpoint == DEFAULT_ENDPOINT else f" --connect {endpoint}"
        sys.stdout.write(_RUNS.format(address=page[0], directory=directory, connect=connect))
        sys.stdout.flush()
        if arguments.browser:
            _open_browser(page[0])
        ends = ending_after(stopped, arguments.seconds, time.monotonic)
        while not ends():
            for child in (recorder, desk):
                child.check()
            for robot in robots:
                robot.restart_dead_gateway()
            time.sleep(POLL_S)
        # The gateways before their chassis: a robot that moves is stopped first.
        for children in ([desk, recorder], [one.gateway for one in robots], [one.chassis for one in robots]):
            with ThreadPoolExecutor(ENDED_AT_ONCE) as pool:
                list(pool.map(Child.end, children))
    return int(ExitCode.OK)


class VirtualRobot:
    """A virtual chassis and its gateway, which is replaced if it dies."""

    def __init__(
        self, name: str, configuration: Sequence[str], endpoint: str, state: Path, stack: ExitStack
    ) -> None:
        self.chassis = stack.enter_context(Child("sim", [*configuration, "--listen", f"{HOST}:0"]))
        self._name = name
        self._words = [*configuration, "--robot", name, "--connect", endpoint]
        # It has no keys, and is reached through the router alone.
        own = {
            "ZENOH_MODE": "client",
            "ZENOH_CONFIG": "",
            "AUTHORITY_MODE": "open",
            "GATEWAY_STATE_DIR": str(state),
        }
        self._environment = os.environ | {f"CRUISER_{key}": text for key, text in own.items()}
        self._stack = stack
        self._starts = 0

    def start_gateway(self) -> None:
        self._starts += 1
        self.address = self.chassis.wait_ready().rpartition(" on ")[2]
        words = [*self._words, "--interface", "socketcand", "--channel", self.address]
        self.gateway = self._stack.enter_context(Child("gateway", words, self._environment))

    def restart_dead_gateway(self) -> None:
        self.chassis.check()
        if self.gateway.is_over:
            if self._starts > STARTS_MAX:
                self.gateway.check()
            sys.stdout.write(
                f"{self._name}: its gateway died. The guard stops the robot; starting another gateway\n"
            )
            sys.stdout.flush()
            self.start_gateway()


def _port(wanted: int) -> int:
    """Return this port of 127.0.0.1, or a free one if it is taken."""
    for port in (wanted, 0):
        try:
            with socket.create_server((HOST, port)) as probe:
                return int(probe.getsockname()[1])
        except OSError:
            continue
    raise CommandError("no free port on this machine")


def _open_browser(page: str) -> None:
    """Open the page if there is a screen or $BROWSER; a browser in the terminal would hide the demo."""
    if sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")):
        webbrowser.open(page)


_RUNS: Final = """\
the desk      {address}
              click a robot, Take control, hold the pad or an arrow key; Esc is STOP
the log       {directory}
in a terminal cruiser list{connect}; cruiser why cruiser-1{connect}
Ctrl-C ends everything
"""

_LOGGED: Final = """\
log: {path}
open it in Foxglove, Lichtblick, PlotJuggler or rerun, or review it:
  cruiser review events {directory}
  cruiser review report {directory}
"""

EXAMPLE: Final = """\
  cruiser demo --seconds 40 --out demo-log
  cruiser demo --desk
  cruiser demo --desk --robots 10"""

OUT: Final = Path("demo-log")

SHORTEST_S: Final = 20.0  # stops, a reset and a second operator take their time
LONGEST_S: Final = 86_400

FIXED_S: Final = 19.0  # the time of all but the figure of eight
FIRST, SECOND, OBSERVER = "first-operator", "second-operator", "demo"
SPEED_MPS, ANGLE_DEG = 1.0, 20.0

DEADMAN_S: Final = 0.8  # a busy machine may delay the operators this long
RENEWED_S: Final = 0.05
READY_TIMEOUT_S: Final = 10.0
REST_TIMEOUT_S: Final = 10.0
TRY_AGAIN_S: Final = 60.0  # time in which an interrupted act is repeated
SETTLED_TICKS: Final = 50


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds", type=seconds, metavar="N", help="duration (default 30, at least 20; with --desk until Ctrl-C)"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="DIR",
        help=f"directory of the log, or DIR-2 and so on if it is not empty (default {OUT}, or {DESK_OUT})",
    )
    parser.add_argument("--desk", action="store_true", help="virtual robots and the desk in the browser instead")
    add_desk_arguments(parser.add_argument_group("with --desk"))


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    if arguments.desk:
        return run_desk(arguments, stopped)
    length_s = 30.0 if arguments.seconds is None else arguments.seconds
    if not SHORTEST_S <= length_s <= LONGEST_S:
        raise CommandError(
            f"--seconds: must be from {SHORTEST_S:g} to {LONGEST_S:g}, not {length_s:g}", ExitCode.USAGE
        )
    if arguments.log_level == "warning":
        # The demo shows what the operators' library warns of.
        logging.getLogger("gateway.client").setLevel(logging.ERROR)
    directory = fresh(arguments.out or OUT)
    sys.stderr.write(
        f"demo: starting chassis, gateway and recorder; two operators drive for about {length_s:g} s; "
        f"log directory {directory}\n"
    )
    path = _record(arguments.config, settings, stopped, directory, length_s)
    sys.stdout.write(_LOGGED.format(path=path, directory=directory))
    return int(ExitCode.OK)


def _record(
    config: str | None, settings: Settings, stopped: Callable[[], bool], directory: Path, length_s: float
) -> Path:
    """Run chassis, gateway, recorder and operators; return the log."""
    endpoint = f"tcp/{HOST}:{_port(0)}"
    configuration = [] if config is None else ["--config", config]
    with ExitStack() as stack:
        stack.callback(close_session, open_local_router(endpoint))
        state = Path(stack.enter_context(TemporaryDirectory(prefix="cruiser-")))
        robot = VirtualRobot(settings.robot.name, configuration, endpoint, state, stack)
        robot.start_gateway()
        robot.gateway.wait_ready()
        words = [*configuration, "--connect", endpoint]
        keys = f"{settings.robot.root}/{settings.robot.name}/**"
        recorder = stack.enter_context(Child("record", ["-k", keys, "-o", str(directory), *words, "--json"]))
        recorder.wait_ready()
        problem: CommandError | None = None
        try:
            Play(settings, words, robot, recorder, stopped).run(length_s - FIXED_S)
        except CommandError as error:
            problem = error
        # The recorder ends first: the end of the others is not meant for the log.
        result: dict[str, Any] = json.loads(recorder.end())
        robot.gateway.end()
        robot.chassis.end()
    path = Path(result["path"] or directory)
    if problem is not None:
        raise CommandError(f"{problem}. The log: {path}", problem.code)
    return path


class Play:
    """Two operators who drive a robot through the arbiter's cases; prints what happens.

    ``words`` are the arguments with which a command reaches the robot; the last is its endpoint.
    """

    def __init__(
        self,
        settings: Settings,
        words: Sequence[str],
        robot: VirtualRobot,
        recorder: Child,
        stopped: Callable[[], bool],
    ) -> None:
        # A client, so that everything goes through this endpoint and nothing around it.
        own = {"mode": "client", "connect": [words[-1]], "given": ("mode", "connect")}
        self._settings = msgspec.structs.replace(settings, zenoh=msgspec.structs.replace(settings.zenoh, **own))
        self._words = words
        self._bus = robot.address
        self._children = [robot.chassis, robot.gateway, recorder]
        self._stopped = stopped
        self._begin_ns = time.time_ns()
        self._seen = self._connect(OBSERVER)

    def run(self, eight_s: float) -> None:
        with self._seen:
            try:
                self._act(FIRST, partial(self._eight, eight_s))
                self._act(FIRST, self._bump)
                self._act(FIRST, self._drive_away)
                self._vanish()
                self._act(SECOND, self._drive_on)
            finally:
                # A lease that is given back stops the robot. The events of that arrive before a later state.
                self._seen.wait_for(_is_left, REST_TIMEOUT_S)
                tick = self._seen.state().state.tick
                self._seen.wait_for(lambda state: state.tick > tick + SETTLED_TICKS, REST_TIMEOUT_S)
                self._show()

    def _eight(self, eight_s: float, lease: Lease) -> None:
        self._tell(FIRST, "drives a figure of eight")
        for angle_deg in (ANGLE_DEG, -ANGLE_DEG):
            self._drive(lease, SPEED_MPS, angle_deg, max(1.0, eight_s / 2))

    def _bump(self, lease: Lease) -> None:
        self._drive(lease, SPEED_MPS, 0.0, 2.0)
        self._tell("chassis", "front bumper hit, and still pressed")
        cause(self._bus, "bumper front on")
        try:
            self._drive(lease, SPEED_MPS, 0.0, REST_TIMEOUT_S)
        except Stopped as error:
            if error.reason is not Reason.FRONT_BUMPER:
                raise
            self._tell(FIRST, f"gets: {error}")
        else:
            raise CommandError("the robot did not stop")

    def _drive_away(self, lease: Lease) -> None:
        self._tell(FIRST, "drives away from the obstacle")
        self._drive(lease, -0.5, 0.0, 1.5)
        cause(self._bus, "bumper front off")

    def _vanish(self) -> None:
        """Kill ``cruiser drive`` while it drives."""
        self._tell(FIRST, "drives with 'cruiser drive'")
        words = [
            self._settings.robot.name,
            *self._words,
            "--operator",
            FIRST,
            "--speed",
            "-0.5",
            "--seconds",
            "60",
        ]
        with Child("drive", words) as drive:
            self._seen.wait_for(
                lambda state: self._stopped() or drive.is_over or state.output_speed_mps != 0, READY_TIMEOUT_S
            )
            self._go_on(1.0)
        self._tell(FIRST, "its process was killed")

    def _drive_on(self, lease: Lease) -> None:
        self._tell(SECOND, "drives on")
        self._drive(lease, 0.5, 0.0, 1.5)

    def _act(self, operator: str, act: Callable[[Lease], None]) -> None:
        """Let an operator drive; again if a busy machine interrupts."""
        end_s = time.monotonic() + TRY_AGAIN_S
        while True:
            try:
                # Where that is in vain, engage says why.
                self._seen.wait_for(lambda state: self._stopped() or _waits(state), READY_TIMEOUT_S)
                self._go_on(RENEWED_S)
                with self._connect(operator) as robot, robot.lease() as lease:
                    if robot.state().state.latched:
                        lease.reset()
                    lease.engage(deadman_s=DEADMAN_S)
                    lease.unpark()
                    act(lease)
                    # After a stop there is nothing to end.
                    if lease.is_engaged:
                        lease.disengage()
            except (RobotError, Unreachable) as error:
                if self._stopped() or time.monotonic() > end_s:
                    raise
                self._tell(operator, f"gets: {error}; tries again (busy machine)")
            else:
                return

    def _drive(self, lease: Lease, speed_mps: float, angle_deg: float, seconds: float) -> None:
        self._go_on(seconds, partial(lease.drive, speed_mps, angle_deg=angle_deg))

    def _go_on(self, seconds: float, renew: Callable[[], None] = lambda: None) -> None:
        """Wait, and print what happens."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            if self._stopped():
                raise CommandError("interrupted", ExitCode.PARTIAL)
            for child in self._children:
                child.check()
            renew()
            self._show()
            time.sleep(RENEWED_S)

    def _connect(self, operator: str) -> Robot:
        return Robot.connect(self._settings.robot.name, operator, self._settings)

    def _show(self) -> None:
        for event in self._seen.events():
            if event.time_ns >= self._begin_ns:
                self._print(event.time_ns, "robot", event.text)

    def _tell(self, who: str, what: str) -> None:
        self._show()
        self._print(time.time_ns(), who, what)

    def _print(self, time_ns: int, who: str, what: str) -> None:
        sys.stdout.write(f"{(time_ns - self._begin_ns) / 1e9:6.1f} s  {who:<15}  {what}\n")
        sys.stdout.flush()


def _waits(state: SafetyState) -> bool:
    """Return True if an operator can engage the robot, or something is latched."""
    is_free = not state.lease_holder and state.state is ArbiterState.STANDBY
    return is_free and (bool(state.latched) or (state.guarded and is_idle(state.blocked_by)))


def _is_left(state: SafetyState) -> bool:
    return state.state is ArbiterState.STANDBY and not state.lease_holder
