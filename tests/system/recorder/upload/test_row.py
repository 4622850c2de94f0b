"""Rows of the catalog are made by processes of their own."""

import asyncio
from pathlib import Path

import pytest

from recorder.review.catalog.single import read_row
from recorder.review.catalog.table import to_rows
from recorder.upload import row as rows
from recorder.upload.row import RowError, row_maker
from tests.support.logs import gears, own_log, saved


def made(log: Path) -> bytes:
    """The row of a log, by the process that the upload starts."""

    async def make() -> bytes:
        return await row_maker("recorder.review.catalog")(log)

    return asyncio.run(make())


def test_a_process_makes_the_row_of_a_log(tmp_path: Path) -> None:
    """Under the log's own name."""
    log = saved(tmp_path / "a.mcap", own_log([gears(0, 3, 0)]))
    [found] = to_rows(read_row(made(log), log.stat().st_size))
    assert (found.file, found.messages) == ("a.mcap", 3)


def test_what_is_no_log_has_no_row(tmp_path: Path) -> None:
    """The process says why."""
    log = saved(tmp_path / "a.mcap", b"no log")
    with pytest.raises(RowError, match="is no MCAP file"):
        made(log)


def test_a_row_that_takes_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its process is ended."""
    monkeypatch.setattr(rows, "ROW_S", 0.01)
    log = saved(tmp_path / "a.mcap", own_log([gears(0, 3, 0)]))
    with pytest.raises(RowError, match="given up"):
        made(log)
