"""The progress bar of long questions."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.logs import small_log

CRUISER = Path(sys.executable).with_name("cruiser")


@pytest.mark.parametrize("question", [["info"], ["check"], ["query", "--csv", "SELECT * FROM chassis_gear"]])
def test_a_terminal_for_errors_takes_nothing_of_the_answer(tmp_path: Path, question: list[str]) -> None:
    log = tmp_path / "cruiser-1-20260102T030405Z.mcap"
    log.write_bytes(small_log())
    command = [str(CRUISER), "review", *question, str(log)]
    expected = subprocess.run(command, capture_output=True, check=False).stdout
    terminal, other = pty.openpty()
    out = tmp_path / "out.txt"
    try:
        with out.open("wb") as stream:
            subprocess.run(command, stdout=stream, stderr=other, check=False)
    finally:
        os.close(other)
        os.close(terminal)
    assert expected
    assert out.read_bytes() == expected
