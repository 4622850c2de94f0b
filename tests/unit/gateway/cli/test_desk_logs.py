"""The logs of a directory, for browsers."""

import os
from contextlib import closing
from pathlib import Path

import pytest
from starlette.applications import Starlette

from gateway.cli.desk_logs import DeskLogs
from schemas.exit_codes import CommandError
from tests.support.asgi import ask

LOG = "cruiser-1-20260102T030405Z.mcap"


@pytest.fixture
def unreadable(monkeypatch: pytest.MonkeyPatch) -> set[Path]:
    """What the desk's user may not read: root, who may run this, reads everything."""
    paths: set[Path] = set()
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) not in paths and access(path, mode))
    return paths


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
        app = Starlette(routes=logs.routes())
        assert ask(app, f"/logs/{LOG}").body == b"log"
        unreadable.add(tmp_path / LOG)
        for kind in ("logs", "reports"):
            answer = ask(app, f"/{kind}/{LOG}")
            assert (answer.status, answer.text.count("\n")) == (403, 0)
            assert f"may not read {LOG}: give it the group" in answer.text
            assert ask(app, f"/{kind}/{LOG.replace('1', '2')}").status == 404


@pytest.mark.parametrize("is_link", [True, False])
def test_what_becomes_a_link_while_it_is_asked_for_is_not_followed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    is_link: bool,  # noqa: FBT001 - a parameter
) -> None:
    """A recorder that was taken over could have the desk give out its own keys, or wait at a FIFO."""
    (tmp_path / "https.key").write_bytes(b"secret")
    log = tmp_path / LOG
    log.write_bytes(b"log")
    find = DeskLogs.path

    def change(logs: DeskLogs, name: str) -> Path | None:
        found = find(logs, name)
        log.unlink()
        if is_link:
            log.symlink_to(tmp_path / "https.key")
        else:
            os.mkfifo(log)
        return found

    with closing(DeskLogs.open(str(tmp_path))) as logs:
        app = Starlette(routes=logs.routes())
        assert ask(app, f"/logs/{LOG}").body == b"log"
        open_before = len(list(Path("/proc/self/fd").iterdir()))
        monkeypatch.setattr(DeskLogs, "path", change)
        answer = ask(app, f"/logs/{LOG}")
        assert (answer.status, answer.text) == (404, "there is no such log")
        assert len(list(Path("/proc/self/fd").iterdir())) == open_before
