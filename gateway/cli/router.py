"""``cruiser router``: a Zenoh router that lets each role publish and receive only its own keys."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from gateway.cli.shut_out import check_session_files
from gateway.zenoh.client import open_router
from schemas.arguments import ending_after, seconds
from schemas.authority.key_files import directory_of
from schemas.command_line import CommandError, ExitCode, plain
from schemas.settings import Settings
from schemas.zenoh_session import close_session

EXAMPLE: Final = """\
  cruiser router
  cruiser router --zenoh-config router.json5 --listen tls/0.0.0.0:7447
  zenohd -c ~/.config/cruiser/router.json5         the same, with Zenoh's own router"""

FILE: Final = "router.json5"

POLL_S: Final = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--zenoh-config",
        dest="zenoh.config",
        metavar="FILE",
        help=f"Zenoh file (default: {FILE} in the directory, made by 'cruiser provision')",
    )
    parser.add_argument(
        "--directory",
        dest="authority.directory",
        metavar="DIR",
        help="directory of keys and certificates (default ~/.config/cruiser)",
    )
    parser.add_argument(
        "--listen", dest="zenoh.listen", metavar="ENDPOINT", action="append", help="endpoint instead of the file's"
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="duration")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    file = Path(settings.zenoh.config) if settings.zenoh.config else directory_of(settings.authority) / FILE
    if not file.is_file():
        raise CommandError(f"{plain(str(file))} is not there; 'cruiser provision router' makes it", ExitCode.USAGE)
    check_session_files(file)
    session, endpoints = open_router(file, list(settings.zenoh.listen))
    try:
        sys.stderr.write(f"router: listens on {plain(', '.join(endpoints))}\n")
        sys.stderr.flush()
        ends = ending_after(stopped, arguments.seconds, time.monotonic)
        while not ends():
            time.sleep(POLL_S)
    finally:
        close_session(session)
    return int(ExitCode.OK)
