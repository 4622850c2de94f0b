import sys
from pathlib import Path

import pytest

from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.review.export.one_log import ExportRange, ExportTask
from recorder.review.export.spread import decode_task, encode_task
from tests.support.drives import drive_log
from tests.support.logs import saved


def test_a_task_goes_as_json(tmp_path: Path) -> None:
    """To another process or machine."""
    logs = find_logs([saved(tmp_path / "1.mcap", drive_log())], Faults())
    task = ExportTask(logs[0], "ab", logs, tmp_path, ExportRange(["*"], 5))
    assert decode_task(encode_task(task)) == task


def test_daft_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """What to install."""
    from recorder.review.export import spread  # noqa: PLC0415
    from schemas.exit_codes import CommandError  # noqa: PLC0415

    monkeypatch.setitem(sys.modules, "daft", None)
    with pytest.raises(CommandError, match=r"pip install -e '\.\[daft\]'"):
        spread.daft_runner()
