"""The logs of a directory at the desk: found by ``cruiser review``, explained, and opened in a viewer."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any, Final, Self
from urllib.parse import urlsplit

import msgspec
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from schemas.exit_codes import CommandError, ExitCode
from schemas.reasons import Reason
from schemas.web.jobs import Jobs, JobsBusyError, ask_review
from schemas.web.log_files import (
    PART,
    LogFiles,
    busy,
    forbidden,
    is_foreign,
    is_readable,
    missing,
    readable_directory,
)

QUESTIONS_AT_ONCE: Final = 2
"""Processes that read logs beside the desk; of them one at a time brings the catalog up to date."""

FIND_S: Final = 600.0
"""The longest wait for a search, which reads the logs that are new. What was read by then is kept."""

ANSWERS: Final = 100
"""Answers to a search, the newest."""

LISTED: Final = 20
"""Logs that are named without a catalog."""

TEXT_MAX: Final = 300
"""The longest word of a search."""

Answer = Callable[[Request], Awaitable[Response]]

FLAGS: Final = ("robot", "reason", "operator", "since", "until")
"""Those of ``cruiser review find`` that the page has."""

REASONS: Final = sorted(reason.value for reason in Reason if reason is not Reason.NONE)

EXPOSED: Final = ("Accept-Ranges", "Content-Length", "Content-Range", "ETag", "Last-Modified")
"""Headers that a viewer has to see to read a file by ranges."""


class Viewer(msgspec.Struct, frozen=True):
    """A program in the browser that opens a log by its address.

    Attributes:
        name: its host, for people.
        origin: of its pages, as browsers say it.
    """

    url: str
    name: str
    origin: str


def viewer(text: str) -> Viewer:
    """Return the viewer at this address.

    Raises:
        CommandError: it is no address of a web page.
    """
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    if parts.scheme not in {"http", "https"} or not parts.hostname or parts.username is not None:
        raise CommandError(
            f"desk.viewers: {text!a} is no address of a viewer, such as https://app.foxglove.dev/~/view",
            ExitCode.USAGE,
        )
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    usual = {"http": 80, "https": 443}[parts.scheme]
    place = host if port in {None, usual} else f"{host}:{port}"
    return Viewer(text, place, f"{parts.scheme}://{place}")


def is_log(name: str) -> bool:
    """Return True for a name that a log of the directory can have; no hidden file's."""
    return name.removesuffix(PART).endswith(".mcap") and not name.startswith(".")


class DeskLogs(LogFiles):
    """A directory of logs, and the viewers whose pages may read them."""

    @classmethod
    def open(cls, directory: str, viewers: Sequence[str] = ()) -> Self:
        """Return the logs of this directory, which ``desk.logs`` names.

        Raises:
            CommandError: it is no directory, or may not be read; or a viewer's address is none.
        """
        return cls(readable_directory(directory, " (desk.logs)").absolute(), [viewer(one) for one in viewers])

    def __init__(self, directory: Path, viewers: Sequence[Viewer] = ()) -> None:
        """Read this directory; reports are made in another, which goes at the end."""
        super().__init__(directory, is_log, Jobs(QUESTIONS_AT_ONCE))
        self._viewers = viewers
        self._finding = Jobs()
        is_beside = os.access(directory, os.W_OK)
        self._catalog = [] if is_beside else [f"--catalog={self.scratch / 'catalog.parquet'}"]

    def routes(self) -> list[Route]:
        """Return where browsers find logs: a search, a log, its report, and why a robot stopped."""
        shared = [
            # Other pages see nothing but the logs, and these only where they are viewers' own.
            Middleware(
                CORSMiddleware,
                allow_origins=[one.origin for one in self._viewers],
                allow_methods=["GET", "HEAD"],
                allow_headers=["Range", "If-Range", "Authorization"],
                expose_headers=EXPOSED,
                allow_private_network=True,
            )
        ]
        return [
            Route("/logs/{name}", self.download, methods=["GET", "OPTIONS"], middleware=shared),
            Route("/reports/{name}", _ended_with_the_desk(self.report)),
            Route("/whys/{name}", _ended_with_the_desk(self._why)),
            Route("/find", _ended_with_the_desk(self._find)),
        ]

    async def _find(self, request: Request) -> Response:
        """Answer in lines of JSON: first what goes with the answer, then what was found, in its words."""
        if is_foreign(request):
            return missing()
        asked = {name: request.query_params.get(name, "")[:TEXT_MAX] for name in ("search", *FLAGS)}
        if not asked["search"].isalpha():
            return PlainTextResponse("'search' is no word", 400)
        flags = [f"--{name}={asked[name]}" for name in FLAGS if asked[name]]
        words = [
            "find",
            asked["search"],
            str(self.directory),
            "--json",
            f"--newest={ANSWERS}",
            *flags,
            *self._catalog,
        ]
        try:
            async with self._finding, self.jobs:
                done = await ask_review(words, FIND_S)
        except JobsBusyError:
            return busy()
        if done.code in {None, int(ExitCode.USAGE)}:
            return PlainTextResponse(_last_line(done.fault), 503 if done.code is None else 400)
        # Without a library that reads catalogs, logs and their reports are there all the same.
        is_failed = done.code not in {int(ExitCode.OK), int(ExitCode.PARTIAL)}
        head: dict[str, Any] = {
            "fault": done.fault if done.code else "",
            "uncataloged": self._uncataloged(is_failed=is_failed),
            "is_failed": is_failed,
            "viewers": [{"url": one.url, "name": one.name} for one in self._viewers],
            "reasons": REASONS,
        }
        return Response(msgspec.json.encode(head) + b"\n" + done.output, media_type="application/x-ndjson")

    async def _why(self, request: Request) -> Response:
        """Answer with what ``cruiser review why`` says, as JSON."""
        path = self.path(request.path_params["name"])
        if path is None or is_foreign(request):
            return missing()
        if not is_readable(path):
            return forbidden(path)
        asked = {name: request.query_params.get(name, "")[:TEXT_MAX] for name in ("at", "robot")}
        whose = [f"--robot={asked['robot']}"] if asked["robot"] else []
        try:
            async with self.jobs:
                done = await ask_review(["why", str(path), f"--at={asked['at']}", *whose, "--json"])
        except JobsBusyError:
            return busy()
        if not done.output:
            return PlainTextResponse(_last_line(done.fault) or "no answer", 500)
        return Response(done.output, media_type="application/json")

    def _uncataloged(self, *, is_failed: bool) -> list[str]:
        """Return the newest logs that are being written; or of all, where there is no catalog."""
        try:
            with os.scandir(self.directory) as entries:
                names = sorted(
                    one.name for one in entries if is_log(one.name) and (is_failed or one.name.endswith(PART))
                )
        except OSError:
            return []
        return sorted(names)[-LISTED:]


def _ended_with_the_desk(answer: Answer) -> Answer:
    """A question that is under way at the desk's end is no fault to be logged: its process ends too."""

    async def quiet(request: Request) -> Response:
        try:
            return await answer(request)
        except asyncio.CancelledError:
            return PlainTextResponse("the desk has ended", 503)

    return quiet


def _last_line(text: str) -> str:
    return text.rpartition("\n")[2]
