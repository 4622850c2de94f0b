"""``cruiser demo --desk``: virtual robots, a recorder and the desk in one command, and the browser on it."""

from __future__ import annotations

import argparse
import os
import re
import socket
import sys
import time
import webbrowser
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from gateway.cli.child import Child, address_of, fresh
from gateway.host.stop_note import StopNote
from gateway.zenoh.router import open_local_router
from schemas.arguments import ending_after
from schemas.command_line import CommandError, ExitCode, address, shown_address
from schemas.settings import DEFAULT_ENDPOINT
from schemas.zenoh_session import close_session, split_endpoint, with_port

HOST: Final = "127.0.0.1"
DESK_PORT: Final = 8080

ROBOTS: Final = min(12, 3 * (os.cpu_count() or 1))
"""A chassis, its gateway and its guard take an eighth of a processor at rest, and more while it is driven. The
desk, the recorder and the browser need the rest."""

ROBOTS_MOST: Final = 64

OUT: Final = Path("demo-desk")

POLL_S: Final = 0.2

BEGUN_MAX: Final = 5
"""A gateway that died so often is started no more."""

ENDED_AT_ONCE: Final = 8
"""Processes that are ended at the same time."""


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Declare the flags that belong to ``--desk``."""
    parser.add_argument(
        "--robots",
        type=partial(_whole, high=ROBOTS_MOST),
        default=ROBOTS,
        metavar="N",
        help="how many (default on this machine %(default)s)",
    )
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="open no browser")
    parser.add_argument(
        "--listen",
        type=address,
        metavar="ADDRESS:PORT",
        help=f"where the desk listens (127.0.0.1:{DESK_PORT}, or a free port if that is taken)",
    )
    parser.add_argument(
        "--endpoint",
        metavar="ENDPOINT",
        help=f"where the robots meet, on this machine alone ({DEFAULT_ENDPOINT}, or a free port if that is taken)",
    )


def run(arguments: argparse.Namespace, stopped: Callable[[], bool]) -> int:
    """Run until it is stopped.

    Raises:
        CommandError: a part of it does not start, or ends by itself.
    """
    endpoint = arguments.endpoint or with_port(DEFAULT_ENDPOINT, _port(split_endpoint(DEFAULT_ENDPOINT)[2]))
    listen = shown_address(*(arguments.listen or (HOST, _port(DESK_PORT))))
    configuration = [] if arguments.config is None else ["--config", arguments.config]
    sys.stderr.write(f"demo: starts {arguments.robots} robots, a recorder and the desk\n")
    with ExitStack() as stack:
        stack.callback(close_session, open_local_router(endpoint))
        # A stop by the guard in another run latches none of these; one in this run does.
        state = Path(stack.enter_context(TemporaryDirectory(prefix="cruiser-")))
        meets = [*configuration, "--connect", endpoint]
        names = [f"cruiser-{number}" for number in range(1, arguments.robots + 1)]
        robots = [VirtualRobot(name, configuration, endpoint, state, stack) for name in names]
        for robot in robots:
            robot.begin()
        for robot in robots:
            robot.gateway.wait_ready()
        directory = fresh(arguments.out or OUT)
        recorder = stack.enter_context(Child("record", ["-o", str(directory), *meets]))
        recorder.wait_ready()
        desk = stack.enter_context(Child("desk", ["--listen", listen, "--logs", str(directory), *meets]))
        page = re.search(r"http://\S+/", desk.wait_ready())
        if page is None:
            raise CommandError("the desk does not say where it is")
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
                robot.tend(_tell)
            time.sleep(POLL_S)
        # The gateways before their chassis: a robot that moves is stopped first.
        for children in ([desk, recorder], [one.gateway for one in robots], [one.chassis for one in robots]):
            with ThreadPoolExecutor(ENDED_AT_ONCE) as pool:
                list(pool.map(Child.end, children))
    return int(ExitCode.OK)


class VirtualRobot:
    """A chassis and its gateway, with its guard. Another gateway takes the place of one that died.

    Args:
        name: of the robot.
        configuration: words that name the configuration.
        endpoint: where it is met.
        state: the directory of what outlives its gateway.
        stack: ends its processes.
    """

    def __init__(
        self, name: str, configuration: Sequence[str], endpoint: str, state: Path, stack: ExitStack
    ) -> None:
        self.chassis = stack.enter_context(Child("sim", [*configuration, "--listen", f"{HOST}:0"]))
        self._name = name
        self._words = [*configuration, "--robot", name, "--connect", endpoint]
        # It has no keys, and is met at the router alone.
        own = {
            "ZENOH_MODE": "client",
            "ZENOH_CONFIG": "",
            "AUTHORITY_MODE": "open",
            "GATEWAY_STATE_DIR": str(state),
        }
        self._environment = os.environ | {f"CRUISER_{key}": text for key, text in own.items()}
        self._state = state
        self._stack = stack
        self._begun = 0
        self._noted = ""

    def begin(self) -> None:
        """Start its gateway."""
        self._begun += 1
        words = [*self._words, "--interface", "socketcand", "--channel", address_of(self.chassis)]
        self.gateway = self._stack.enter_context(Child("gateway", words, environment=self._environment))

    def tend(self, tell: Callable[[str], None]) -> None:
        """Start another gateway where one has died, and tell of it, and of the guard's work.

        Raises:
            CommandError: the chassis has ended, or the gateway dies again and again.
        """
        self.chassis.check()
        if self.gateway.is_over:
            if self._begun > BEGUN_MAX:
                self.gateway.check()
            tell(f"{self._name}: its gateway has died. Its guard stops the robot; another gateway starts")
            self.begin()
        for path in self._state.glob(f"*.{self._name}.guard-stop"):
            line = StopNote(path).last()
            if line is not None and line[1] != self._noted:
                self._noted = line[1]
                tell(f"{self._name}: {line[1]}")


def _tell(line: str) -> None:
    sys.stdout.write(f"{time.strftime('%H:%M:%S')}  {line}\n")
    sys.stdout.flush()


def _port(wanted: int) -> int:
    """This port of 127.0.0.1, or a free one where it is taken."""
    for port in (wanted, 0):
        try:
            with socket.create_server((HOST, port)) as probe:
                return int(probe.getsockname()[1])
        except OSError:
            continue
    raise CommandError("this machine has no free port")


def _whole(text: str, high: int) -> int:
    if not text.isascii() or not text.isdigit() or not 1 <= int(text) <= high:
        raise argparse.ArgumentTypeError(f"{text!a} is no whole number from 1 to {high}")
    return int(text)


def _open_browser(page: str) -> None:
    """Open the page where there is a screen, or a browser was chosen: one in the terminal would hide the demo."""
    if sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")):
        webbrowser.open(page)


_RUNS: Final = """\
the desk      {address}
              click a robot, Take control, hold the pad or an arrow key; STOP is Esc
the log       {directory}
the terminal  cruiser list{connect}; cruiser why cruiser-1{connect}
Ctrl-C ends all of it
"""
