"""Logs at the desk: searched and explained by ``cruiser review``, and opened in a viewer.

Each question runs in its own bounded process, because a crafted log could use up the machine.
"""

from __future__ import annotations

import asyncio
import os
import resource
import tempfile
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any, Final, Self
from urllib.parse import urlsplit

import msgspec
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from schemas.command_line import CommandError, ExitCode, module_command, other_kind
from schemas.reasons import Reason

JOB_S: Final = 120.0  # the longest time that an answer may take; who needs more asks ``cruiser review`` itself
JOB_BYTES: Final = 2 << 30  # memory limit of a question: a log can unpack to much more than its size
WAITING_MAX: Final = 16  # questions that wait for their turn; any more are refused at once
SAID_BYTES: Final = 4 << 20  # the longest answer that is read
NICENESS: Final = 10  # a robot that is driven through the same server comes first
END_S: Final = 5.0  # time to end after SIGTERM


class JobDone(msgspec.Struct, frozen=True):
    """A process that has ended."""

    code: int | None  # its exit code; None if it was given up, or could not be started
    output: bytes
    fault: str  # the end of its stderr, or the reason that there is no answer


class Jobs:
    """Runs a few questions at a time; a bounded number of others wait."""

    def __init__(self, at_a_time: int = 1) -> None:
        self._turns = asyncio.Semaphore(at_a_time)
        self._waiting = 0

    async def __aenter__(self) -> None:
        if self._waiting >= WAITING_MAX:
            raise HTTPException(503, "too many questions are waiting: try again in a minute")
        self._waiting += 1
        try:
            await self._turns.acquire()
        finally:
            self._waiting -= 1

    async def __aexit__(self, *_: object) -> None:
        self._turns.release()


async def ask_review(words: Sequence[str], seconds: float = JOB_S) -> JobDone:
    """Run ``cruiser review`` with these arguments. It ends after ``seconds``, also of processor time."""
    try:
        process = await asyncio.create_subprocess_exec(
            *module_command("gateway", "review", *words),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
    except OSError as error:
        # Browsers may hold all files that this process may open, or others all processes.
        return JobDone(None, b"", f"cannot start a process: {error.strerror}")
    with suppress(ProcessLookupError):
        # A sandbox may forbid it; the bounds below hold all the same.
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
        resource.prlimit(process.pid, resource.RLIMIT_DATA, (JOB_BYTES, JOB_BYTES))
        processor_s = max(1, int(seconds))
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (processor_s, processor_s + int(END_S)))
    reading = asyncio.gather(_read(process.stdout, SAID_BYTES), _read(process.stderr, SAID_BYTES))
    try:
        output, said = await asyncio.wait_for(asyncio.shield(reading), seconds)
        fault = said.decode("utf-8", "replace").strip()[-10_000:]
        code = await process.wait()
        if code < 0:
            return JobDone(None, b"", f"no answer: the process was ended by signal {-code}")
        return JobDone(code, output, fault)
    except TimeoutError:
        with suppress(ProcessLookupError):
            process.terminate()
        with suppress(TimeoutError):
            await asyncio.wait_for(asyncio.shield(reading), END_S)
        return JobDone(None, b"", f"no answer within {seconds:.0f} s: use 'cruiser review {words[0]}'")
    finally:
        if process.returncode is None:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        reading.cancel()
        with suppress(asyncio.CancelledError):
            await reading


async def _read(stream: asyncio.StreamReader | None, most: int) -> bytes:
    """Read to the end, and return the first ``most`` bytes."""
    kept = bytearray()
    while stream is not None and (piece := await stream.read(65_536)):
        kept += piece[: most - len(kept)]
    return bytes(kept)


PART: Final = ".part"  # so the name of a log ends that is being written
REPORTS_KEPT: Final = 20

SANDBOX: Final = {
    # A report contains foreign text: it gets an opaque origin, without access to this server or a browser's keys.
    "Content-Security-Policy": "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"
}

MISSING: Final = "no such log"
UNREADABLE: Final = "the desk's user may not read {}: add it to the recorder's group"

