"""``cruiser review query``."""

import subprocess
import sys
from pathlib import Path

import pytest

from schemas.command_line import ExitCode
from tests.support.drives import drive_log
from tests.support.logs import saved


@pytest.mark.parametrize(
    ("sql", "code"),
    [
        ("SELECT sequence FROM can_rx LIMIT 1", ExitCode.OK),
        ("SELECT EXISTS(SELECT 1 FROM chassis_gear)", ExitCode.OK),
        ("SELECT CAST(robot AS INT) FROM can_rx", ExitCode.USAGE),
    ],
)
def test_a_statement_that_needs_not_all_ends_well(tmp_path: Path, sql: str, code: ExitCode) -> None:
    """As a process of its own: nothing reads on when it ends."""
    log = saved(tmp_path / "1.mcap", drive_log(count=20_000))
    cruiser = Path(sys.executable).with_name("cruiser")
    for _ in range(3):
        ended = subprocess.run([cruiser, "review", "query", sql, log], capture_output=True, check=False)
        assert (ended.returncode, b"Fatal" in ended.stderr) == (code, False)
