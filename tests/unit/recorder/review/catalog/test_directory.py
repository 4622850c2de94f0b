"""The catalog of a directory, compared with a new one made from the logs."""

import fcntl
import os
import resource
from collections.abc import Callable
from functools import lru_cache
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.reading.logs import Faults
from recorder.review.catalog import directory as catalog_table
from recorder.review.catalog.directory import CATALOG_NAME, SCHEMA, Catalog, read_table, to_rows
from recorder.review.catalog.log_row import FORMAT, CatalogRow, CatalogUnreadableError
from recorder.review.info import read_info
from tests.support.drives import drive_log, drive_messages, restart, write_messages
from tests.support.logs import foreign_log, saved, small_log

TIMES = count(1_800_000_000_000_000_000, 1_000_000_000)
"""When files are changed: the clock of a file system may stand still for some milliseconds."""


@lru_cache
def contents() -> tuple[bytes, ...]:
    """Logs of several kinds: drives, a restart, foreign, damaged, and no log."""
    with TemporaryDirectory() as directory:
        path = Path(directory) / "a.mcap"
        drive = write_messages(path, drive_messages(8)).read_bytes()
        died = write_messages(path, restart(8, 30)).read_bytes()
    return drive, died, drive_log(), foreign_log(), drive[:-300], small_log(), b"", b"no log at all"


def put(path: Path, data: bytes) -> None:
    saved(path, data)
    touch(path)


def touch(path: Path) -> None:
    time_ns = next(TIMES)
    os.utime(path, ns=(time_ns, time_ns))


def refreshed(path: Path, *, kept: Path | None = None, faults: Faults | None = None) -> Catalog:
    catalog = Catalog(path, SCHEMA.names, kept)
    catalog.refresh(Faults() if faults is None else faults)
    return catalog


def rows(path: Path, *, kept: Path | None = None) -> list[CatalogRow]:
    return to_rows(refreshed(path, kept=kept).table)


NAMES = ("a.mcap", "b.mcap", "a.incident.mcap", "c.mcap.part")
CHANGES = st.one_of(
    st.tuples(st.just("put"), st.sampled_from(NAMES), st.integers(0, 7)),
    st.tuples(st.sampled_from(["touch", "remove"]), st.sampled_from(NAMES), st.just(0)),
    st.tuples(st.just("refresh"), st.just(""), st.just(0)),
)


@given(changes=st.lists(CHANGES, max_size=8))
def test_a_catalog_that_grew_is_the_one_that_is_made_anew(changes: list[tuple[str, str, int]]) -> None:
    with TemporaryDirectory() as name:
        directory = Path(name) / "logs"
        directory.mkdir()
        for what, file, number in changes:
            path = directory / file
            if what == "refresh":
                refreshed(directory)
            elif what == "put":
                put(path, contents()[number])
            elif path.exists() and what == "touch":
                touch(path)
            elif path.exists():
                path.unlink()
        grown = rows(directory)
        assert grown == rows(directory, kept=directory.parent / "new.parquet")
        assert grown == rows(directory)
        assert {row.file for row in grown} <= {path.name for path in directory.iterdir()}


def test_a_row_says_what_the_questions_say(tmp_path: Path) -> None:
    write_messages(tmp_path / "a.mcap", drive_messages(60))
    (row,) = rows(tmp_path)
    info = read_info(tmp_path / "a.mcap")
    assert (row.file, row.bytes, row.messages, row.is_whole) == ("a.mcap", info.bytes, info.messages, True)
    assert row.distance_m == pytest.approx(2.95)
    assert row.stops == {"front_bumper": 1}
    assert [driver.name for driver in row.operators] == ["operator-1"]
    assert [(one.kind, one.reason, one.is_stop) for one in row.moments if one.kind != "gap"] == [
        ("refusal", "no_lease", False),
        ("stop", "front_bumper", True),
    ]
    assert [drive.stops for drive in row.drives] == [1]
    assert row.lost == 0
    assert row.settings == ["ab" * 32]
    assert row.versions == info.versions


@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_changes_no_answer(place: float, bit: int) -> None:
    with TemporaryDirectory() as name:
        directory = Path(name)
        put(directory / "a.mcap", contents()[0])
        truth = rows(directory)
        path = directory / CATALOG_NAME
        data = bytearray(path.read_bytes())
        data[int(place * len(data))] ^= 1 << bit
        path.write_bytes(data)
        assert rows(directory) == truth


def test_a_log_that_is_being_written_has_no_row_and_is_named(tmp_path: Path) -> None:
    put(tmp_path / "a.mcap.part", contents()[4])
    put(tmp_path / "b.mcap.part", contents()[4])
    with (tmp_path / "a.mcap.part").open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        catalog = refreshed(tmp_path)
    assert [path.name for path in catalog.being_written] == ["a.mcap.part"]
    (row,) = to_rows(catalog.table)
    assert (row.file, row.is_whole) == ("b.mcap.part", False)
    assert row.damage


