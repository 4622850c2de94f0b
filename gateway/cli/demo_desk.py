"""``cruiser demo --desk``: a virtual fleet, a recorder and the desk in one command, and the browser on it."""

from __future__ import annotations

import argparse
import os
import re
import socket
import sys
import time
import webbrowser
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from gateway.cli.child import fresh
from gateway.cli.sim import whole
from gateway.cli.sim_fleet import POLL_S, ROBOTS_PER_PROCESSOR, VirtualFleet, warn_of_load
from gateway.cli.sim_patrol import Patrol
from schemas.arguments import ending_after
from schemas.exit_codes import CommandError, ExitCode
from schemas.listen_address import address, shown_address
from schemas.settings import DEFAULT_ENDPOINT, Settings
from schemas.zenoh_link import split_endpoint, with_port

HOST: Final = "127.0.0.1"
DESK_PORT: Final = 8080

ROBOTS: Final = min(12, (ROBOTS_PER_PROCESSOR - 2) * (os.cpu_count() or 1))
"""Some processor time is left for the desk, the recorder and the browser."""

ROBOTS_MOST: Final = 64

PATROLLING: Final = 2

OUT: Final = Path("demo-desk")


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Declare the flags that belong to ``--desk``."""
    parser.add_argument(
        "--robots",
        type=partial(whole, high=ROBOTS_MOST),
        default=ROBOTS,
        metavar="N",
        help="how many (default on this machine %(default)s)",
    )
    parser.add_argument(
        "--patrol",
        type=partial(whole, high=ROBOTS_MOST, low=0),
        default=PATROLLING,
        metavar="N",
        help="so many at a time drive by themselves, as operator 'patrol' (default %(default)s)",
    )
    parser.add_argument(
        "--browser", action=argparse.BooleanOptionalAction, default=True, help="open the browser, if there is one"
    )
    parser.add_argument(
        "--listen",
        type=address,
        metavar="ADDRESS:PORT",
        help=f"where the desk listens (127.0.0.1:{DESK_PORT}, or a free port if that is taken)",
    )
    parser.add_argument(
        "--endpoint",
        metavar="ENDPOINT",
        help=f"where the fleet meets ({DEFAULT_ENDPOINT}, or a free port if that is taken)",
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Run until it is stopped.

    Raises:
        CommandError: a part of it does not start, or ends by itself.
    """
    endpoint = arguments.endpoint or with_port(DEFAULT_ENDPOINT, _port(split_endpoint(DEFAULT_ENDPOINT)[2]))
    listen = shown_address(*(arguments.listen or (HOST, _port(DESK_PORT))))
    configuration = [] if arguments.config is None else ["--config", arguments.config]
    warn_of_load(arguments.robots)
    sys.stderr.write(f"demo: starts {arguments.robots} robots, a recorder and the desk\n")
    fleet = VirtualFleet(arguments.robots, endpoint, [], configuration)
    with fleet:
        directory = fresh(arguments.out or OUT)
        fleet.start("record", "-o", str(directory), "--connect", endpoint)
        desk = fleet.start("desk", "--listen", listen, "--connect", endpoint, "--logs", str(directory))
        page = re.search(r"http://\S+/", desk)
        if page is None:
            raise CommandError("the desk does not say where it is")
        connect = "" if endpoint == DEFAULT_ENDPOINT else f" --connect {endpoint}"
        sys.stdout.write(_RUNS.format(address=page[0], directory=directory, connect=connect))
        sys.stdout.flush()
        if arguments.browser:
            _open_browser(page[0])
        ends = ending_after(stopped, arguments.seconds, time.monotonic)
        with Patrol(fleet.robots, arguments.patrol, settings, endpoint):
            while not ends():
                fleet.tend(_tell)
                time.sleep(POLL_S)
        fleet.end()
    return int(ExitCode.OK)


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
