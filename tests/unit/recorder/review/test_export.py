"""Logs as a dataset, read by other tools, and as CSV."""

import csv
import json
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from decimal import Decimal
from itertools import chain
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Progress, file_name
from recorder.review import export as module
from recorder.review.export import (
    MANIFEST_NAME,
    Exported,
    ExportOutcome,
    ExportRange,
    ExportTask,
    Manifest,
    Runner,
    cells,
    csv_text,
    export_dataset,
    objects,
    read_manifest,
    sha256_of,
    values,
)
from recorder.review.tasks import HERE, Act
from schemas.command_line import CommandError, ExitCode
from schemas.messages import Gear
from tests.support.commands import review
from tests.support.drives import drive_log
from tests.support.logs import channel_of, encoded, mcap_log, numbered_log, saved
from tests.support.messages import SECOND, WALL_NS, gear

DAY_NS = 24 * 3600 * SECOND


def export(
    logs: Sequence[Path],
    out: Path,
    faults: Faults | None = None,
    wanted: ExportRange | None = None,
    run: Runner = HERE,
) -> Exported:
    taken = Faults() if faults is None else faults
    found = find_logs(logs, taken, with_covered=True)
    done = export_dataset(found, out, wanted or ExportRange(), taken, run=run)
    if faults is None:
        assert not taken, taken.told
    return done


def manifest_of(directory: Path) -> Manifest:
    found = read_manifest(directory)
    assert found is not None
    return found


def rows_by_topic(directory: Path) -> Counter[str]:
    count: Counter[str] = Counter()
    for part in manifest_of(directory).files:
        count[part.topic] += pq.read_metadata(directory / part.path).num_rows
    return count


