"""Logs into a dataset, as others read it."""

import errno
import json
import random
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from recorder.mcap.framing import MAGIC
from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Progress
from recorder.review import export as parts
from recorder.review.export import (
    MANIFEST_NAME,
    Exported,
    ExportOutcome,
    ExportRange,
    ExportTask,
    Manifest,
    Runner,
    export_dataset,
    read_manifest,
    sha256_of,
)
from recorder.review.tasks import HERE, Act
from schemas.command_line import CommandError
from schemas.messages import Gear
from tests.support.drives import drive_log
from tests.support.logs import channel_of, encoded, mcap_log, numbered_log, saved, small_log
from tests.support.messages import SECOND, WALL_NS, gear


def export(
    logs: Sequence[Path],
    out: Path,
    faults: Faults | None = None,
    wanted: ExportRange | None = None,
    run: Runner = HERE,
) -> Exported:
    """Export files."""
    taken = Faults() if faults is None else faults
    found = find_logs(logs, taken, with_covered=True)
    done = export_dataset(found, out, wanted or ExportRange(), taken, run=run)
    if faults is None:
        assert not taken, taken.told
    return done


def manifest_of(directory: Path) -> Manifest:
    """The manifest, which is there."""
    found = read_manifest(directory)
    assert found is not None
    return found


def rows_by_topic(directory: Path) -> Counter[str]:
    """Rows that are in the files, by the log's topic."""
    count: Counter[str] = Counter()
    for part in manifest_of(directory).files:
        count[part.topic] += pq.read_metadata(directory / part.path).num_rows
    return count


