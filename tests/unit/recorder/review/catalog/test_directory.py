"""The catalog of a directory, held against one that is made anew from the logs."""

import fcntl
import os
import resource
from contextlib import suppress
from functools import lru_cache
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.reading.logs import Faults, LogFile, find_logs, look_at
from recorder.review.catalog import directory as catalog_table
from recorder.review.catalog import log_row
from recorder.review.catalog.directory import SCHEMA, Catalog, known_logs, read_table, to_rows
from recorder.review.catalog.log_row import FORMAT, CatalogRow, CatalogUnreadableError
from recorder.review.info import CATALOG_NAME, brief, read_info
from schemas.command_line import CommandError, ExitCode
from tests.support.drives import drive_log, drive_messages, restart, write_messages
from tests.support.logs import foreign_log, saved, small_log

TIMES = count(1_800_000_000_000_000_000, 1_000_000_000)
"""When files are changed: the clock of a file system may stand still for some milliseconds."""


@lru_cache
def contents() -> tuple[bytes, ...]:
    """Logs of several sorts: drives, a restart, somebody else's, a damaged one, and what is no log."""
    with TemporaryDirectory() as directory:
        path = Path(directory) / "a.mcap"
        drive = write_messages(path, drive_messages(8)).read_bytes()
        died = write_messages(path, restart(8, 30)).read_bytes()
    return drive, died, drive_log(), foreign_log(), drive[:-300], small_log(), b"", b"no log at all"


def put(path: Path, data: bytes) -> None:
    """Write a file, later than any before."""
    saved(path, data)
    touch(path)


def touch(path: Path) -> None:
    """Give a file another time."""
    time_ns = next(TIMES)
    os.utime(path, ns=(time_ns, time_ns))


def refreshed(path: Path, *, is_anew: bool = False, faults: Faults | None = None) -> Catalog:
    """The catalog of a directory, brought up to date."""
    catalog = Catalog(path, SCHEMA.names, is_anew=is_anew)
    catalog.refresh(Faults() if faults is None else faults)
    return catalog


def rows(path: Path, *, is_anew: bool = False) -> list[CatalogRow]:
    """Its rows."""
    return to_rows(refreshed(path, is_anew=is_anew).table)


NAMES = ("a.mcap", "b.mcap", "a.incident.mcap", "c.mcap.part")
CHANGES = st.one_of(
    st.tuples(st.just("put"), st.sampled_from(NAMES), st.integers(0, 7)),
    st.tuples(st.sampled_from(["touch", "remove"]), st.sampled_from(NAMES), st.just(0)),
    st.tuples(st.just("refresh"), st.just(""), st.just(0)),
)


@given(changes=st.lists(CHANGES, max_size=8))
def test_a_catalog_that_grew_is_the_one_that_is_made_anew(changes: list[tuple[str, str, int]]) -> None:
    """Whatever came, changed and went meanwhile, and whenever the catalog was brought up to date."""
    with TemporaryDirectory() as name:
        directory = Path(name)
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
        assert grown == rows(directory, is_anew=True)
        assert grown == rows(directory)
        assert {row.file for row in grown} <= {path.name for path in directory.iterdir()}


