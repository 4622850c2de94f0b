"""``cruiser review regress``."""

import json
from functools import partial
from pathlib import Path

import pytest

from schemas.exit_codes import CommandError, ExitCode
from tests.support.commands import review
from tests.support.logs import small_log
from tests.support.rigs.recorded import RecordedRig

run = partial(review, "regress", "--jobs", "1")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some seconds with 1 m/s."""
    rig, _ = RecordedRig.driving(1.0)
    rig.rest_after(1)
    path = tmp_path_factory.mktemp("logs") / "cruiser-1-20260102T030405Z.mcap"
    path.write_bytes(rig.log())
    return path


def test_nothing_differs_is_exit_code_0(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With the number of minutes."""
    assert run(log.parent) == ExitCode.OK
    assert capsys.readouterr().out == "0 of 1 minutes decide otherwise\n"


def test_what_differs_is_told_before_and_after(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With what the other questions say of it, where to ask why, and exit code 1."""
    assert run(log.parent, "--set", "command.speed_limit_mps=0.4") == ExitCode.FAILURE
    out = capsys.readouterr().out
    assert "command.speed_limit_mps: 2.222, tried 0.4" in out
    assert "as it would have been" in out
    assert "after: accepted, bound by speed" in out
    assert f"cruiser review why {log.parent} --robot cruiser-1 --at '2023-" in out
    assert out.splitlines()[-1] == "1 of 1 minutes decide otherwise"


def test_as_json_each_minute_and_then_the_sum(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An object a line."""
    assert run(log.parent, "--set", "command.speed_limit_mps=0.4", "--json") == ExitCode.FAILURE
    minute, summary = map(json.loads, capsys.readouterr().out.splitlines())
    assert minute["logs"] == [log.name]
    assert "speed" in minute["run"]["first"]["after"]
    assert summary == {"run": 1, "otherwise": 1, "other_rules": 0, "not_run": {}}


def test_a_log_without_a_journal_is_partial(tmp_path: Path) -> None:
    """There was nothing to run."""
    path = tmp_path / "log.mcap"
    path.write_bytes(small_log())
    with pytest.raises(CommandError, match="no journal") as raised:
        run(path)
    assert raised.value.code is ExitCode.PARTIAL


def test_a_wrong_setting_is_one_clear_error(log: Path) -> None:
    """With exit code 2."""
    with pytest.raises(CommandError, match="no such setting") as raised:
        run(log, "--set", "command.speed_limit=1")
    assert raised.value.code is ExitCode.USAGE