def contents(directory: Path) -> dict[str, bytes]:
    return {str(path.relative_to(directory)): path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def test_every_message_is_a_row_and_the_manifest_says_what_is_there(tmp_path: Path) -> None:
    log = saved(tmp_path / "log.mcap", drive_log())
    done = export([log], tmp_path / "out")
    with log.open("rb") as stream:
        expected = Counter(channel.topic for _, channel, _ in make_reader(stream).iter_messages())
    assert rows_by_topic(tmp_path / "out") == expected
    manifest = manifest_of(tmp_path / "out")
    (found,) = manifest.inputs
    assert (found.bytes, found.sha256) == (log.stat().st_size, sha256_of(log, 1 << 40))
    assert done.rows == found.rows == sum(part.rows for part in manifest.files) == expected.total()
    gears = next(part for part in manifest.files if part.table == "chassis_gear")
    columns = {column.name: column for column in manifest.schemas[gears.columns]}
    assert (gears.rows, columns["time_ns"].type, columns["time_ns"].unit) == (20, "int64", "ns")


def test_others_read_it_as_hive_names_it(tmp_path: Path) -> None:
    logs = [saved(tmp_path / f"{robot}.mcap", drive_log(robot)) for robot in ("cruiser-1", "cruiser-2")]
    export(logs, tmp_path / "out")
    assert (tmp_path / "out/topic=chassis%2Fgear/robot=cruiser-2/date=2027-01-15").is_dir()
    table = ds.dataset(tmp_path / "out" / "topic=chassis%2Fgear", partitioning="hive").to_table()
    assert Counter(table.column("robot").to_pylist()) == {"cruiser-1": 20, "cruiser-2": 20}
    whole = ds.dataset(tmp_path / "out", partitioning="hive", exclude_invalid_files=True)
    topics = set(whole.to_table(columns=["topic"]).column("topic").to_pylist())
    assert {"chassis/gear", "can/can0/rx", "safety/event/log"} <= topics


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    log = saved(tmp_path / "log.mcap", drive_log())
    export([log], tmp_path / "out")
    saved(tmp_path / "other" / "letter.txt", b"dear")
    for name, why in (("out", "is a dataset already"), ("other", "is not empty, and no dataset")):
        before = contents(tmp_path / name)
        with pytest.raises(CommandError, match=why):
            export([log], tmp_path / name)
        assert contents(tmp_path / name) == before


def run_first(
    act: Act[ExportTask, ExportOutcome], tasks: Sequence[ExportTask], progress: Progress
) -> Iterator[ExportOutcome]:
    yield from HERE(act, tasks[:1], progress)
    raise OSError(28, "No space left on device")


def test_an_export_that_fails_leaves_nothing(tmp_path: Path) -> None:
    first, second = saved(tmp_path / "1.mcap", drive_log()), saved(tmp_path / "2.mcap", drive_log(first=20))
    with pytest.raises(CommandError, match="No space left"):
        export([first, second], tmp_path / "out", run=run_first)
    assert contents(tmp_path / "out") == {}
    (tmp_path / "out" / ".export-dead").mkdir()
    export([first, second], tmp_path / "out")
    assert rows_by_topic(tmp_path / "out")["fleet/cruiser-1/chassis/gear"] == 40


@pytest.mark.parametrize("form", ["parquet", "csv", "candump"])
def test_an_export_that_is_stopped_leaves_nothing(tmp_path: Path, form: str) -> None:
    log = saved(tmp_path / "1.mcap", drive_log())
    with pytest.raises(KeyboardInterrupt):
        review("export", "--format", form, "-o", tmp_path / "out", log, is_stopped=True)
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_what_is_not_installed_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    monkeypatch.delattr("recorder.review.export")
    monkeypatch.delitem(sys.modules, "recorder.review.export")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(CommandError, match=r"this needs pyarrow: pip install -e '\.\[review\]'"):
        review("export", "--format", form, "-o", tmp_path / "out", saved(tmp_path / "1.mcap", drive_log()))


def test_any_number_of_days_are_directories(tmp_path: Path) -> None:
    rows = [(1, n, WALL_NS + n * DAY_NS // 2, WALL_NS, encoded(gear(n))) for n in range(1100)]
    export([saved(tmp_path / "log.mcap", mcap_log([channel_of(Gear)], [rows]))], tmp_path / "out")
    assert {part.rows for part in manifest_of(tmp_path / "out").files} == {2}
    assert len(manifest_of(tmp_path / "out").files) == 550


@pytest.mark.parametrize("limit", ["FILE_BYTES", "HELD_BYTES"])
def test_rows_are_written_as_they_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str) -> None:
    monkeypatch.setattr(module, limit, 1)
    monkeypatch.setattr("recorder.review.columns.BATCH_BYTES", 1)
    export([saved(tmp_path / "log.mcap", drive_log(count=200))], tmp_path / "out")
    gears = [part for part in manifest_of(tmp_path / "out").files if part.table == "chassis_gear"]
    assert len(gears) > 3
    rows = [pq.ParquetFile(tmp_path / "out" / part.path).read().column("sequence").to_pylist() for part in gears]
    assert list(chain.from_iterable(sorted(rows))) == list(range(200))


def test_a_topic_of_any_name_has_a_directory(tmp_path: Path) -> None:
    names = ["/../x=*?[%", "", *("/" * 500 + end for end in "ab"), "\u00e9" * 200]
    channels = [channel_of(Gear, number, name) for number, name in enumerate(names, 1)]
    chunk = [(number, encoded(gear(number))) for number in range(1, len(names) + 1)]
    export([saved(tmp_path / "log.mcap", numbered_log(channels, [chunk]))], tmp_path / "out")
    assert rows_by_topic(tmp_path / "out") == dict.fromkeys(names, 1)
    directories = {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()}
    assert len(directories) == len(names)
    assert directories >= {"topic=%2F..%2Fx%3D%2A%3F%5B%25", "topic=__HIVE_DEFAULT_PARTITION__"}


@pytest.mark.parametrize("pattern", ["fleet/cruiser-1/chassis/gear", "chassis/*", "chassis_gear"])
def test_topics_are_chosen_by_any_of_their_names(tmp_path: Path, pattern: str) -> None:
    log = saved(tmp_path / "log.mcap", drive_log())
    span = ExportRange([pattern], WALL_NS + 50_000_000, WALL_NS + 100_000_000)
    for number, (wanted, rows) in enumerate(((ExportRange([pattern]), 20), (span, 5))):
        assert export([log], tmp_path / str(number), wanted=wanted).rows == rows


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"format": "x"}', json.dumps({"format": "cruiser-dataset", "version": 9, "product": ""})]
)
def test_a_manifest_that_cannot_be_read_is_told(tmp_path: Path, text: str) -> None:
    saved(tmp_path / MANIFEST_NAME, text.encode())
    with pytest.raises(CommandError, match=MANIFEST_NAME):
        read_manifest(tmp_path)


# CSV, and the cells of all answers.


