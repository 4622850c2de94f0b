"""The logs of a directory at the desk: the newest of each robot, the file itself, and its report."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, Self

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from schemas.exit_codes import CommandError, ExitCode
from schemas.file_kinds import other_kind
from schemas.keys import ROBOT_PATTERN
from schemas.web.log_files import LogFiles, readable_directory

LOG_NAME: Final = re.compile(
    rf"(?P<robot>{ROBOT_PATTERN})-[0-9]{{8}}T[0-9]{{6}}Z[A-Za-z0-9._-]{{0,32}}\.mcap(\.part)?"
)

SHOWN: Final = 20
"""Logs of a robot that are listed, the newest."""


class DeskLogs(LogFiles):
    """A directory in which a recorder writes."""

    @classmethod
    def open(cls, directory: str) -> Self:
        """Return the logs of this directory, which ``desk.logs`` names.

        Raises:
            CommandError: it is no directory, or may not be read.
        """
        return cls(readable_directory(directory, " (desk.logs)"))

    def __init__(self, directory: Path) -> None:
        """Read this directory; reports are made in another, which goes at the end."""
        super().__init__(directory, lambda name: LOG_NAME.fullmatch(name) is not None)

    def routes(self) -> list[Route]:
        """Return where browsers find the list of a robot's logs, a log, and its report."""
        return [Route("/logs/of/{robot}", self._list), *super().routes()]

    def _list(self, request: Request) -> Response:
        # Not async: it runs on a thread of its own, for a large directory takes longer than a drive can wait.
        robot = request.path_params["robot"]
        return JSONResponse(sorted(self._names(robot), reverse=True)[:SHOWN])

    async def _download(self, request: Request) -> Response:
        path = self._path(request)
        # The length of one that still grows cannot be said before.
        if path is None or path.name.endswith(PART):
            return _missing()
        if not _is_readable(path):
            return _forbidden(path)
        return _Download.open(path) or _missing()

    async def _report(self, request: Request) -> Response:
        path = self._path(request)
        if path is None or _is_foreign(request):
            return _missing()
        if not _is_readable(path):
            return _forbidden(path)
        async with self._one_at_a_time:
            key = _version(path)
            report = self._made.get(key)
            if report is None:
                report = Path(self._reports.name, "-".join(map(str, key)) + ".html")
                fault = await _make_report(path, report)
                # A log that is damaged, or still grows, has a report that says so.
                if not _is_file(report):
                    return PlainTextResponse(fault, 500)
                self._keep(key, report)
        return FileResponse(report, media_type="text/html", headers=SANDBOX)

    def _keep(self, key: tuple[str, int, int], report: Path) -> None:
        self._made[key] = report
        while len(self._made) > REPORTS_KEPT:
            self._made.pop(next(iter(self._made))).unlink(missing_ok=True)

    def _names(self, robot: str) -> list[str]:
        try:
            return [
                path.name
                for path in self.directory.iterdir()
                if (log := LOG_NAME.fullmatch(path.name)) is not None
                if log["robot"] == robot and self.path(path.name) == path
            ]
        except OSError:
            return []

    def _path(self, request: Request) -> Path | None:
        """The file that is asked for; None if it is no log of this directory."""
        name = request.path_params["name"]
        # One that was being written when the page was opened may be whole by now.
        paths = (self._directory / one for one in (name, name.removesuffix(PART)))
        return next(filter(_robot_of, paths), None)


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


async def _make_report(log: Path, report: Path) -> str:
    """Make a report of a log. Returns what was said about it."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gateway", "review", "report", str(log), "-o", str(report)),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
    )
    with suppress(ProcessLookupError):
        resource.prlimit(process.pid, resource.RLIMIT_DATA, (REPORT_BYTES, REPORT_BYTES))
    try:
        _, said = await asyncio.wait_for(process.communicate(), REPORT_S)
    except TimeoutError:
        return f"no report within {REPORT_S:.0f} s: use 'cruiser review report' for this log"
    finally:
        if process.returncode is None:
            process.kill()
    return said.decode("utf-8", "replace").strip()[-1000:] or "no report was made"


def _is_foreign(request: Request) -> bool:
    """Return True if another site's page fetches it, unseen; a link that somebody follows is none."""
    fetch = request.headers.get
    return fetch("sec-fetch-site", "") in {"cross-site", "same-site"} and fetch("sec-fetch-dest", "") != "document"


def _robot_of(path: Path) -> str:
    """The robot whose log this is; empty if it is none, or only points to one."""
    log = LOG_NAME.fullmatch(path.name)
    return log["robot"] if log is not None and path.is_file() and not path.is_symlink() else ""


def _version(path: Path) -> tuple[str, int, int]:
    """A file's name, size and time: another log under the same name, or one that has grown, is another."""
    status = path.stat()
    return path.name, status.st_size, status.st_mtime_ns


def _is_file(path: Path) -> bool:
    return path.is_file()


def _is_readable(path: Path) -> bool:
    return os.access(path, os.R_OK)


def _forbidden(path: Path) -> Response:
    return PlainTextResponse(UNREADABLE.format(path.name), 403)


def _missing() -> Response:
    return PlainTextResponse("there is no such log", 404)