def contents(directory: Path) -> dict[str, bytes]:
    """All files."""
    return {str(path.relative_to(directory)): path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def test_every_message_is_a_row(tmp_path: Path) -> None:
    """Of every topic as many as the mcap package reads."""
    log = saved(tmp_path / "log.mcap", drive_log())
    done = export([log], tmp_path / "out")
    with log.open("rb") as stream:
        expected = Counter(channel.topic for _, channel, _ in make_reader(stream).iter_messages())
    assert rows_by_topic(tmp_path / "out") == expected
    assert done.rows == expected.total()


def test_others_read_it_as_hive_names_it(tmp_path: Path) -> None:
    """Topic, robot and day are directories, and come back as they were."""
    export(
        [saved(tmp_path / "1.mcap", drive_log()), saved(tmp_path / "2.mcap", drive_log("cruiser-2"))],
        tmp_path / "out",
    )
    directories = {
        str(path.parent.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.parquet")
    }
    assert "topic=chassis%2Fgear/robot=cruiser-2/date=2027-01-15" in directories
    table = ds.dataset(tmp_path / "out" / "topic=chassis%2Fgear", partitioning="hive").to_table()
    assert Counter(table.column("robot").to_pylist()) == {"cruiser-1": 20, "cruiser-2": 20}
    whole = ds.dataset(tmp_path / "out", partitioning="hive", exclude_invalid_files=True)
    assert {"chassis/gear", "can/can0/rx", "safety/event/log"} <= set(
        whole.to_table(columns=["topic"]).column("topic").to_pylist()
    )


def test_the_manifest_says_what_is_there(tmp_path: Path) -> None:
    """Inputs with their hashes, files with rows, times and columns, units, and who wrote it."""
    log = saved(tmp_path / "log.mcap", drive_log())
    export([log], tmp_path / "out")
    manifest = manifest_of(tmp_path / "out")
    (found,) = manifest.inputs
    assert (found.bytes, found.sha256) == (log.stat().st_size, sha256_of(log, 1 << 40))
    assert manifest.product.startswith("cruiser-gateway ")
    gears = next(part for part in manifest.files if part.table == "chassis_gear")
    assert (gears.rows, gears.start_ns, gears.end_ns) == (20, WALL_NS, WALL_NS + 190_000_000)
    columns = {column.name: column for column in manifest.schemas[gears.columns]}
    assert (columns["time_ns"].type, columns["time_ns"].unit) == ("int64", "ns")
    assert found.rows == sum(part.rows for part in manifest.files)
    assert {part.bytes for part in manifest.files} == {
        (tmp_path / "out" / part.path).stat().st_size for part in manifest.files
    }


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    """A dataset is refused, and so is a directory that holds something else; both stay as they are."""
    log = saved(tmp_path / "log.mcap", drive_log())
    export([log], tmp_path / "out")
    before = contents(tmp_path / "out")
    with pytest.raises(CommandError, match="is a dataset already"):
        export([log], tmp_path / "out")
    assert contents(tmp_path / "out") == before
    other = tmp_path / "other"
    other.mkdir()
    (other / "letter.txt").write_text("dear")
    with pytest.raises(CommandError, match="is not empty, and no dataset"):
        export([log], other)
    assert contents(other) == {"letter.txt": b"dear"}


class FailingRunner:
    """Does the first task, and then the disk is full."""

    def __call__(
        self, act: Act[ExportTask, ExportOutcome], tasks: Sequence[ExportTask], progress: Progress
    ) -> Iterator[ExportOutcome]:
        yield from HERE(act, tasks[:1], progress)
        raise OSError(28, "No space left on device")


def test_an_export_that_fails_leaves_nothing(tmp_path: Path) -> None:
    """The next one finds an empty directory; what a killed one left in it is in nobody's way."""
    first, second = saved(tmp_path / "1.mcap", drive_log()), saved(tmp_path / "2.mcap", drive_log(first=20))
    with pytest.raises(CommandError, match="No space left"):
        export([first, second], tmp_path / "out", run=FailingRunner())
    assert contents(tmp_path / "out") == {}
    (tmp_path / "out" / ".export-dead").mkdir()
    export([first, second], tmp_path / "out")
    assert rows_by_topic(tmp_path / "out")["fleet/cruiser-1/chassis/gear"] == 40


def test_two_exports_do_not_write_at_once(tmp_path: Path) -> None:
    """The second one is told so."""
    log = saved(tmp_path / "log.mcap", drive_log())

    def run(
        act: Act[ExportTask, ExportOutcome], tasks: Sequence[ExportTask], progress: Progress
    ) -> Iterator[ExportOutcome]:
        with pytest.raises(CommandError, match="another export writes"):
            export([log], tmp_path / "out")
        yield from HERE(act, tasks, progress)

    assert export([log], tmp_path / "out", run=run).rows


def test_an_export_needs_no_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """NFS locks only what is open for writing, which a directory is not."""

    def refused(_descriptor: int, _operation: int) -> None:
        raise OSError(errno.EBADF, "Bad file descriptor")

    monkeypatch.setattr("fcntl.flock", refused)
    log = saved(tmp_path / "1.mcap", drive_log())
    assert export([log], tmp_path / "out").files


def test_a_day_is_a_directory(tmp_path: Path) -> None:
    """By the log times, in UTC."""
    until_midnight_ns = -WALL_NS % (24 * 3600 * SECOND)
    first = (until_midnight_ns - 50_000_000) // 10_000_000
    export([saved(tmp_path / "log.mcap", drive_log(first=first, count=10))], tmp_path / "out")
    gears = [part for part in manifest_of(tmp_path / "out").files if part.table == "chassis_gear"]
    assert {part.date: part.rows for part in gears} == {"2027-01-15": 5, "2027-01-16": 5}


@pytest.mark.parametrize("limit", ["FILE_BYTES", "HELD_BYTES"])
def test_rows_are_written_as_they_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str) -> None:
    """File by file, in the order of the log; no more is held than the limits say."""
    monkeypatch.setattr(parts, limit, 1)
    monkeypatch.setattr("recorder.review.columns.BATCH_BYTES", 1)
    export([saved(tmp_path / "log.mcap", drive_log(count=200))], tmp_path / "out")
    gears = [part for part in manifest_of(tmp_path / "out").files if part.table == "chassis_gear"]
    assert len(gears) > 3
    gears.sort(key=lambda part: part.start_ns)
    rows = [pq.ParquetFile(tmp_path / "out" / part.path).read().column("sequence").to_pylist() for part in gears]
    assert list(chain.from_iterable(rows)) == list(range(200))


def test_a_topic_of_any_name_has_a_directory(tmp_path: Path) -> None:
    """Slashes and signs are escaped as in a URL; a long one is cut, and still tells itself from others."""
    names = ["/../x=*?[%", "", *("/" * 500 + end for end in "ab"), "\u00e9" * 200]
    channels = [channel_of(Gear, number, name) for number, name in enumerate(names, 1)]
    chunk = [(number, encoded(gear(number))) for number in range(1, len(names) + 1)]
    export([saved(tmp_path / "log.mcap", numbered_log(channels, [chunk]))], tmp_path / "out")
    assert rows_by_topic(tmp_path / "out") == dict.fromkeys(names, 1)
    directories = {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()}
    assert len(directories) == len(names)
    assert directories >= {"topic=%2F..%2Fx%3D%2A%3F%5B%25", "topic=__HIVE_DEFAULT_PARTITION__"}


def test_rows_of_any_number_of_days_are_written(tmp_path: Path) -> None:
    """Whatever times somebody's log holds."""
    rows = [(1, n, WALL_NS + n * 24 * 3600 * SECOND, WALL_NS, encoded(gear(n))) for n in range(1100)]
    export([saved(tmp_path / "log.mcap", mcap_log([channel_of(Gear)], [rows]))], tmp_path / "out")
    assert len(manifest_of(tmp_path / "out").files) == 1100


@pytest.mark.parametrize("pattern", ["fleet/cruiser-1/chassis/gear", "chassis/*", "chassis_gear"])
def test_topics_are_chosen_by_any_of_their_names(tmp_path: Path, pattern: str) -> None:
    """The key, what follows the robot in it, or the table."""
    log = saved(tmp_path / "log.mcap", drive_log())
    assert export([log], tmp_path / "out", wanted=ExportRange([pattern])).rows == 20
    span = ExportRange([pattern], WALL_NS + 50_000_000, WALL_NS + 100_000_000)
    assert export([log], tmp_path / "span", wanted=span).rows == 5


def test_damage_is_told_and_the_rest_is_there(tmp_path: Path) -> None:
    """Random bytes flipped, files cut: never an exception, and each fault is in the manifest."""
    data = small_log()
    dice = random.Random(3)  # noqa: S311 - reproducible, not secret
    for number in range(40):
        damaged = bytearray(data)
        damaged[dice.randrange(len(MAGIC), len(data))] ^= 1 << dice.randrange(8)
        end = len(damaged) if number % 2 else dice.randrange(len(MAGIC) + 1, len(damaged))
        log = saved(tmp_path / f"{f'log{number}'}.mcap", bytes(damaged[:end]))
        faults = Faults()
        out = tmp_path / f"out{number}"
        done = export([log], out, faults)
        assert manifest_of(out).inputs[0].fault_count == faults.count
        assert done.rows == rows_by_topic(out).total() <= 12


def test_a_manifest_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    """One line."""
    for text in ("{", "[]", '{"format": "x"}', json.dumps(_manifest(version=9))):
        (tmp_path / MANIFEST_NAME).write_text(text)
        with pytest.raises(CommandError):
            read_manifest(tmp_path)


def _manifest(**others: Any) -> dict[str, Any]:  # noqa: ANN401
    empty: dict[str, Any] = {"inputs": [], "files": [], "schemas": {}}
    return {"format": "cruiser-dataset", "version": 1, "product": "", **empty, **others}