def test_only_what_is_new_or_has_changed_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log that was copied or touched has the same length and checksum, and is not read again."""
    opened: list[str] = []

    def noted(path: Path) -> LogFile:
        opened.append(path.name)
        return look_at(path)

    monkeypatch.setattr(log_row, "look_at", noted)
    put(tmp_path / "a.mcap", contents()[0])
    put(tmp_path / "b.mcap", contents()[1])
    refreshed(tmp_path)
    assert sorted(opened) == ["a.mcap", "b.mcap"]
    opened.clear()
    touch(tmp_path / "a.mcap")
    put(tmp_path / "b.mcap", contents()[2])
    put(tmp_path / "c.mcap", contents()[3])
    refreshed(tmp_path)
    assert sorted(opened) == ["b.mcap", "c.mcap"]
    opened.clear()
    before = (tmp_path / CATALOG_NAME).stat()
    refreshed(tmp_path)
    assert not opened
    after = (tmp_path / CATALOG_NAME).stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def test_a_row_says_what_the_questions_say(tmp_path: Path) -> None:
    """Distance, operator, stops with their reasons, versions and settings of a drive that a bumper ends."""
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


@pytest.mark.parametrize("kind", ["flipped", "cut", "empty", "text", "parquet of somebody else"])
def test_a_catalog_that_cannot_be_read_is_made_anew_with_a_line(tmp_path: Path, kind: str) -> None:
    """And the answer is the same."""
    put(tmp_path / "a.mcap", contents()[0])
    truth = rows(tmp_path)
    path = tmp_path / CATALOG_NAME
    data = bytearray(path.read_bytes())
    match kind:
        case "flipped":
            data[4:200] = bytes(byte ^ 0x10 for byte in data[4:200])
        case "cut":
            del data[-20:]
        case "empty":
            data.clear()
        case "text":
            data[:] = b"file,bytes\n"
        case _:
            pq.write_table(SCHEMA.empty_table().replace_schema_metadata(None), path)
            data[:] = path.read_bytes()
    path.write_bytes(data)
    catalog = refreshed(tmp_path)
    assert to_rows(catalog.table) == truth
    [note] = catalog.notes
    assert str(path) in note
    assert "rebuilt from the logs" in note
    assert not refreshed(tmp_path).notes


@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_changes_no_answer(place: float, bit: int) -> None:
    """The pages have checksums; where the damage is elsewhere the catalog is made anew."""
    with TemporaryDirectory() as name:
        directory = Path(name)
        put(directory / "a.mcap", contents()[0])
        truth = rows(directory)
        path = directory / CATALOG_NAME
        data = bytearray(path.read_bytes())
        data[int(place * len(data))] ^= 1 << bit
        path.write_bytes(data)
        assert rows(directory) == truth


def test_a_catalog_of_another_version_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a row says has changed since."""
    put(tmp_path / "a.mcap", contents()[0])
    with monkeypatch.context() as patched:
        older = SCHEMA.with_metadata({"format": FORMAT, "version": "0"})
        patched.setattr(catalog_table, "SCHEMA", older)
        patched.setattr(catalog_table, "VERSION", 0)
        refreshed(tmp_path)
    catalog = refreshed(tmp_path)
    assert [row.file for row in to_rows(catalog.table)] == ["a.mcap"]
    assert "is of another version" in catalog.notes[0]


def test_a_log_that_is_being_written_has_no_row_and_is_named(tmp_path: Path) -> None:
    """It would be old at once; what a killed recorder left has one."""
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
    """Until it changes; a file that may not be opened, or is not there, may be at any time."""
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
    assert [path.name for path in known_logs(tmp_path)] == ["a.mcap"]
    put(tmp_path / "b.mcap", contents()[0])
    assert {row.file for row in rows(tmp_path) if not row.damage} == {"a.mcap", "b.mcap"}


def test_names_that_are_no_text_have_rows(tmp_path: Path) -> None:
    """A disk takes any bytes for a name."""
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.mcap"))
    put(path, contents()[0])
    (row,) = rows(tmp_path)
    assert row.file == "\\xff.mcap"
    assert list(known_logs(tmp_path)) == [path]


def test_what_was_read_before_an_interruption_is_kept(tmp_path: Path) -> None:
    """Of thousands of logs none is read twice."""
    put(tmp_path / "a.mcap", contents()[0])
    put(tmp_path / "b.mcap", contents()[1])
    left = iter([None] * 2)

    def progress(_count: int) -> None:
        if next(left, 1) is not None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Catalog(tmp_path, SCHEMA.names).refresh(Faults(), progress)
    assert [one.name for one in Catalog(tmp_path, SCHEMA.names).stale] == ["b.mcap"]


def test_a_disk_that_takes_no_catalog_costs_no_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A line says that the logs are read again the next time; nothing half written is left."""

    def refuse(*_given: object, **_named: object) -> None:
        raise OSError(30, "Read-only file system")

    put(tmp_path / "a.mcap", contents()[0])
    monkeypatch.setattr(pq, "write_table", refuse)
    catalog = refreshed(tmp_path)
    assert [row.file for row in to_rows(catalog.table)] == ["a.mcap"]
    assert "Read-only file system" in catalog.notes[0]
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_a_directory_that_is_none_is_a_matter_of_usage(tmp_path: Path) -> None:
    """A catalog is of a directory of logs."""
    with pytest.raises(CommandError, match=r"a\.mcap is a file: give a directory of logs") as caught:
        Catalog(saved(tmp_path / "a.mcap", contents()[0]), SCHEMA.names)
    assert caught.value.code is ExitCode.USAGE


def test_a_directory_without_logs_gets_no_catalog(tmp_path: Path) -> None:
    """Nor does a home directory by mistake."""
    refreshed(tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_other_questions_find_the_same_logs_by_the_catalog(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And open none of them, incidents included."""
    put(tmp_path / "a.mcap", contents()[0])
    put(tmp_path / "a.incident.mcap", contents()[0])
    put(tmp_path / "b.incident.mcap", contents()[1])
    put(tmp_path / "c.mcap", contents()[3])
    truth = find_logs([tmp_path], Faults())
    assert sorted(log.path.name for log in truth) == ["a.mcap", "b.incident.mcap", "c.mcap"]
    refreshed(tmp_path)

    def refuse(path: Path) -> None:
        raise AssertionError(path)

    for name in ("look_at", "without_covered"):
        monkeypatch.setattr(f"recorder.reading.logs.{name}", refuse)
    known = known_logs(tmp_path)
    assert find_logs([tmp_path], Faults(), known=known) == truth
    assert {path: one.brief for path, one in known.items()} == {
        path: brief(read_info(path)) for path in tmp_path.glob("*.mcap")
    }


