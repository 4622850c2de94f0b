"""The bar of long questions."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from recorder.cli.review.asking import progress_bar
from tests.support.recorder_fakes import small_log

CRUISER = Path(sys.executable).with_name("cruiser")


@pytest.mark.parametrize("question", [["info"], ["check"], ["query", "--csv", "SELECT * FROM chassis_gear"]])
def test_a_terminal_for_errors_takes_nothing_of_the_answer(tmp_path: Path, question: list[str]) -> None:
    """A file that stdout is sent to holds the same as where there is no terminal."""
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


def test_whoever_is_told_to_stop_stops_reading() -> None:
    """At the next bytes that are read."""
    asked_to = [False, True]
    with progress_bar("reading", 100, lambda: asked_to.pop(0)) as progress:
        progress(1)
        with pytest.raises(KeyboardInterrupt):
            progress(1)
    assert not asked_to
