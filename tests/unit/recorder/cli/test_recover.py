"""``cruiser review recover``."""

import json
from pathlib import Path

import pytest

from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.logs import small_log


def test_a_killed_recorders_log_is_recovered_by_hand(cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 0: all that was written is there."""
    assert review("recover", str(cut)) == ExitCode.OK
    assert capsys.readouterr().out == f"{cut.with_suffix('')}: recovered, 12 messages\n"
    assert review("info", str(cut.with_suffix(""))) == ExitCode.OK


def test_a_recovery_as_json(cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An object a line."""
    assert review("recover", "--json", str(cut)) == ExitCode.OK
    found = json.loads(capsys.readouterr().out)
    assert (found["outcome"], found["messages"], found["kept"]) == ("recovered", 12, None)
    assert found["result"] == str(cut.with_suffix(""))


def test_a_damaged_log_is_a_partial_recovery(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 3; the faults are told, and where the rest is."""
    path = tmp_path / "x.mcap.part"
    data = bytearray(small_log())
    data[data.index(b"\x04\x00\x00\x00zstd") + 30] ^= 4
    path.write_bytes(data)
    assert review("recover", str(path)) == ExitCode.PARTIAL
    out = capsys.readouterr().out
    assert "damaged, 2 messages" in out
    assert "fault: byte" in out
    assert f"kept in {tmp_path / 'x.mcap.damaged'}" in out


def test_what_cannot_be_recovered_is_a_failure_and_among_others_a_part(
    cut: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, and 3 where another file could be."""
    empty = tmp_path / "empty.mcap.part"
    empty.write_bytes(b"")
    assert review("recover", str(empty), str(tmp_path / "none")) == ExitCode.FAILURE
    out = capsys.readouterr().out
    assert "nothing in it can be read" in out
    assert "No such file" in out
    assert review("recover", str(empty), str(cut)) == ExitCode.PARTIAL


def test_of_a_directory_what_is_not_finished_is_recovered(cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each part, and nothing else; where there is none it says so."""
    whole = cut.parent / "whole.mcap"
    whole.write_bytes(small_log())
    assert review("recover", str(cut.parent)) == ExitCode.OK
    assert capsys.readouterr().out == f"{cut.with_suffix('')}: recovered, 12 messages\n"
    assert review("recover", str(cut.parent)) == ExitCode.OK
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "holds no log that is not finished" in captured.err
