"""Logs at the desk: their reports, and what these may take."""

import asyncio
import inspect
from pathlib import Path

import pytest

from gateway.cli.desk_logs import DeskLogs
from schemas.web import jobs
from schemas.web.jobs import ask_review
from tests.support.rigs.scenarios import front_bumper, recorded

LOG = "cruiser-1-20260102T030405Z.mcap"


@pytest.mark.parametrize(("mib", "is_made"), [(2048, True), (48, False)])
def test_a_report_takes_so_much_memory_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mib: int, *, is_made: bool
) -> None:
    """One that would take more ends, and not the machine; there is a word about it, and no half report."""
    monkeypatch.setattr(jobs, "JOB_BYTES", mib << 20)
    log, report = tmp_path / LOG, tmp_path / "report.html"
    log.write_bytes(recorded(front_bumper))
    done = asyncio.run(ask_review(["report", str(log), "-o", str(report)]))
    assert (done.code == 0) is is_made
    assert done.output or done.fault
    assert report.is_file() is is_made


def test_no_directory_holds_up_the_desk(tmp_path: Path) -> None:
    """However many logs are in it: it is looked through beside the loop that passes on stops and drives."""
    logs = DeskLogs(tmp_path)
    try:
        (listing,) = (one.endpoint for one in logs.routes() if "robot" in one.path)
        assert not inspect.iscoroutinefunction(listing)
    finally:
        logs.close()
