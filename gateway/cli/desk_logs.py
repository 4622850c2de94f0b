"""The logs of a directory at the desk: the newest of each robot, the file itself, and its report."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, Self

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

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
