"""``cruiser review layouts``."""

import json
import sys
from functools import partial
from pathlib import Path

import pytest

from recorder.layouts.attached import RobotKeys, layouts
from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.logs import Log, small_log
from tests.support.messages import batch, gear, info, sample_of

run = partial(review, "layouts")


@pytest.fixture(autouse=True)
def _without_rerun(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether rerun is installed here must not matter; ``make readers`` makes blueprints."""
    monkeypatch.setitem(sys.modules, "rerun", None)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A small log."""
    path = tmp_path / "a.mcap"
    path.write_bytes(small_log())
    return path


def test_layouts_of_each_robot_are_written(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same that a recorder attaches, with the bus that the log's topics name; what is missing is told."""
    out = tmp_path / "new" / "layouts"
    assert run(log, "-o", out) == ExitCode.OK
    expected = {f"cruiser-1.{one.name}": one.data for one in layouts(RobotKeys("fleet/cruiser-1", "can0"))}
    assert {path.name: path.read_bytes() for path in out.iterdir()} == expected
    said = capsys.readouterr()
    assert said.out.count("fleet/cruiser-1: ") == 2
    assert "pip install -e '.[rerun]'" in said.err


def test_json_is_an_object_a_line(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For programs: one for each file."""
    assert run(log, "-o", tmp_path, "--json") == ExitCode.OK
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert all(Path(one["path"]).exists() and one["robot"] == "fleet/cruiser-1" for one in told)


def test_robots_of_one_name_under_two_roots_have_files_of_their_own(tmp_path: Path) -> None:
    """Called by their roots; no root leads out of the directory."""
    log = Log()
    for root in ("fleet", ".."):
        log.receive(
            sample_of(gear(0), root=root), sample_of(info(), root=root), sample_of(batch(0, []), root=root)
        )
    (tmp_path / "a.mcap").write_bytes(log.close())
    assert run(tmp_path / "a.mcap", "-o", tmp_path / "out") == ExitCode.OK
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == [
        "..-cruiser-1.layout.foxglove.json",
        "..-cruiser-1.layout.plotjuggler.xml",
        "fleet-cruiser-1.layout.foxglove.json",
        "fleet-cruiser-1.layout.plotjuggler.xml",
    ]


def test_a_robot_whose_name_is_too_long_costs_no_other_its_layouts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is named; exit code as for whatever is not all of the answer."""
    log = Log()
    long = "a" * 250
    for robot in (long, "cruiser-1"):
        log.receive(sample_of(gear(0), robot), sample_of(info(), robot))
    (tmp_path / "a.mcap").write_bytes(log.close())
    assert run(tmp_path / "a.mcap", "-o", tmp_path / "out") == ExitCode.PARTIAL
    assert len(list((tmp_path / "out").glob("cruiser-1.layout.*"))) == 2
    said = capsys.readouterr()
    assert said.out.count("fleet/cruiser-1: ") == 2
    assert f"no layout of fleet/{long}: " in said.err
    assert "File name too long" in said.err