QUESTIONS_AT_ONCE: Final = 2  # processes that read logs at a time; at most one of them updates the catalog
FIND_S: Final = 600.0  # longest wait for a search, which first reads new logs; what was read until then is stored
ANSWERS: Final = 100  # answers to a search, the newest
LISTED: Final = 20  # logs that are named without a catalog
TEXT_MAX: Final = 300  # the longest word of a search, and the longest line that says what is wrong with it
Answer = Callable[[Request], Awaitable[Response]]

# flags of ``cruiser review find`` that the page offers
FLAGS: Final = ("robot", "reason", "operator", "since", "until")

REASONS: Final = sorted(reason.value for reason in Reason if reason is not Reason.NONE)

# headers that a viewer needs to read a file by ranges
EXPOSED: Final = ("Accept-Ranges", "Content-Length", "Content-Range", "ETag", "Last-Modified")


class Viewer(msgspec.Struct, frozen=True):
    """A viewer in the browser that opens a log by its URL."""

    url: str
    name: str
    origin: str  # of its pages, as browsers say it


def viewer(text: str) -> Viewer:
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    if parts.scheme not in {"http", "https"} or not parts.hostname or parts.username is not None:
        raise CommandError(
            f"desk.viewers: {text!a} is not the address of a viewer, such as https://app.foxglove.dev/~/view",
            ExitCode.USAGE,
        )
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    usual = {"http": 80, "https": 443}[parts.scheme]
    place = host if port in {None, usual} else f"{host}:{port}"
    return Viewer(text, place, f"{parts.scheme}://{place}")


def is_log(name: str) -> bool:
    """Return True for the name of a log, finished or in progress, that is not hidden."""
    return name.removesuffix(PART).endswith(".mcap") and not name.startswith(".")


class DeskLogs:
    """A directory of logs, and the viewers whose pages may read them."""

    @classmethod
    def open(cls, directory: str, viewers: Sequence[str] = ()) -> Self:
        return cls(_readable_directory(directory).absolute(), [viewer(one) for one in viewers])

    def __init__(self, directory: Path, viewers: Sequence[Viewer] = ()) -> None:
        self.directory = directory
        self.jobs = Jobs(QUESTIONS_AT_ONCE)
        self._scratch = tempfile.TemporaryDirectory(prefix="cruiser-web-")
        self.scratch = Path(self._scratch.name)
        self._numbers = count()
        self._made: dict[tuple[str, int, int], Path] = {}
        self._viewers = viewers
        self._finding = Jobs()
        is_beside = os.access(directory, os.W_OK)
        self._catalog = [] if is_beside else [f"--catalog={self.scratch / 'catalog.parquet'}"]

    def routes(self) -> list[Route]:
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

    def close(self) -> None:
        self._scratch.cleanup()

    def path(self, name: str) -> Path | None:
        """Return the log of this name; None if there is none, or it is a link.

        A log that was in progress when the page was opened may be finished by now.
        """
        for one in (name, name.removesuffix(PART)):
            path = self.directory / one
            # A name may be longer than any file's.
            with suppress(OSError):
                if "/" not in one and is_log(one) and path.is_file() and not path.is_symlink():
                    return path
        return None

    async def download(self, request: Request) -> Response:
        path = self._log(request)
        # The length of a growing log is not known.
        if path.name.endswith(PART) or (found := _Download.open(path)) is None:
            raise HTTPException(404, MISSING)
        return found

    async def report(self, request: Request) -> Response:
        """Return the report of a log, made on request."""
        path = self._asked(request)
        async with self.jobs:
            key = version(path)
            report = self._made.get(key)
            if report is None:
                report = self.scratch / f"{next(self._numbers)}.html"
                done = await ask_review(["report", str(path), "-o", str(report)])
                # A log that is damaged, or still grows, has a report that says so.
                if not _is_file(report):
                    return PlainTextResponse(done.fault or "no report was made", 500)
                self._keep(key, report)
        return FileResponse(report, media_type="text/html", headers=SANDBOX)

    def _asked(self, request: Request) -> Path:
        """Return the log that a question is about."""
        if is_foreign(request):
            raise HTTPException(404, MISSING)
        return self._log(request)

    def _log(self, request: Request) -> Path:
        path = self.path(request.path_params["name"])
        if path is None:
            raise HTTPException(404, MISSING)
        if not os.access(path, os.R_OK):
            raise HTTPException(403, UNREADABLE.format(path.name))
        return path

    def _keep(self, key: tuple[str, int, int], report: Path) -> None:
        self._made[key] = report
        while len(self._made) > REPORTS_KEPT:
            self._made.pop(next(iter(self._made))).unlink(missing_ok=True)

    async def _find(self, request: Request) -> Response:
        """Answer in lines of JSON: first a header, then what ``cruiser review find`` prints."""
        if is_foreign(request):
            raise HTTPException(404, MISSING)
        asked = {name: request.query_params.get(name, "")[:TEXT_MAX] for name in ("search", *FLAGS)}
        if not asked["search"].isalpha():
            return PlainTextResponse("'search' must be one word", 400)
        flags = [f"--{name}={asked[name]}" for name in FLAGS if asked[name]]
        words = ["find", asked["search"], str(self.directory), "--json", f"--newest={ANSWERS}", *flags]
        async with self._finding, self.jobs:
            done = await ask_review([*words, *self._catalog], FIND_S)
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
        path = self._asked(request)
        asked = {name: request.query_params.get(name, "")[:TEXT_MAX] for name in ("at", "robot")}
        whose = [f"--robot={asked['robot']}"] if asked["robot"] else []
        async with self.jobs:
            done = await ask_review(["why", str(path), f"--at={asked['at']}", *whose, "--json"])
        if not done.output:
            return PlainTextResponse(_last_line(done.fault) or "no answer", 500)
        return Response(done.output, media_type="application/json")

    def _uncataloged(self, *, is_failed: bool) -> list[str]:
        """Return the newest logs in progress; without a catalog the newest of all logs."""
        try:
            with os.scandir(self.directory) as entries:
                names = sorted(
                    one.name for one in entries if is_log(one.name) and (is_failed or one.name.endswith(PART))
                )
        except OSError:
            return []
        return sorted(names)[-LISTED:]


