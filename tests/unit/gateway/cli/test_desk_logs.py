"""The logs of a directory, for browsers."""

import asyncio
import os
from contextlib import closing
from pathlib import Path

import pytest
from starlette.applications import Starlette
from starlette.types import Message

from gateway.cli.desk_logs import DeskLogs
from schemas.exit_codes import CommandError

LOG = "cruiser-1-20260102T030405Z.mcap"


@pytest.fixture
def unreadable(monkeypatch: pytest.MonkeyPatch) -> set[Path]:
    """What the desk's user may not read: root, who may run this, reads everything."""
    paths: set[Path] = set()
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) not in paths and access(path, mode))
    return paths


def ask(logs: DeskLogs, path: str) -> tuple[int, bytes]:
    """Status and content of an answer."""
    said: list[Message] = []

    async def receive() -> Message:
        # The browser does not go away before it has its answer.
        never: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        return await never

    async def send(message: Message) -> None:
        said.append(message)

    scope = {"type": "http", "method": "GET", "path": path, "query_string": b"", "headers": []}
    asyncio.run(Starlette(routes=logs.routes())(scope, receive, send))
    return said[0]["status"], b"".join(one.get("body", b"") for one in said[1:])


def test_a_directory_that_is_none_or_cannot_be_read_is_one_clear_line(
    tmp_path: Path, unreadable: set[Path]
) -> None:
    """Which names it and the setting; and, where it is there, what is missing."""
    with pytest.raises(CommandError, match=r"logs is no directory \(desk\.logs\)$"):
        DeskLogs.open(str(tmp_path / "logs"))
    unreadable.add(tmp_path)
    with pytest.raises(CommandError, match=rf"not read {tmp_path}: give it the group .* \(desk\.logs\)$"):
        DeskLogs.open(str(tmp_path))


def test_a_log_that_cannot_be_read_says_so_in_one_line(tmp_path: Path, unreadable: set[Path]) -> None:
    """Itself and its report; one that can is given out, and one that is not there is missing."""
    (tmp_path / LOG).write_bytes(b"log")
    with closing(DeskLogs.open(str(tmp_path))) as logs:
        assert ask(logs, f"/logs/{LOG}") == (200, b"log")
        unreadable.add(tmp_path / LOG)
        for kind in ("logs", "reports"):
            status, said = ask(logs, f"/{kind}/{LOG}")
            assert (status, said.count(b"\n")) == (403, 0)
            assert f"may not read {LOG}: give it the group".encode() in said
            assert ask(logs, f"/{kind}/{LOG.replace('1', '2')}")[0] == 404
