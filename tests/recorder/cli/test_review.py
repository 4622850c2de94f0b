"""``cruiser review``."""

import argparse
import json
from pathlib import Path

import pytest

from recorder.cli.review import command as review
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings
from tests.recorder.fakes import FakeSample, Log, small_log


def run(*words: str) -> int:
    """The command's exit code."""
    parser = argparse.ArgumentParser()
    review.add_arguments(parser)
    return review.run(parser.parse_args(words), Settings(), lambda: False)


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """A whole log."""
    path = tmp_path / "whole.mcap"
    path.write_bytes(small_log())
    return path


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """The log of a recorder that was killed."""
    path = tmp_path / "cut.mcap.part"
    path.write_bytes(small_log()[:-200])
    return path


def test_a_whole_log_is_described(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For people, in lines; exit code 0."""
    assert run("info", str(whole)) == ExitCode.OK
    out = capsys.readouterr().out
    assert f"{whole}: whole" in out
    assert "robot cruiser-1, variant coarse" in out
    assert "fleet/cruiser-1/chassis/gear" in out
    assert "0 samples missed, 0 raw frames lost" in out


def test_json_is_an_object_a_line(whole: Path, cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For programs: one for each file."""
    assert run("info", "--json", str(whole), str(cut)) == ExitCode.PARTIAL
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert (first["whole"], second["whole"]) == (True, False)
    assert first["messages"] == second["messages"] == 12


def test_a_partial_log_is_shown_as_far_as_it_goes(cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 3, and what is wrong."""
    assert run("info", str(cut)) == ExitCode.PARTIAL
    out = capsys.readouterr().out
    assert "NOT WHOLE" in out
    assert "fault: byte" in out
    assert "fleet/cruiser-1/chassis/gear" in out


def test_one_file_that_is_none_is_an_error(tmp_path: Path) -> None:
    """Exit code 1, one line."""
    with pytest.raises(CommandError, match="No such file") as caught:
        run("info", str(tmp_path / "none.mcap"))
    assert caught.value.code == ExitCode.FAILURE


def test_of_several_files_the_readable_are_shown(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The others are named on stderr; part of the input could be read."""
    assert run("info", str(tmp_path / "none.mcap"), str(whole)) == ExitCode.PARTIAL
    captured = capsys.readouterr()
    assert "whole.mcap: whole" in captured.out
    assert "none.mcap: No such file" in captured.err


def test_when_no_file_can_be_read_it_is_a_failure(tmp_path: Path) -> None:
    """Exit code 1."""
    assert run("info", str(tmp_path / "one"), str(tmp_path / "two")) == ExitCode.FAILURE


def test_a_logs_names_do_not_reach_the_terminal_as_commands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A key may hold anything."""
    log = Log()
    log.receive(FakeSample("k/\x1b[2J\x07", "x", b""))
    path = tmp_path / "log.mcap"
    path.write_bytes(log.close())
    assert run("info", str(path)) == ExitCode.OK
    assert "\x1b" not in capsys.readouterr().out


def test_a_log_of_absurd_times_is_described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Times reach further than the calendar."""
    log = Log()
    log.receive(FakeSample("k", "x", b""), wall_ns=2**63 - 1)
    path = tmp_path / "log.mcap"
    path.write_bytes(log.close())
    assert run("info", str(path)) == ExitCode.OK
    assert "2262-" in capsys.readouterr().out


def test_a_killed_recorders_log_is_recovered_by_hand(cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 0: all that was written is there."""
    assert run("recover", str(cut)) == ExitCode.OK
    assert capsys.readouterr().out == f"{cut.with_suffix('')}: recovered, 12 messages\n"
    assert run("info", str(cut.with_suffix(""))) == ExitCode.OK


def test_a_recovery_as_json(cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An object a line."""
    assert run("recover", "--json", str(cut)) == ExitCode.OK
    found = json.loads(capsys.readouterr().out)
    assert (found["outcome"], found["messages"], found["kept"]) == ("recovered", 12, None)
    assert found["result"] == str(cut.with_suffix(""))


def test_a_damaged_log_is_a_partial_recovery(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 3; the faults are told, and where the rest is."""
    path = tmp_path / "x.mcap.part"
    data = bytearray(small_log())
    data[data.index(b"\x04\x00\x00\x00zstd") + 30] ^= 4
    path.write_bytes(data)
    assert run("recover", str(path)) == ExitCode.PARTIAL
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
    assert run("recover", str(empty), str(tmp_path / "none")) == ExitCode.FAILURE
    out = capsys.readouterr().out
    assert "nothing in it can be read" in out
    assert "No such file" in out
    assert run("recover", str(empty), str(cut)) == ExitCode.PARTIAL