def test_csv_is_one_file_a_topic(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recorder.review.columns.BATCH_BYTES", 1)
    logs = [saved(tmp_path / f"{first}.mcap", drive_log(first=first)) for first in (0, 20)]
    out = tmp_path / "out"
    assert review("export", "--format", "csv", "-o", out, *logs) == ExitCode.OK
    found = {path.name: list(csv.DictReader(path.read_text().splitlines())) for path in out.iterdir()}
    gears = found["fleet.cruiser-1.chassis.gear.csv"]
    assert [row["sequence"] for row in gears] == [str(number) for number in range(40)]
    assert gears[1]["log_time"] == "2027-01-15T08:00:00.010000000Z"
    assert (gears[1]["gear_position"], gears[1]["active"]) == ("drive", "true")
    assert found["fleet.cruiser-1.can.can0.rx.csv"][1]["data"] == "0104000000001015"
    assert found["fleet.cruiser-1.gateway.info.csv"][0]["versions"] == '{"cruiser-gateway":"0.1.0"}'


def test_any_topic_is_one_file_name() -> None:
    assert file_name("/a.b/c") == "%2Fa%2Eb.c"
    assert file_name("a/b.c") != file_name("a.b/c")
    assert file_name("") == "%"
    assert "/" not in file_name("a\\/..\n")


MAP, ZONED = pa.map_(pa.string(), pa.int64()), pa.timestamp("ns", "UTC")
NOW_NS, NOW = 1_800_000_000_000_000_001, "2027-01-15T08:00:00.000000001"
CASES: list[tuple[pa.Array, list[Any], list[Any]]] = [
    (pa.array([1, None]), [1, None], [1, None]),
    (pa.array([1.5]), [1.5], [1.5]),
    (pa.array([True, None]), [True, None], [True, None]),
    (pa.array(["a", None, ""]), ["a", None, ""], ["a", None, ""]),
    (pa.array(["a", None]).dictionary_encode(), ["a", None], ["a", None]),
    (pa.array([b"\x00\xff", None, b""]), ["AP8=", None, ""], ["00ff", None, ""]),
    (pa.array([b"\x01"], pa.large_binary()), ["AQ=="], ["01"]),
    (pa.array([NOW_NS, None], ZONED), [f"{NOW}Z", None], [f"{NOW}Z", None]),
    (pa.array([0], pa.timestamp("us")), ["1970-01-01T00:00:00.000000"], ["1970-01-01T00:00:00.000000"]),
    (pa.array([5], pa.date32()), ["1970-01-06"], ["1970-01-06"]),
    (pa.array([Decimal("1.50")]), ["1.50"], ["1.50"]),
    (pa.array([None, None]), [None, None], [None, None]),
    (pa.array([[1, 2], None, []]), [[1, 2], None, []], ["[1,2]", None, "[]"]),
    (pa.array([[b"a"], [None]]), [["YQ=="], [None]], ['["YQ=="]', "[null]"]),
    (pa.array([{"a": 1, "b": [b"x"]}, None]), [{"a": 1, "b": ["eA=="]}, None], ['{"a":1,"b":["eA=="]}', None]),
    (pa.array([[("k", 1)], None, []], MAP), [{"k": 1}, None, {}], ['{"k":1}', None, "{}"]),
    (pa.array([[(7, "x")]], pa.map_(pa.int32(), pa.string())), [{"7": "x"}], ['{"7":"x"}']),
    (pa.array([[NOW_NS]], pa.list_(pa.timestamp("ns"))), [[NOW]], [f'["{NOW}"]']),
]


@pytest.mark.parametrize(("array", "as_json", "as_cells"), CASES, ids=lambda case: str(getattr(case, "type", "")))
def test_every_type_has_its_text(array: pa.Array, as_json: list[Any], as_cells: list[Any]) -> None:
    assert values(array) == as_json
    longer = pa.concat_arrays([array, array])
    assert values(longer[len(array) :]) == as_json
    rows = pa.RecordBatch.from_arrays([longer[len(array) :]], names=["x"])
    assert cells(rows).column("x").to_pylist() == as_cells


def test_rows_are_objects_and_lines() -> None:
    rows = pa.RecordBatch.from_pydict({"a": [1, 2], "b": ["", None]})
    assert list(objects(rows)) == [{"a": 1, "b": ""}, {"a": 2, "b": None}]
    assert csv_text(rows, with_header=True) == '"a","b"\n1,""\n2,\n'
    schema = pa.schema([("a", pa.int64()), ("b", pa.string()), ("c", pa.binary()), ("d", pa.list_(pa.binary()))])
    assert csv_text(pa.RecordBatch.from_pylist([], schema=schema), with_header=True) == '"a","b","c","d"\n'
