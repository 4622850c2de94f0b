"""``cruiser review export``."""

import json
import os
import sys
from functools import partial
from pathlib import Path

import pytest

from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.drives import FRAMES, drive_log
from tests.support.logs import saved, small_log

run = partial(review, "export")


def test_an_export_that_is_stopped_leaves_nothing(tmp_path: Path) -> None:
    """Ctrl-C, once."""
    with pytest.raises(KeyboardInterrupt):
        run("-o", tmp_path / "out", saved(tmp_path / "1.mcap", drive_log()), is_stopped=True)
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_what_is_not_installed_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    """One line says what to install."""
    for name in [name for name in sys.modules if name.startswith("recorder.review.export")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(CommandError, match=r"this needs pyarrow: pip install -e '\.\[review\]'"):
        run("--format", form, "-o", tmp_path / "out", saved(tmp_path / "1.mcap", drive_log()))


def test_a_dataset_is_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line says how much it is; exit code 0."""
    log = saved(tmp_path / "1.mcap", drive_log())
    assert run("-o", tmp_path / "out", log) == ExitCode.OK
    out = capsys.readouterr().out
    assert out.startswith(f"{tmp_path / 'out'}: 29 rows in 6 files, 0.")


@pytest.mark.parametrize("form", ["parquet", "csv", "blf"])
def test_a_place_on_a_network_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    """A folder called ``s3:`` is not what was meant; where it is, there is ./s3:."""
    monkeypatch.chdir(tmp_path)
    log = saved(tmp_path / "1.mcap", drive_log())
    with pytest.raises(CommandError, match=r"s3:/bucket/logs is no directory: .*\(aws s3 sync") as caught:
        run("--format", form, "-o", "s3://bucket/logs", log)
    assert caught.value.code == ExitCode.USAGE
    assert list(tmp_path.iterdir()) == [log]


def test_json_says_all_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For programs: inputs, files."""
    assert run("--json", "-o", tmp_path / "out", saved(tmp_path / "1.mcap", drive_log())) == ExitCode.OK
    done = json.loads(capsys.readouterr().out)
    assert done["inputs"][0]["rows"] == sum(part["rows"] for part in done["files"]) == 29


def test_a_name_that_is_not_utf_8_is_escaped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In the manifest, and in what is printed, also of a log that is damaged."""
    log = saved(Path(os.fsdecode(bytes(tmp_path) + b"/\xff.mcap")), drive_log())
    cut = saved(Path(os.fsdecode(bytes(tmp_path) + b"/\xfe.mcap")), drive_log(count=10)[:-100])
    assert run("--json", "-o", tmp_path / "out", log, cut) == ExitCode.PARTIAL
    first = json.loads(capsys.readouterr().out)
    escaped = str(tmp_path / r"\udcff.mcap")
    assert escaped in {one["path"] for one in first["inputs"]}
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_bytes())
    assert escaped in {one["path"] for one in manifest["inputs"]}


@pytest.mark.parametrize(("form", "suffix"), [("candump", "log"), ("asc", "asc"), ("blf", "blf")])
def test_raw_frames_are_one_file_a_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str, suffix: str
) -> None:
    """In each format; a file that is there is refused."""
    logs = [saved(tmp_path / "1.mcap", drive_log()), saved(tmp_path / "2.mcap", drive_log("cruiser-2"))]
    assert run("--format", form, "-o", tmp_path / "out", *logs) == ExitCode.OK
    out = capsys.readouterr().out
    assert f"cruiser-2.{suffix}: {FRAMES} frames\n" in out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"cruiser-1.{suffix}", f"cruiser-2.{suffix}"}
    with pytest.raises(CommandError, match="is there already"):
        run("--format", form, "-o", tmp_path / "out", *logs)


def test_csv_is_one_file_a_topic(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Chosen topics alone."""
    log = saved(tmp_path / "1.mcap", drive_log())
    assert run("--format", "csv", "--topic", "chassis/*", "-o", tmp_path / "out", log) == ExitCode.OK
    assert capsys.readouterr().out == f"{tmp_path / 'out' / 'fleet.cruiser-1.chassis.gear.csv'}: 20 rows\n"


@pytest.mark.parametrize("words", [["--processes", "2"], ["--ray", "auto"]])
def test_what_only_a_dataset_has_is_refused_elsewhere(tmp_path: Path, words: list[str]) -> None:
    """Exit code 2."""
    with pytest.raises(CommandError, match="--format parquet") as caught:
        run("--format", "csv", *words, "-o", tmp_path / "out", saved(tmp_path / "1.mcap", small_log()))
    assert caught.value.code == ExitCode.USAGE


def test_a_time_is_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the log's beginning."""
    log = saved(tmp_path / "1.mcap", drive_log())
    words = ["--topic", "chassis_gear", "--from", "0.05", "--to", "0.1"]
    assert run(*words, "-o", tmp_path / "out", log) == ExitCode.OK
    assert ": 5 rows in 1 files" in capsys.readouterr().out
