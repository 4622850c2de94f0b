"""``cruiser review layouts``."""

import sys
from functools import partial
from pathlib import Path

import pytest

from recorder.layouts.attached import RobotKeys, layouts
from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.logs import small_log

run = partial(review, "layouts")


@pytest.fixture(autouse=True)
def _without_rerun(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "a.mcap"
    path.write_bytes(small_log())
    return path


def test_layouts_of_each_robot_are_written(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "layouts"
    assert run(log, "-o", out) == ExitCode.OK
    expected = {f"cruiser-1.{one.name}": one.data for one in layouts(RobotKeys("fleet/cruiser-1", "can0"))}
    assert {path.name: path.read_bytes() for path in out.iterdir()} == expected
    said = capsys.readouterr()
    assert said.out.count("fleet/cruiser-1: ") == 2
    assert "pip install -e '.[rerun]'" in said.err