def test_what_cannot_be_read_has_a_row_and_is_tried_once(tmp_path: Path) -> None:
    put(tmp_path / "a.mcap", contents()[0])
    put(tmp_path / "b.mcap", b"")
    put(tmp_path / "c.mcap", b"no log at all")
    (tmp_path / "d.mcap").symlink_to(tmp_path / "nowhere")
    for number in range(3):
        faults = Faults()
        found = {row.file: row for row in to_rows(refreshed(tmp_path, faults=faults).table)}
        assert faults.count == (3 if number == 0 else 1)
        assert {name: row.damage for name, row in found.items()} == {
            "a.mcap": [],
            "b.mcap": ["unreadable: is empty"],
            "c.mcap": ["unreadable: is no MCAP file"],
        }
        assert (found["c.mcap"].bytes, found["c.mcap"].faults, found["c.mcap"].is_whole) == (13, 1, False)
    put(tmp_path / "b.mcap", contents()[0])
    assert {row.file for row in rows(tmp_path) if not row.damage} == {"a.mcap", "b.mcap"}


def test_a_disk_that_takes_no_catalog_costs_no_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_given: object, **_named: object) -> None:
        raise OSError(30, "Read-only file system")

    put(tmp_path / "a.mcap", contents()[0])
    monkeypatch.setattr(pq, "write_table", refuse)
    catalog = refreshed(tmp_path)
    assert [row.file for row in to_rows(catalog.table)] == ["a.mcap"]
    assert "Read-only file system" in catalog.notes[0]
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def is_held(path: Path) -> bool:
    catalog = Catalog(path, SCHEMA.names)
    return bool(catalog.table.num_rows) and not catalog.stale and not catalog.notes


def test_only_what_is_new_or_has_changed_is_opened(tmp_path: Path) -> None:
    refreshed(tmp_path)
    assert not list(tmp_path.iterdir())
    for number, name in enumerate(("a.mcap", "b.mcap", "\udcff.mcap")):
        put(Path(os.fsdecode(os.fsencode(tmp_path / name))), contents()[number])
    left = iter([None] * 2)

    def progress(_count: int) -> None:
        if next(left, 1) is not None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Catalog(tmp_path, SCHEMA.names).refresh(Faults(), progress)
    assert [one.name for one in Catalog(tmp_path, SCHEMA.names).stale] == ["a.mcap", "b.mcap"]
    refreshed(tmp_path)
    before = (tmp_path / CATALOG_NAME).stat()
    assert sorted(row.file for row in rows(tmp_path)) == ["\\xff.mcap", "a.mcap", "b.mcap"]
    after = (tmp_path / CATALOG_NAME).stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


# A catalog of somebody else's making, or a damaged one, may lie in the directory.


def flipped(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[:4] + bytes(byte ^ 0x10 for byte in data[4:200]) + data[200:])


def twice(path: Path) -> None:
    table = pq.read_table(path)
    pq.write_table(pa.concat_tables([table, table]), path)


def old(path: Path) -> None:
    pq.write_table(pq.read_table(path).replace_schema_metadata({"format": FORMAT, "version": "0"}), path)


def fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


CATALOGS: dict[str, tuple[Callable[[Path], object], str]] = {
    "flipped": (flipped, "is damaged"),
    "cut": (lambda path: path.write_bytes(path.read_bytes()[:-20]), "is damaged"),
    "empty": (lambda path: path.write_bytes(b""), "is damaged"),
    "no Parquet": (lambda path: path.write_bytes(b"file,bytes\n"), "is damaged"),
    "somebody else's": (lambda path: pq.write_table(SCHEMA.remove_metadata().empty_table(), path), "none"),
    "of another version": (old, "is of another version"),
    "a log twice": (twice, "names a log twice"),
    "no regular file": (fifo, "is a "),
}


@pytest.mark.parametrize("kind", CATALOGS)
def test_a_catalog_that_cannot_be_read_is_made_anew_with_a_line(tmp_path: Path, kind: str) -> None:
    change, why = CATALOGS[kind]
    put(tmp_path / "a.mcap", contents()[0])
    truth = rows(tmp_path)
    change(tmp_path / CATALOG_NAME)
    catalog = refreshed(tmp_path)
    assert to_rows(catalog.table) == truth
    [note] = catalog.notes
    assert note.startswith(str(tmp_path / CATALOG_NAME))
    assert why.replace("none", "is no catalog") in note
    assert is_held(tmp_path)


def test_what_a_catalog_unpacks_to_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(tmp_path / "a.mcap", contents()[0])
    refreshed(tmp_path)
    before = resource.getrlimit(resource.RLIMIT_DATA)
    monkeypatch.setattr(catalog_table, "READ_MAX_BYTES", 64 << 20)
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *_given, **_named: bytearray(1 << 30))
    with pytest.raises(CatalogUnreadableError, match="unpacks to too much"):
        read_table(tmp_path / CATALOG_NAME)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_what_no_catalog_of_ours_holds_makes_it_none(tmp_path: Path) -> None:
    put(tmp_path / "a.mcap", contents()[0])
    refreshed(tmp_path)
    path = tmp_path / CATALOG_NAME
    table = pq.read_table(path)
    for place, field in enumerate(table.schema):
        if not field.nullable:
            nulls = pa.nulls(table.num_rows, field.type)
            pq.write_table(table.set_column(place, pa.field(field.name, field.type), nulls), path)
            assert refreshed(tmp_path).notes
            assert is_held(tmp_path)


def test_no_link_beside_a_catalog_leads_its_writing_elsewhere(tmp_path: Path) -> None:
    """The temporary file's name is predictable."""
    precious = saved(tmp_path / "elsewhere" / "precious", b"as it was")
    logs = tmp_path / "logs"
    put(logs / "a.mcap", contents()[0])
    (logs / f".{CATALOG_NAME}.{os.getpid()}").symlink_to(precious)
    refreshed(logs)
    assert precious.read_bytes() == b"as it was"
    assert is_held(logs)
