"""Logs as CSV."""

import csv
from pathlib import Path

import pytest

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import file_name
from recorder.review import export as csv_files
from recorder.review.export import CsvFile, ExportRange, export_csv
from schemas.command_line import CommandError
from tests.support.drives import drive_log
from tests.support.logs import saved


def export(logs: list[Path], out: Path) -> list[CsvFile]:
    """Export files."""
    faults = Faults()
    done = export_csv(find_logs(logs, faults), out, ExportRange(), faults)
    assert not faults, faults.told
    return done


def rows(path: Path) -> list[dict[str, str]]:
    """The rows as Python reads them."""
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_one_file_a_topic(tmp_path: Path) -> None:
    """All logs' rows under one head; names, times and enumerations as text."""
    logs = [saved(tmp_path / "1.mcap", drive_log()), saved(tmp_path / "2.mcap", drive_log(first=20))]
    done = export(logs, tmp_path / "out")
    assert {Path(file.path).name for file in done} >= {
        "fleet.cruiser-1.chassis.gear.csv",
        "fleet.cruiser-1.can.can0.rx.csv",
        "fleet.cruiser-1.strange.csv",
    }
    gears = rows(tmp_path / "out" / "fleet.cruiser-1.chassis.gear.csv")
    assert [row["sequence"] for row in gears] == [str(number) for number in range(40)]
    assert gears[1]["log_time"] == "2027-01-15T08:00:00.010000000Z"
    assert (gears[1]["gear_position"], gears[1]["active"]) == ("drive", "true")
    assert next(file.rows for file in done if file.topic.endswith("gear")) == 40


def test_bytes_are_digits_and_what_is_nested_is_json(tmp_path: Path) -> None:
    """Data of frames in hexadecimal; maps as objects."""
    export([saved(tmp_path / "1.mcap", drive_log())], tmp_path / "out")
    frame = rows(tmp_path / "out" / "fleet.cruiser-1.can.can0.rx.csv")[1]
    assert frame["data"] == "0104000000001015"
    info = rows(tmp_path / "out" / "fleet.cruiser-1.gateway.info.csv")[0]
    assert info["versions"] == '{"cruiser-gateway":"0.1.0"}'


def test_few_files_are_open_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that is opened again goes on where it was."""
    log = saved(tmp_path / "1.mcap", drive_log(count=200))
    export([log], tmp_path / "all")
    monkeypatch.setattr(csv_files, "OPEN_MAX", 1)
    monkeypatch.setattr("recorder.review.columns.BATCH_BYTES", 1)
    export([log], tmp_path / "few")
    for path in (tmp_path / "all").iterdir():
        assert (tmp_path / "few" / path.name).read_bytes() == path.read_bytes()


def test_any_topic_is_one_file_name() -> None:
    """Dots within a chunk are escaped: no two topics have one name."""
    assert file_name("/a.b/c") == "%2Fa%2Eb.c"
    assert file_name("a/b.c") != file_name("a.b/c")
    assert file_name("") == "%"
    assert "/" not in file_name("a\\/..\n")


def test_of_an_export_that_is_broken_off_nothing_is_left(tmp_path: Path) -> None:
    """Half a file is not taken for all of a drive."""

    def stop(_bytes: int) -> None:
        raise KeyboardInterrupt

    logs = find_logs([saved(tmp_path / "1.mcap", drive_log())], Faults())
    with pytest.raises(KeyboardInterrupt):
        export_csv(logs, tmp_path / "out", ExportRange(), Faults(), stop)
    assert list((tmp_path / "out").iterdir()) == []


def test_what_another_export_is_writing_stays(tmp_path: Path) -> None:
    """It is named, and not taken for a part of this one."""
    logs = find_logs([saved(tmp_path / "1.mcap", drive_log())], Faults())
    [*_, one] = export_csv(logs, tmp_path / "first", ExportRange(), Faults())
    part = tmp_path / "out" / f"{Path(one.path).name}.part"
    part.parent.mkdir()
    part.write_text("theirs")
    with pytest.raises(CommandError, match="part is there already"):
        export_csv(logs, part.parent, ExportRange(), Faults())
    assert [(path, path.read_text()) for path in part.parent.iterdir()] == [(part, "theirs")]
