"""The catalog of a directory: which of its rows still hold, which logs have to be opened, and the file itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from recorder.disk.log_names import PART_SUFFIX, is_log
from recorder.reading.covered import without_covered
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.logs import is_being_written
from recorder.reading.rows import Progress
from recorder.review.catalog.known import CATALOG_NAME, CatalogedLog
from recorder.review.catalog.rows import NEVER_NS, CatalogRow, CatalogUnreadableError
from recorder.review.catalog.single import row_of, summary_crc_of
from recorder.review.catalog.table import (
    SCHEMA,
    bounded_memory,
    read_table,
    to_table,
    write_table,
)
from recorder.review.info import LogBrief
from schemas.command_line import CommandError, ExitCode, plain

_CHECKED: Final = ["file", "bytes", "modified_ns", "summary_crc", "is_incident", "start_ns", "end_ns"]
_BRIEF: Final = [
    "file",
    "bytes",
    "modified_ns",
    "messages",
    "start_ns",
    "end_ns",
    "is_whole",
    "is_covered",
    "robots",
    "names",
    "lost",
]


class _Status(msgspec.Struct, frozen=True):
    """A file of the directory, as the file system has it."""

    name: str
    bytes: int
    modified_ns: int


class Catalog:
    """The catalog of a directory, as far as its rows hold; ``refresh`` adds the rest.

    A row holds as long as its file has the same length, and either the time of its last change or the checksum of
    its summary.

    Args:
        directory: of the logs.
        columns: those of ``CatalogRow`` that are wanted.
        path: where the catalog is kept; beside the logs unless told otherwise.
        is_anew: believe no row that is there.

    Attributes:
        stale: the logs that have to be opened, and ``stale_bytes`` their length.
        being_written: logs that a recorder has open: they have no row.
        notes: lines for people: why the catalog was made anew, or could not be written.

    Raises:
        CommandError: the directory cannot be read.
    """

    def __init__(
        self, directory: Path, columns: Sequence[str], path: Path | None = None, *, is_anew: bool = False
    ) -> None:
        self._path = path or directory / CATALOG_NAME
        self._columns = list(columns)
        self.notes: list[str] = []
        self.being_written: list[Path] = []
        self._directory = directory
        files = _files(directory)
        for name, one in list(files.items()):
            if one.name.endswith(PART_SUFFIX) and _is_open(directory / one.name):
                self.being_written.append(directory / files.pop(name).name)
        self._is_changed = bool(files) and (is_anew or not self._path.exists())
        self._table = SCHEMA.empty_table() if is_anew else self._read({*_CHECKED, *columns})
        self._modified = self._compare(files)
        if not self._table.num_rows:
            self._table = SCHEMA.empty_table()
        elif self._is_changed or not self._table.num_rows == len(self._modified) == len(files):
            # It is written again, so every column is needed.
            self._table = self._read()
            if not self._table.num_rows:
                self._modified = {}
        self.stale = [one for name, one in sorted(files.items()) if name not in self._modified]
        gone = self._table.filter(pc.invert(self._holds()))
        self._is_changed |= bool(gone.num_rows)
        self._spans = _spans(gone)

    @property
    def stale_bytes(self) -> int:
        """The length of all logs that have to be opened."""
        return sum(one.bytes for one in self.stale)

    @property
    def table(self) -> pa.Table:
        """The wanted columns of the rows, by the logs' beginning. After ``refresh``."""
        return self._table.select(self._columns)

    def refresh(
        self,
        faults: Faults,
        progress: Progress = lambda _: None,
        in_time: Callable[[int, Progress], Progress] = lambda _, progress: progress,
    ) -> None:
        """Open the logs that have no row, and write the catalog if anything changed.

        What was found is written also where the reading is interrupted.

        Args:
            faults: takes the logs that cannot be opened, or not be read in time.
            progress: receives the number of bytes that were read.
            in_time: makes the progress of one log of so many bytes, which may give it up.
        """
        found: list[CatalogRow] = []
        try:
            while self.stale:
                one = self.stale[0]
                try:
                    found.append(_row(self._directory, one, in_time(one.bytes, progress)))
                except CommandError as error:
                    faults.add(f"{one.name}: {error}" if error.code is ExitCode.PARTIAL else str(error))
                self.stale.pop(0)
        finally:
            self._add(found)

    def _read(self, columns: Collection[str] | None = None) -> pa.Table:
        try:
            return read_table(self._path, columns)
        except FileNotFoundError:
            pass
        except CatalogUnreadableError as error:
            self.notes.append(f"{plain(str(self._path))} {error}: it is made anew from the logs")
            self._is_changed = True
        return SCHEMA.empty_table()

    def _holds(self) -> pa.ChunkedArray:
        return pc.is_in(self._table.column("file"), pa.array(self._modified, pa.string()))

    def _compare(self, files: Mapping[str, _Status]) -> dict[str, int]:
        """The rows whose files are as they were, by name: the time of the last change of each."""
        found = {}
        rows = [self._table.column(name).to_pylist() for name in ("file", "bytes", "modified_ns", "summary_crc")]
        for name, size, modified_ns, summary_crc in zip(*rows, strict=True):
            one = files.get(name)
            if one is None or one.bytes != size:
                continue
            if one.modified_ns != modified_ns:
                if summary_crc is None or summary_crc_of(self._directory / one.name) != summary_crc:
                    continue
                # It was copied, or touched.
                self._is_changed = True
            found[name] = one.modified_ns
        return found

    def _add(self, found: list[CatalogRow]) -> None:
        if not found and not self._is_changed:
            return
        kept = self._table.filter(self._holds())
        modified = [self._modified[name] for name in kept.column("file").to_pylist()]
        new = to_table(found)
        self._spans += _spans(new)
        table = pa.concat_tables([_replaced(kept, "modified_ns", modified), new])
        table = table.sort_by([("start_ns", "ascending"), ("file", "ascending")])
        self._table = self._with_coverage(table, {row.file for row in found}).combine_chunks()
        try:
            write_table(self._path, self._table)
        except OSError as error:
            why = error.strerror or error
            self.notes.append(
                f"cannot write {plain(str(self._path))}: {why}; what was read is read again next time"
            )

    def _with_coverage(self, table: pa.Table, new: set[str]) -> pa.Table:
        """Find out anew which incidents the other logs hold, where any of these has come, changed or gone."""
        logs = {str(row["file"]): log for row, log in _log_files(self._directory, table)}
        spans = self._spans
        doubtful = {
            name
            for name, log in logs.items()
            if log.is_incident
            and (name in new or any(start <= log.end_ns and log.start_ns <= end for start, end in spans))
        }
        self._spans = []
        if not doubtful:
            return table
        asked = [log for name, log in logs.items() if name in doubtful or not log.is_incident]
        left = {log.path for log in without_covered(asked)}
        covered = [
            logs[name].path not in left if name in doubtful else was
            for name, was in zip(
                table.column("file").to_pylist(), table.column("is_covered").to_pylist(), strict=True
            )
        ]
        return _replaced(table, "is_covered", covered)


