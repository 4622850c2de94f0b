"""``cruiser upload``, without a network."""

import json
from pathlib import Path

import pytest

from recorder.cli import upload as command
from recorder.disk.files import SafeLogReader
from recorder.review.catalog.log_row import write_row
from recorder.upload.finished import ROW_SUFFIX, Summarize
from schemas.command_line import CommandError, ExitCode
from schemas.settings import RecorderSettings, Settings, UploadSettings
from tests.support.commands import run_command
from tests.support.logs import gears, own_log, saved
from tests.support.waiting import StopWhen

LOG = "cruiser-1-20270115T080000Z.mcap"


@pytest.fixture(autouse=True)
def _rows_without_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    def row_maker(_module: str) -> Summarize:
        async def make(path: Path) -> bytes:
            return write_row(path, path.name, path.stat().st_mtime_ns)  # noqa: ASYNC240 - a disk of a test

        return make

    monkeypatch.setattr(command, "row_maker", row_maker)


def settings(tmp_path: Path, **upload: object) -> Settings:
    return Settings(
        recorder=RecorderSettings(directory=str(tmp_path / "logs")),
        upload=UploadSettings(**{"store": f"file://{tmp_path}/store", **upload}),  # type: ignore[arg-type]
    )


def test_once_ends_when_all_was_tried(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    saved(tmp_path / "logs" / LOG, own_log([gears(0, 3, 0)]))
    saved(tmp_path / "logs" / "b-20270115T080000Z.mcap", b"no log")
    assert run_command(command, "--once", "--json", settings=settings(tmp_path)) == ExitCode.PARTIAL
    answer = json.loads(capsys.readouterr().out)
    assert (answer["uploaded"], answer["waiting"]) == (1, ["b-20270115T080000Z.mcap"])
    assert answer["faults"] == {"b-20270115T080000Z.mcap": "is no MCAP file"}
    assert (tmp_path / "store/cruiser-1" / LOG).read_bytes() == (tmp_path / "logs" / LOG).read_bytes()
    assert run_command(command, "--once", settings=settings(tmp_path)) == ExitCode.FAILURE


def test_it_goes_on_until_it_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "LOOK_S", 0.01)
    (tmp_path / "logs").mkdir()
    is_safe = SafeLogReader(tmp_path / "logs").read
    late = StopWhen(lambda: LOG in is_safe(), lambda: save_once(tmp_path / "logs" / LOG))
    assert run_command(command, settings=settings(tmp_path), stopped=late) == ExitCode.OK


def save_once(path: Path) -> None:
    if not path.exists():
        saved(path.with_suffix(".new"), own_log([gears(0, 3, 0)])).rename(path)


def test_a_store_that_cannot_be_written_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    saved(tmp_path / "logs" / LOG, own_log([gears(0, 3, 0)]))
    saved(tmp_path / "logs" / "b-20270115T080000Z.mcap", own_log([gears(0, 4, 0)]))
    saved(tmp_path / "store" / "cruiser-1", b"a file in the way")
    saved(tmp_path / "store" / "b", b"a file in the way")
    assert run_command(command, "--once", settings=settings(tmp_path)) == ExitCode.UNREACHABLE
    assert f"{LOG}: " in capsys.readouterr().out
    assert SafeLogReader(tmp_path / "logs").read() == {}


@pytest.mark.parametrize(
    ("upload", "fault"),
    [
        ({"store": ""}, "no store given"),
        ({"store": "nonsense"}, "unknown kind of store"),
        ({"store": "memory:///"}, "unknown kind of store"),
        ({"store": "s3://logs", "options": {"colour": "red"}}, "cannot use the store"),
    ],
)
def test_settings_that_cannot_work_are_said_at_once(tmp_path: Path, upload: dict[str, object], fault: str) -> None:
    (tmp_path / "logs").mkdir()
    with pytest.raises(CommandError, match=fault) as error:
        run_command(command, "--once", settings=settings(tmp_path, **upload))
    assert error.value.code is ExitCode.USAGE


def test_without_a_directory_there_is_nothing_to_upload(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="is no directory"):
        run_command(command, "--once", settings=settings(tmp_path))


def test_without_rows_no_log_is_read_for_them(tmp_path: Path) -> None:
    saved(tmp_path / "logs" / LOG, own_log([gears(0, 3, 0)]))
    assert run_command(command, "--once", settings=settings(tmp_path, catalog=False)) == ExitCode.OK
    assert not (tmp_path / "store/cruiser-1" / f"{LOG}{ROW_SUFFIX}").exists()