def test_an_incident_whose_log_has_gone_is_found_again(tmp_path: Path) -> None:
    """Also before the catalog has been brought up to date."""
    put(tmp_path / "a.mcap", contents()[0])
    put(tmp_path / "a.incident.mcap", contents()[0])
    assert {row.file: row.is_covered for row in rows(tmp_path)} == {"a.mcap": False, "a.incident.mcap": True}
    (tmp_path / "a.mcap").unlink()
    (log,) = find_logs([tmp_path], Faults(), known=known_logs(tmp_path))
    assert log.path.name == "a.incident.mcap"
    assert {row.file: row.is_covered for row in rows(tmp_path)} == {"a.incident.mcap": False}


def test_a_log_of_another_length_is_another_one(tmp_path: Path) -> None:
    """Also where its time is as it was."""
    put(tmp_path / "a.mcap", contents()[0])
    refreshed(tmp_path)
    status = (tmp_path / "a.mcap").stat()
    saved(tmp_path / "a.mcap", contents()[1])
    os.utime(tmp_path / "a.mcap", ns=(status.st_mtime_ns, status.st_mtime_ns))
    assert not known_logs(tmp_path)
    assert rows(tmp_path) == rows(tmp_path, is_anew=True)


def test_a_page_that_is_damaged_and_can_be_unpacked_is_seen(tmp_path: Path) -> None:
    """By its checksum: its compression has none."""
    put(tmp_path / "a.mcap", contents()[0])
    refreshed(tmp_path)
    path = tmp_path / CATALOG_NAME
    data, truth = path.read_bytes(), pq.read_table(path)
    for place in range(20, len(data)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        with suppress(pa.ArrowException, OSError):
            if pq.read_table(path) != truth:
                break
    with pytest.raises(CatalogUnreadableError, match="damaged"):
        read_table(path)


# A catalog of somebody else's making may lie in the directory.


def test_what_a_catalog_unpacks_to_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond that it is none. What the process may take afterwards is as before."""
    put(tmp_path / "a.mcap", contents()[0])
    refreshed(tmp_path)
    before = resource.getrlimit(resource.RLIMIT_DATA)
    monkeypatch.setattr(catalog_table, "READ_MAX_BYTES", 64 << 20)
    whole = pq.ParquetFile.read
    bomb: list[bytearray] = []

    def unpack(*asked: Any, **columns: Any) -> pa.Table:  # noqa: ANN401 - of the library
        bomb.append(bytearray(1 << 30))
        return whole(*asked, **columns)

    monkeypatch.setattr(pq.ParquetFile, "read", unpack)
    with pytest.raises(CatalogUnreadableError, match="unpacks to too much"):
        read_table(tmp_path / CATALOG_NAME)
    assert not known_logs(tmp_path)
    assert not bomb
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_what_no_catalog_of_ours_holds_makes_it_none(tmp_path: Path) -> None:
    """A log twice, or null where no row has it: it is made anew, and no command ends in a fault of ours."""
    put(tmp_path / "a.mcap", contents()[0])
    refreshed(tmp_path)
    path = tmp_path / CATALOG_NAME
    table = pq.read_table(path)
    for other in (
        pa.concat_tables([table, table]),
        *(
            table.set_column(place, pa.field(field.name, field.type), pa.nulls(table.num_rows, field.type))
            for place, field in enumerate(table.schema)
            if not field.nullable
        ),
    ):
        pq.write_table(other, path)
        assert not known_logs(tmp_path)
        assert refreshed(tmp_path).notes
        assert known_logs(tmp_path)


def test_what_is_no_regular_file_is_no_catalog(tmp_path: Path) -> None:
    """A FIFO would be waited for."""
    put(tmp_path / "a.mcap", contents()[0])
    os.mkfifo(tmp_path / CATALOG_NAME)
    assert not known_logs(tmp_path)
    assert refreshed(tmp_path).notes
    assert known_logs(tmp_path)


def test_no_link_beside_a_catalog_leads_its_writing_elsewhere(tmp_path: Path) -> None:
    """Whoever made the directory may know the name under which it is written first."""
    precious = saved(tmp_path / "elsewhere" / "precious", b"as it was")
    logs = tmp_path / "logs"
    put(logs / "a.mcap", contents()[0])
    (logs / f".{CATALOG_NAME}.{os.getpid()}").symlink_to(precious)
    refreshed(logs)
    assert precious.read_bytes() == b"as it was"
    assert known_logs(logs)