def _replaced(table: pa.Table, name: str, values: Sequence[Any]) -> pa.Table:
    place = table.schema.get_field_index(name)
    return table.set_column(place, SCHEMA.field(place), pa.array(values, SCHEMA.field(place).type))


def known_logs(directory: Path) -> dict[Path, CatalogedLog]:
    """The whole logs of a directory that are as its catalog says; nothing is opened but the catalog.

    None where there is no catalog, or none that can be read.
    """
    try:
        with bounded_memory():
            rows = _log_files(directory, read_table(directory / CATALOG_NAME, _BRIEF))
        files = _files(directory)
    except (FileNotFoundError, CatalogUnreadableError, CommandError, MemoryError):
        return {}
    found = {}
    has_all = True
    for row, log in rows:
        one = files.get(row["file"])
        if one is None or (one.bytes, one.modified_ns) != (row["bytes"], row["modified_ns"]):
            has_all = False
        # A part may be written on, and a time that a column cannot hold is not known.
        elif log.end_ns < NEVER_NS and not one.name.endswith(PART_SUFFIX):
            path = directory / one.name
            found[path] = _cataloged(row, msgspec.structs.replace(log, path=path))
    if has_all:
        return found
    return {path: msgspec.structs.replace(one, is_covered=None) for path, one in found.items()}


def _cataloged(row: dict[str, Any], log: LogFile) -> CatalogedLog:
    has_messages = bool(row["messages"])
    brief = LogBrief(
        path=str(log.path),
        bytes=log.bytes,
        whole=row["is_whole"],
        is_being_written=False,
        messages=row["messages"],
        start_ns=log.start_ns if has_messages else None,
        end_ns=log.end_ns if has_messages else None,
        duration_s=(log.end_ns - log.start_ns) / 1e9,
        robots=row["names"],
        lost=row["lost"],
    )
    return CatalogedLog(log, row["is_covered"], brief)


def _files(directory: Path) -> dict[str, _Status]:
    """The logs of a directory, by their names as rows have them. There may be very many."""
    found = {}
    try:
        with os.scandir(directory) as entries:
            for entry in entries:
                name = entry.name
                if not is_log(name):
                    continue
                try:
                    status = entry.stat()
                except OSError:
                    found[name_in_row(name)] = _Status(name, 0, 0)
                else:
                    found[name_in_row(name)] = _Status(name, status.st_size, status.st_mtime_ns)
    except NotADirectoryError as error:
        shown = plain(str(directory))
        raise CommandError(f"{shown} is a file: give a directory of logs", ExitCode.USAGE) from error
    except OSError as error:
        why = error.strerror or error
        raise CommandError(f"cannot read {plain(str(directory))}: {why}", ExitCode.USAGE) from error
    return found


def name_in_row(name: str) -> str:
    """Return the name that a log has in its row: with escapes for the bytes that are no text."""
    return name if name.isascii() else os.fsencode(name).decode(errors="backslashreplace")


def _row(directory: Path, one: _Status, progress: Progress) -> CatalogRow:
    return row_of(directory / one.name, name_in_row(one.name), one.modified_ns, progress)


def _is_open(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return is_being_written(stream)
    except OSError:
        return False


def _spans(table: pa.Table) -> list[tuple[int, int]]:
    """The times of rows that are no incidents."""
    logs = table.filter(pc.invert(table.column("is_incident")))
    return list(zip(logs.column("start_ns").to_pylist(), logs.column("end_ns").to_pylist(), strict=True))


def _log_files(directory: Path, table: pa.Table) -> list[tuple[dict[str, Any], LogFile]]:
    """Each row, and the log that it is of."""
    rows = table.select([name for name in _BRIEF if name in table.column_names]).to_pylist()
    return [
        (
            row,
            LogFile(
                directory / row["file"],
                row["bytes"],
                row["start_ns"],
                row["end_ns"],
                frozenset((one["root"], one["name"]) for one in row["robots"]),
            ),
        )
        for row in rows
    ]
