"""The HTTP interface of the page: lists, answers and files to read; notes to write, where that is allowed."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any, Final

import msgspec
from starlette.applications import Starlette
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

import recorder.serve
from recorder.disk.log_directory import PART_SUFFIX, SUFFIX
from recorder.reading.times import date_of
from recorder.review.report.links import iso
from recorder.serve.library import Library
from recorder.serve.notes import (
    NOTE_BYTES,
    AnyNote,
    NoteRefusedError,
    add_note,
    notes_path,
    read_note,
    read_notes,
    tags_of,
)
from recorder.serve.parts import FORMS, LOG, PART_S, make_part, name_of_part
from recorder.serve.viewers import EXPOSED, Viewer, manifest
from schemas.exit_codes import CommandError
from schemas.reasons import TEXTS
from schemas.web.jobs import JobsBusyError, ask_review
from schemas.web.log_files import LogFiles, busy, forbidden, is_foreign, is_readable, missing, version
from schemas.web.server import is_own, make_site

PAGE: Final = Path(recorder.serve.__file__).parent / "page"

WHYS_KEPT: Final = 200

TEXT_MAX: Final = 300
"""The longest name of a robot, or time, that is asked about."""


def is_log(name: str) -> bool:
    """Return True for a name that a log of the directory can have: anybody's, but no hidden file's."""
    return name.endswith((SUFFIX, PART_SUFFIX)) and not name.startswith(".")


class ServedLogs:
    """A directory of logs, as browsers may ask for it.

    Args:
        files: the logs.
        library: their catalog.
        viewers: programs that open a log by its address; their pages may read the files.
        can_write: people may write notes.
        wall_ns: the present, since 1970.
    """

    def __init__(
        self,
        files: LogFiles,
        library: Library,
        viewers: Sequence[Viewer] = (),
        *,
        can_write: bool = False,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._files = files
        self._library = library
        self._viewers = viewers
        self._can_write = can_write
        self._wall_ns = wall_ns
        self._whys: dict[tuple[Any, ...], Any] = {}
        self._numbers = count()

    def make_app(self, hosts: Sequence[str]) -> Starlette:
        """Make the application, which is reached under these names."""
        return make_site(self._routes(), hosts, PAGE)

    def _routes(self) -> list[BaseRoute]:
        # Other pages see nothing but the logs, and these only where they are viewers' own.
        shared = [
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
            Route("/logs/{name}", self._files.download, methods=["GET", "OPTIONS"], middleware=shared),
            Route("/manifest", self._manifest, methods=["GET", "OPTIONS"], middleware=shared),
            *(one for one in self._files.routes() if not one.path.startswith("/logs/")),
            Route("/api/state", self._state),
            Route("/api/days", self._days),
            Route("/api/find", self._find),
            Route("/api/logs/{name}", self._log),
            Route("/api/why/{name}", self._why),
            Route("/api/notes/{name}", self._note, methods=["POST"]),
            Route("/cut/{name}", self._cut),
        ]

    # What is not async runs on a thread of its own: a catalog may take a second to read.

    def _state(self, _request: Request) -> Response:
        return JSONResponse(
            {
                **msgspec.structs.asdict(self._library.state),
                "tags": self._library.all_tags(),
                "can_write": self._can_write,
                "viewers": [{"url": one.url, "name": one.name} for one in self._viewers],
                "forms": FORMS,
                "reasons": {reason.value: [text.means, text.cure] for reason, text in TEXTS.items()},
            }
        )

    def _days(self, request: Request) -> Response:
        if is_foreign(request):
            return missing()
        return JSONResponse([msgspec.structs.asdict(one) for one in self._library.days()])

    def _find(self, request: Request) -> Response:
        if is_foreign(request):
            return missing()
        try:
            return JSONResponse(self._library.find(request.query_params.get("words", ""), self._wall_ns()))
        except CommandError as error:
            return PlainTextResponse(str(error), 400)

    def _log(self, request: Request) -> Response:
        path = self._files.path(request.path_params["name"])
        if path is None or is_foreign(request):
            return missing()
        notes, unread = read_notes(notes_path(path))
        found = {
            "file": path.name,
            "is_open": path.name.endswith(PART_SUFFIX),
            "catalog": self._library.log(path.name),
            "notes": _noted(notes),
            "tags": tags_of(notes),
            "unread_notes": unread,
        }
        return JSONResponse(found)

    async def _why(self, request: Request) -> Response:
        path = self._files.path(request.path_params["name"])
        if path is None or is_foreign(request):
            return missing()
        if not is_readable(path):
            return forbidden(path)
        asked = request.query_params
        at_ns, robot = date_of(asked.get("at", "")[:TEXT_MAX]), asked.get("robot", "")[:TEXT_MAX]
        if at_ns is None:
            return PlainTextResponse("'at' is no date and time", 400)
        key = (*version(path), at_ns, robot)
        try:
            async with self._files.jobs:
                if key not in self._whys:
                    whose = [f"--robot={robot}"] if robot else []
                    done = await ask_review(["why", str(path), f"--at={iso(at_ns)}", *whose, "--json"])
                    try:
                        self._whys[key] = msgspec.json.decode(done.output)
                    except msgspec.DecodeError:
                        return PlainTextResponse(done.fault or "no answer", 500)
                    while len(self._whys) > WHYS_KEPT:
                        self._whys.pop(next(iter(self._whys)))
                return JSONResponse(self._whys[key])
        except JobsBusyError:
            return busy()

    async def _cut(self, request: Request) -> Response:
        path = self._files.path(request.path_params["name"])
        if path is None or is_foreign(request):
            return missing()
        if not is_readable(path):
            return forbidden(path)
        asked = request.query_params
        from_ns, to_ns = (date_of(asked.get(one, "")[:TEXT_MAX]) for one in ("from", "to"))
        form = asked.get("as", LOG)
        if from_ns is None or to_ns is None or not 0 < to_ns - from_ns <= PART_S * 1e9 or form not in FORMS:
            forms = ", ".join(FORMS)
            text = f"give 'from' and 'to', dates and times at most {PART_S:.0f} s apart, and 'as', one of {forms}"
            return PlainTextResponse(text, 400)
        part = self._files.scratch / f"part-{next(self._numbers)}"
        try:
            async with self._files.jobs:
                fault = await make_part(path, from_ns, to_ns, form, part)
        except JobsBusyError:
            return busy()
        if fault:
            return PlainTextResponse(fault, 500)
        gone = BackgroundTask(part.unlink, missing_ok=True)
        media = "application/octet-stream" if form == LOG else "application/zip"
        return FileResponse(part, filename=name_of_part(path, from_ns, form), media_type=media, background=gone)

    async def _note(self, request: Request) -> Response:
        path = self._files.path(request.path_params["name"])
        # A form of another page could send this too, but not from this origin.
        if not self._can_write or not is_own(request.url.scheme, request.headers):
            return PlainTextResponse("notes cannot be written here", 403)
        if path is None:
            return missing()
        now = datetime.fromtimestamp(self._wall_ns() / 1e9, UTC).isoformat(timespec="seconds")
        try:
            note = read_note(await _body(request), now.replace("+00:00", "Z"))
            await run_in_threadpool(add_note, notes_path(path), note)
        except NoteRefusedError as error:
            return PlainTextResponse(str(error), 400)
        except CommandError as error:
            return PlainTextResponse(str(error), 507)
        except ClientDisconnect:
            return Response(status_code=400)
        notes, unread = await run_in_threadpool(read_notes, notes_path(path))
        return JSONResponse({"notes": _noted(notes), "tags": tags_of(notes), "unread_notes": unread})

    def _manifest(self, request: Request) -> Response:
        """The first question of a remote data loader."""
        path = self._files.path(request.query_params.get("log", ""))
        return missing() if path is None or path.name.endswith(PART_SUFFIX) else JSONResponse(manifest(path.name))


async def _body(request: Request) -> bytes:
    """The body of a request, as far as it may be a note."""
    body = b""
    async for piece in request.stream():
        body += piece
        if len(body) > NOTE_BYTES:
            raise NoteRefusedError("the note is too long")
    return body


def _noted(notes: Sequence[AnyNote]) -> list[dict[str, Any]]:
    """Notes as the page has them, the newest first."""
    return [msgspec.to_builtins(one) for one in reversed(notes)]
