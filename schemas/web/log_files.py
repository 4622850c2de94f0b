"""The logs of a directory, for browsers: the file itself, and its report."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Final, Self

from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.types import Receive, Scope, Send

from schemas.exit_codes import CommandError, ExitCode
from schemas.file_kinds import other_kind
from schemas.web.jobs import Jobs, JobsBusyError, ask_review

PART: Final = ".part"
"""So the name of a log ends that is being written."""

REPORTS_KEPT: Final = 20

SANDBOX: Final = {
    # A report holds what was in a log. It is a page of nobody's, and reaches neither this server nor a browser's
    # keys.
    "Content-Security-Policy": "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'",
}

UNREADABLE: Final = "the user of this server may not read {}: give it the group of the recorder"


def readable_directory(directory: str, where: str = "") -> Path:
    """Return the path of a directory that may be read.

    Args:
        directory: its name.
        where: what names it, for people.

    Raises:
        CommandError: it is no directory, or may not be read.
    """
    if not os.path.isdir(directory):  # noqa: PTH112 - Path raises where a directory above may not be read
        raise CommandError(f"{directory} is no directory{where}", ExitCode.USAGE)
    if not os.access(directory, os.R_OK | os.X_OK):
        raise CommandError(f"{UNREADABLE.format(directory)}{where}", ExitCode.USAGE)
    return Path(directory)


class LogFiles:
    """A directory of logs.

    Args:
        directory: of the logs.
        is_log: true for the names of those that may be read.
        jobs: the line in which reports wait.

    Attributes:
        directory: of the logs.
        scratch: a directory of its own, which goes at the end.
        jobs: the line in which reports wait.
    """

    def __init__(self, directory: Path, is_log: Callable[[str], bool], jobs: Jobs | None = None) -> None:
        self.directory = directory
        self.jobs = jobs or Jobs()
        self._is_log = is_log
        self._scratch = tempfile.TemporaryDirectory(prefix="cruiser-web-")
        self.scratch = Path(self._scratch.name)
        self._numbers = count()
        self._made: dict[tuple[str, int, int], Path] = {}

    def close(self) -> None:
        """Remove the reports."""
        self._scratch.cleanup()

    def path(self, name: str) -> Path | None:
        """Return the log of this name; None if it is none, or only points to one.

        One that was being written when the page was opened may be whole by now.
        """
        for one in (name, name.removesuffix(PART)):
            path = self.directory / one
            # A name may be longer than any file's.
            with suppress(OSError):
                if "/" not in one and self._is_log(one) and path.is_file() and not path.is_symlink():
                    return path
        return None

    async def download(self, request: Request) -> Response:
        """Answer with the file, or with ranges of it."""
        path = self.path(request.path_params["name"])
        # The length of one that still grows cannot be said before.
        if path is None or path.name.endswith(PART):
            return missing()
        if not is_readable(path):
            return forbidden(path)
        return _Download.open(path) or missing()

    async def report(self, request: Request) -> Response:
        """Answer with the report of a log, which is made when it is asked for."""
        path = self.path(request.path_params["name"])
        if path is None or is_foreign(request):
            return missing()
        if not is_readable(path):
            return forbidden(path)
        try:
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
        except JobsBusyError:
            return busy()
        return FileResponse(report, media_type="text/html", headers=SANDBOX)

    def _keep(self, key: tuple[str, int, int], report: Path) -> None:
        self._made[key] = report
        while len(self._made) > REPORTS_KEPT:
            self._made.pop(next(iter(self._made))).unlink(missing_ok=True)


class _Download(FileResponse):
    """A file that was opened before anything is said of it: its name may lead elsewhere by now."""

    @classmethod
    def open(cls, path: Path) -> Self | None:
        """Open a log; None if it is a link, or no regular file."""
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
        """Send it, and close it."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            os.close(self._descriptor)


def version(path: Path) -> tuple[str, int, int]:
    """Return a file's name, size and time: another log under the same name, or one that has grown, is another."""
    status = path.stat()
    return path.name, status.st_size, status.st_mtime_ns


def is_foreign(request: Request) -> bool:
    """Return True if another site's page fetches it, unseen; a link that somebody follows is none."""
    fetch = request.headers.get
    return fetch("sec-fetch-site", "") in {"cross-site", "same-site"} and fetch("sec-fetch-dest", "") != "document"


def is_readable(path: Path) -> bool:
    """Return True if this process may read it."""
    return os.access(path, os.R_OK)


def forbidden(path: Path) -> Response:
    """Answer that a log may not be read."""
    return PlainTextResponse(UNREADABLE.format(path.name), 403)


def missing() -> Response:
    """Answer that there is no such log."""
    return PlainTextResponse("there is no such log", 404)


def busy() -> Response:
    """Answer that too many questions wait."""
    return PlainTextResponse("too many questions wait already: ask again in a minute", 503)


def _is_file(path: Path) -> bool:
    return path.is_file()
