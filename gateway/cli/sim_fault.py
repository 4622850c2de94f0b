"""``cruiser fault``: cause a fault in a running virtual chassis."""

from __future__ import annotations

import argparse
import socket
import sys
from collections.abc import Callable
from typing import Final

from gateway.can.socketcand_server import HI, OK
from gateway.sim.disturbances import GRAMMAR, FaultTextError, parse, parse_address
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings

EXAMPLE: Final = """\
  cruiser fault bumper front on
  cruiser fault slope 8
  cruiser fault silence Auto_GearFeedBack for 2s
  cruiser fault clear"""

_TIMEOUT_S: Final = 3.0
_MAX_ANSWER_BYTES: Final = 1024


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description or ''}\n\n{GRAMMAR}"
    parser.add_argument(
        "--sim", dest="sim.listen", metavar="HOST:PORT", help="address of the chassis (default 127.0.0.1:29536)"
    )
    # The rest of the line, so that a negative number is no flag.
    parser.add_argument("words", nargs=argparse.REMAINDER, metavar="WORDS", help="the fault")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    del stopped  # It takes no longer than _TIMEOUT_S.
    text = " ".join(arguments.words)
    cause(settings.sim.listen, text)
    sys.stdout.write(f"ok: {text}\n")
    return ExitCode.OK


def cause(address: str, text: str) -> None:
    line = parse(text)
    if isinstance(line, FaultTextError):
        raise CommandError(line.reason, ExitCode.USAGE)
    try:
        with socket.create_connection(parse_address(address), _TIMEOUT_S) as connection:
            answer = _ask(connection, text)
    except (OSError, UnicodeError) as error:  # UnicodeError: no host's name looks like that
        why = getattr(error, "strerror", None) or str(error)
        raise CommandError(f"no virtual chassis at {address}: {why}", ExitCode.UNREACHABLE) from error
    if answer != OK:
        raise CommandError(f"the chassis replied {answer.decode('ascii', errors='replace')!r}", ExitCode.USAGE)


def _ask(connection: socket.socket, text: str) -> bytes:
    if _message(connection) != HI:
        raise OSError("not a socketcand server")
    connection.sendall(f"< fault {text} >".encode())
    return _message(connection)


def _message(connection: socket.socket) -> bytes:
    """Return one message. The peer sends only replies, so nothing follows it."""
    data = b""
    while not data.endswith(b">"):
        received = connection.recv(_MAX_ANSWER_BYTES)
        data += received
        if not received or len(data) > _MAX_ANSWER_BYTES:
            raise OSError("the server closed the connection")
    return data