def _ended_with_the_desk(answer: Answer) -> Answer:
    """Answer 503, without a traceback, to a question that the end of the desk cancels."""

    async def quiet(request: Request) -> Response:
        try:
            return await answer(request)
        except asyncio.CancelledError:
            return PlainTextResponse("the desk is shutting down", 503)

    return quiet


def _last_line(text: str) -> str:
    return text.rpartition("\n")[2][:TEXT_MAX]


def _readable_directory(directory: str) -> Path:
    if not os.path.isdir(directory):  # noqa: PTH112 - Path raises where a directory above may not be read
        raise CommandError(f"{directory} is not a directory (desk.logs)", ExitCode.USAGE)
    if not os.access(directory, os.R_OK | os.X_OK):
        raise CommandError(f"{UNREADABLE.format(directory)} (desk.logs)", ExitCode.USAGE)
    return Path(directory)


class _Download(FileResponse):
    """A response from an open file descriptor, so that a renamed or replaced file cannot redirect it."""

    @classmethod
    def open(cls, path: Path) -> Self | None:
        """Open a log; None if it is a link or not a regular file."""
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError:
            return None
        if other_kind(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            return None
        return cls(descriptor, path.name)

    def __init__(self, descriptor: int, name: str) -> None:
        super().__init__(f"/proc/self/fd/{descriptor}", filename=name)
        self._descriptor = descriptor

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            os.close(self._descriptor)


def version(path: Path) -> tuple[str, int, int]:
    """Return name, size and time of a file, as the key of its report."""
    status = path.stat()
    return path.name, status.st_size, status.st_mtime_ns


def is_foreign(request: Request) -> bool:
    """Return True for a request that another site's page makes in the background; a followed link is none."""
    fetch = request.headers.get
    return fetch("sec-fetch-site", "") in {"cross-site", "same-site"} and fetch("sec-fetch-dest", "") != "document"


def _is_file(path: Path) -> bool:
    return path.is_file()
