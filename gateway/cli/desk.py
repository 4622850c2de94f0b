"""``cruiser desk``: a fleet in the browser."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import socket
import ssl
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from gateway.zenoh.client import DeskListener
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.arguments import add_zenoh_arguments, ending_after, seconds
from schemas.command_line import CommandError, ExitCode, certificate_files, needing_extra, shown_address
from schemas.command_line import address as listen_address
from schemas.settings import DeskSettings, Settings
from schemas.zenoh_session import place

EXAMPLE: Final = """\
  cruiser desk
  cruiser desk --config ~/.config/cruiser/desk.toml
  cruiser desk --logs logs --logs-only
  cruiser desk --listen 0.0.0.0:8443 --certificate desk.pem --certificate-key desk.key --host desk.example"""


LOCAL_NAMES: Final = ("127.0.0.1", "localhost", "::1", "[::1]")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--listen",
        dest="desk.listen",
        metavar="ADDRESS:PORT",
        help=f"address for browsers (default {DeskSettings().listen}: this machine only); port 0: a free port",
    )
    parser.add_argument(
        "--certificate",
        dest="desk.certificate",
        metavar="FILE",
        help="certificate chain, PEM; required if other machines connect",
    )
    parser.add_argument(
        "--certificate-key", dest="desk.key", metavar="FILE", help="private key of the certificate, PEM"
    )
    parser.add_argument(
        "--host",
        dest="desk.names",
        action="append",
        metavar="HOST",
        help="name under which browsers reach the desk; may be repeated",
    )
    parser.add_argument(
        "--logs",
        dest="desk.logs",
        metavar="DIR",
        help="directory of logs; anyone who opens the page may search and read them",
    )
    parser.add_argument(
        "--viewer",
        dest="desk.viewers",
        action="append",
        metavar="URL",
        help="viewer that opens logs by URL, such as https://app.foxglove.dev/~/view; it may read all logs; "
        "may be repeated",
    )
    parser.add_argument("--logs-only", action="store_true", help="only the logs: no robots, no Zenoh")
    parser.add_argument("--seconds", type=seconds, metavar="N", help="duration")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    with needing_extra():
        from gateway.cli.desk_logs import DeskLogs  # noqa: PLC0415 - the same
        from gateway.cli.desk_server import Hub, make_app, make_logs_app, serve  # noqa: PLC0415 - needs the extra 'desk'
        from gateway.desk.words import FROM_BROWSER_BYTES  # noqa: PLC0415 - the same
    desk = settings.desk
    if arguments.logs_only and not desk.logs:
        raise CommandError("--logs-only needs --logs DIR", ExitCode.USAGE)
    host, port = _address(desk.listen)
    certificate = _certificate(desk, host)
    hosts = [*LOCAL_NAMES, host, *desk.names]
    ends = ending_after(stopped, arguments.seconds, time.monotonic)
    with contextlib.ExitStack() as stack:
        logs = None
        if desk.logs:
            logs = stack.enter_context(contextlib.closing(DeskLogs.open(desk.logs, desk.viewers)))
        listening = stack.enter_context(listening_socket(host, port))
        address = f"{'https' if certificate else 'http'}://{shown_address(host, listening.getsockname()[1])}/"
        if arguments.logs_only and logs is not None:
            _tell(f"{address}, logs of {logs.directory}")
            asyncio.run(serve(make_logs_app(logs, hosts), listening, ends, certificate))
            return int(ExitCode.OK)
        listener = stack.enter_context(DeskListener.open(settings))
        commands = stack.enter_context(CommandPort.open(settings, keys.ALL, "desk", lasts=True))
        _tell(f"{address}, robots at {place(settings.zenoh)}")
        hub = Hub(settings, listener, commands, has_logs=logs is not None)
        app = make_app(hub, hosts, logs)

        async def work() -> None:
            async with asyncio.TaskGroup() as group:
                group.create_task(hub.run(ends))
                group.create_task(serve(app, listening, ends, certificate, FROM_BROWSER_BYTES))

        asyncio.run(work())
    return int(ExitCode.OK)


def _tell(text: str) -> None:
    sys.stderr.write(f"desk: {text}\n")
    sys.stderr.flush()


def _address(listen: str) -> tuple[str, int]:
    try:
        return listen_address(listen)
    except argparse.ArgumentTypeError as error:
        raise CommandError(f"desk.listen: {error}", ExitCode.USAGE) from error


def _certificate(settings: DeskSettings, host: str) -> tuple[Path, Path] | None:
    """Return the files of certificate and key; None if only this machine's browsers connect."""
    try:
        files = certificate_files(settings.certificate, settings.key, host, "browsers")
        if files is not None:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(*files)
    except CommandError as error:
        raise CommandError(f"{error} (desk.certificate, desk.key)", error.code) from None
    except (OSError, ValueError) as error:
        what = f"{settings.certificate} and {settings.key} are not a certificate and its key"
        raise CommandError(f"{what}: {error} (desk.certificate, desk.key)", ExitCode.USAGE) from None
    return files


def listening_socket(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        text = f"cannot listen on {shown_address(host, port)}: {error.strerror or error}"
        raise CommandError(text, ExitCode.UNREACHABLE) from error
