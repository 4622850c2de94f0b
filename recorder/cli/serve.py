"""``cruiser serve``: the logs of a fleet in a browser."""

from __future__ import annotations

import argparse
import asyncio
import sys
import time
from collections.abc import Callable
from contextlib import closing
from typing import Final

from recorder.cli.review.asking import needing_extra
from recorder.serve.viewers import viewer
from schemas.arguments import ending_after, seconds
from schemas.exit_codes import ExitCode
from schemas.listen_address import add_certificate_arguments, address, shown_address
from schemas.missing_extra import missing_extra
from schemas.settings import Settings
from schemas.web.address import LOCAL_NAMES, PACKAGES, listening_socket, usable_certificate

EXAMPLE: Final = """\
  cruiser serve logs                                    http://127.0.0.1:8081/
  cruiser serve logs --write                            people may tag logs, and comment on them
  cruiser serve logs --viewer https://app.foxglove.dev/~/view
  cruiser serve logs --listen 0.0.0.0:8444 --certificate logs.pem --key logs.key --name logs.example"""

LISTEN: Final = ("127.0.0.1", 8081)
"""Next to the desk's port."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("directory", metavar="DIRECTORY", help="of the logs: whoever opens the page may read them")
    parser.add_argument(
        "--listen",
        type=address,
        default=LISTEN,
        metavar="ADDRESS:PORT",
        help=f"where browsers ask ({LISTEN[0]}:{LISTEN[1]}: this machine alone); port 0 is a free one",
    )
    add_certificate_arguments(parser)
    parser.add_argument(
        "--name",
        action="append",
        default=[],
        metavar="HOST",
        help="a name under which browsers reach it; may be given several times",
    )
    parser.add_argument(
        "--write", action="store_true", help="people may write tags and comments, which are kept beside the logs"
    )
    parser.add_argument(
        "--viewer",
        type=viewer,
        action="append",
        default=[],
        metavar="URL",
        help="a viewer that opens a log by its address, such as https://app.foxglove.dev/~/view: its pages may "
        "read the logs; may be given several times",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="end after this time")


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    """Serve the logs until it is stopped.

    Raises:
        CommandError: a package is missing, the directory cannot be read, or the address is taken or needs a
            certificate.
    """
    try:
        with needing_extra():
            from recorder.serve.app import ServedLogs, is_log  # noqa: PLC0415 - needs the extras
            from recorder.serve.library import Library  # noqa: PLC0415 - the same
            from schemas.web.log_files import LogFiles, readable_directory  # noqa: PLC0415 - the same
            from schemas.web.server import serve  # noqa: PLC0415 - the same
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in PACKAGES:
            raise
        raise missing_extra(" and ".join(sorted(PACKAGES)), "desk") from None
    host, port = arguments.listen
    certificate = usable_certificate(arguments.certificate, arguments.key, host)
    directory = readable_directory(arguments.directory).absolute()
    with closing(LogFiles(directory, is_log)) as files, listening_socket(host, port) as listening:
        library = Library(directory, files.scratch)
        if library.catalog.parent != directory:
            _tell(f"{directory} cannot be written: its catalog is made anew at each start")
        where = shown_address(host, listening.getsockname()[1])
        _tell(f"{'https' if certificate else 'http'}://{where}/, logs of {directory}")
        ends = ending_after(stopped, arguments.seconds, time.monotonic)
        served = ServedLogs(files, library, arguments.viewer, can_write=arguments.write)
        app = served.make_app([*LOCAL_NAMES, host, *arguments.name])

        async def work() -> None:
            async with asyncio.TaskGroup() as group:
                keeping = group.create_task(library.keep_current(ends))
                await serve(app, listening, ends, certificate)
                # The question that is being asked ends with it.
                keeping.cancel()

        asyncio.run(work())
    return int(ExitCode.OK)


def _tell(text: str) -> None:
    sys.stderr.write(f"serve: {text}\n")
    sys.stderr.flush()
