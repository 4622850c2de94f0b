"""The catalog of a directory: its Parquet file, the valid rows, and the logs to open.

The catalog of a place in an object store consists of the rows beside its logs; a log without a valid row is copied
and read.
"""

from __future__ import annotations

import os
import resource
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from msgspec import inspect

from recorder.disk.log_names import PART_SUFFIX, SUFFIX, is_log
from recorder.objects.address import Objects, StoreAddress, StoreError, shown_url
from recorder.objects.cache import LogCache
from recorder.reading.logs import Faults, LogFile, is_being_written, without_covered
from recorder.reading.rows import Progress
from recorder.review.catalog.log_row import (
    FORMAT,
    NEVER_NS,
    VERSION,
    CatalogRow,
    CatalogUnreadableError,
    read_row,
    row_of,
    unreadable,
)
from recorder.upload.finished import ROW_SUFFIX
from schemas.command_line import CommandError, ExitCode, other_kind, plain

ROWS_IN_GROUP: Final = 8192

READ_MAX_BYTES: Final = 2 << 30  # memory limit of reading a catalog: a few megabytes may unpack to any size


def _field(name: str, kind: inspect.Type) -> pa.Field:
    """A column or a part of one, nullable only where the row's class has None."""
    if isinstance(kind, inspect.UnionType):
        [known] = [one for one in kind.types if not isinstance(one, inspect.NoneType)]
        return pa.field(name, _arrow_type(known))
    return pa.field(name, _arrow_type(kind), nullable=False)


def _arrow_type(kind: inspect.Type) -> pa.DataType:
    if isinstance(kind, inspect.ListType):
        return pa.list_(_field("element", kind.item_type))
    if isinstance(kind, inspect.DictType):
        return pa.map_(_arrow_type(kind.key_type), _field("value", kind.value_type))
    if isinstance(kind, inspect.StructType):
        return pa.struct([_field(field.encode_name, field.type) for field in kind.fields])
    return _PLAIN[type(kind)]


_PLAIN: Final = {
    inspect.BoolType: pa.bool_(),
    inspect.FloatType: pa.float64(),
    inspect.IntType: pa.int64(),
    inspect.StrType: pa.string(),
}

SCHEMA: Final = pa.schema(
    list(_arrow_type(inspect.type_info(CatalogRow))),
    metadata={"format": FORMAT, "version": str(VERSION)},
)
"""The columns, from the fields of ``CatalogRow``."""


def to_table(rows: Iterable[CatalogRow]) -> pa.Table:
    return pa.Table.from_pylist([_bounded(msgspec.to_builtins(row)) for row in rows], SCHEMA)


def _bounded(value: Any) -> Any:  # noqa: ANN401 - any of a row's parts
    """The value with all numbers cut to the range of a column: a log's are untrusted."""
    match value:
        case dict():
            return {key: _bounded(one) for key, one in value.items()}
        case list():
            return [_bounded(one) for one in value]
        case bool():
            return value
        case int():
            return max(-NEVER_NS, min(value, NEVER_NS))
        case _:
            return value


def to_rows(table: pa.Table) -> list[CatalogRow]:
    return msgspec.convert(table.to_pylist(maps_as_pydicts="strict"), list[CatalogRow])


def read_table(path: Path, columns: Collection[str] | None = None) -> pa.Table:
    """Read a catalog; FileNotFoundError without one, CatalogUnreadableError if it cannot be read."""
    try:
        if kind := other_kind(path.stat().st_mode):
            raise CatalogUnreadableError(f"is {kind}")
        with (
            path.open("rb") as stream,
            bounded_memory(),
            pq.ParquetFile(stream, page_checksum_verification=True) as file,
        ):
            schema = file.schema_arrow
            metadata: dict[bytes, bytes] = schema.metadata or {}
            version = metadata.get(b"version", b"").decode(errors="replace")
            if metadata.get(b"format") != FORMAT.encode():
                raise CatalogUnreadableError("is no catalog")
            if version != str(VERSION) or not schema.equals(SCHEMA):
                raise CatalogUnreadableError("is of another version")
            table = file.read(columns=None if columns is None else list(columns)).combine_chunks()
            if pc.count_distinct(table.column("file")).as_py() < table.num_rows:
                raise CatalogUnreadableError("names a log twice")
            return table
    except FileNotFoundError:
        raise
    except MemoryError as error:
        raise CatalogUnreadableError("unpacks to too much") from error
    except (pa.ArrowException, OSError, ValueError) as error:
        raise CatalogUnreadableError("is damaged") from error


@contextmanager
def bounded_memory() -> Generator[None, None, None]:
    """Limit this process to ``READ_MAX_BYTES`` more memory than it has; beyond that is a MemoryError."""
    before, hard = resource.getrlimit(resource.RLIMIT_DATA)
    taken = int(Path("/proc/self/statm").read_text("ascii").split()[5]) * resource.getpagesize()
    bounds = [one for one in (taken + READ_MAX_BYTES, before, hard) if one != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min(bounds), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, hard))


def write_table(path: Path, table: pa.Table) -> None:
    """Replace a catalog atomically."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    # A link of that name may lead anywhere.
    beside.unlink(missing_ok=True)
    try:
        with beside.open("xb") as stream:
            pq.write_table(
                table.replace_schema_metadata(SCHEMA.metadata),
                stream,
                row_group_size=ROWS_IN_GROUP,
                compression="zstd",
                write_page_checksum=True,
            )
            stream.flush()
            os.fsync(stream.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


CATALOG_NAME: Final = "catalog.parquet"
_CHECKED: Final = ["file", "bytes", "modified_ns", "is_incident", "start_ns", "end_ns"]


class _Status(msgspec.Struct, frozen=True):
    """A file of the directory."""

    name: str
    bytes: int
    modified_ns: int


class Catalog:
    """The valid rows of a directory's catalog; ``refresh`` adds the rest. CommandError if it cannot be read.

    A row is valid while its file has the same length and time of change.

    Attributes:
        stale: the logs that have to be opened, and ``stale_bytes`` their length.
        being_written: logs that a recorder has open: they have no row.
        notes: lines for people: why the catalog was rebuilt, or could not be written.
    """

    def __init__(self, directory: Path, columns: Sequence[str], path: Path | None = None) -> None:
        self._path = path or directory / CATALOG_NAME
        self._columns = list(columns)
        self.notes: list[str] = []
        self.being_written: list[Path] = []
        self._directory = directory
        files = _files(directory)
        for name, one in list(files.items()):
            if one.name.endswith(PART_SUFFIX) and _is_open(directory / one.name):
                self.being_written.append(directory / files.pop(name).name)
        known = self._read(_CHECKED)
        held = {
            name
            for name, *seen in zip(*(known.column(one).to_pylist() for one in _CHECKED[:3]), strict=True)
            if name in files and seen == [files[name].bytes, files[name].modified_ns]
        }
        is_same = len(held) == known.num_rows == len(files)
        # To write it again, all columns are needed.
        self._table = self._read(columns if is_same else None) if held else SCHEMA.empty_table()
        self._held = held if self._table.num_rows else set()
        self.stale = [one for name, one in sorted(files.items()) if name not in self._held]
        self._is_changed = not is_same or bool(self.stale or self.notes)
        self._spans = _spans(known.filter(pc.invert(self._holds(known))))

    @property
    def stale_bytes(self) -> int:
        return sum(one.bytes for one in self.stale)

    @property
    def table(self) -> pa.Table:
        """The wanted columns, ordered by the logs' start; after ``refresh``."""
        return self._table.select(self._columns)

    def refresh(
        self,
        faults: Faults,
        progress: Progress = lambda _: None,
        in_time: Callable[[int, Progress], Progress] = lambda _, progress: progress,
    ) -> None:
        """Open the logs without a valid row, and write the catalog if anything changed, even when interrupted.

        ``in_time`` makes the progress of one log of a given size, which may raise to give it up.
        """
        found: list[CatalogRow] = []
        try:
            while self.stale:
                one = self.stale[0]
                try:
                    found.append(_row(self._directory, one, in_time(one.bytes, progress)))
                except CommandError as error:
                    faults.add(f"{one.name}: {error}" if error.code is ExitCode.PARTIAL else str(error))
                    # Permissions may change without a change of the file.
                    if not isinstance(error.__cause__, OSError):
                        why = str(error).removeprefix(f"{plain(str(self._directory / one.name))} ")
                        found.append(unreadable(name_in_row(one.name), one.bytes, one.modified_ns, why))
                self.stale.pop(0)
        finally:
            self._add(found)

    def _read(self, columns: Collection[str] | None) -> pa.Table:
        try:
            return read_table(self._path, columns)
        except FileNotFoundError:
            pass
        except CatalogUnreadableError as error:
            self.notes.append(f"{plain(str(self._path))} {error}: rebuilt from the logs")
        return SCHEMA.empty_table()

    def _holds(self, table: pa.Table) -> pa.ChunkedArray:
        return pc.is_in(table.column("file"), pa.array(self._held, pa.string()))

    def _add(self, found: list[CatalogRow]) -> None:
        if not found and not self._is_changed:
            return
        new = to_table(found)
        self._spans += _spans(new)
        table = pa.concat_tables([self._table.filter(self._holds(self._table)), new])
        table = table.sort_by([("start_ns", "ascending"), ("file", "ascending")])
        self._table = self._with_coverage(table, {row.file for row in found}).combine_chunks()
        try:
            write_table(self._path, self._table)
        except OSError as error:
            why = error.strerror or error
            self.notes.append(f"cannot write {plain(str(self._path))}: {why}; the logs are read again next time")

    def _with_coverage(self, table: pa.Table, new: set[str]) -> pa.Table:
        """Update which incidents are covered by other logs, where logs came, changed or were deleted."""
        names = ["file", "bytes", "start_ns", "end_ns"]
        rows = [table.column(name).to_pylist() for name in names]
        logs = {name: LogFile(self._directory / name, *span) for name, *span in zip(*rows, strict=True)}
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
        were = table.column("is_covered").to_pylist()
        covered = [
            logs[name].path not in left if name in doubtful else was
            for name, was in zip(rows[0], were, strict=True)
        ]
        place = table.schema.get_field_index("is_covered")
        return table.set_column(place, SCHEMA.field(place), pa.array(covered, pa.bool_()))


def _files(directory: Path) -> dict[str, _Status]:
    """The logs of a directory, by their names in rows."""
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
    """The name of a log in its row, with escapes for bytes that are no text."""
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


AT_ONCE: Final = 16  # rows requested at the same time
ROW_MAX: Final = 16 * 1024 * 1024  # a longer object is no row


class PlaceCatalog:
    """The valid rows of a place in a store; ``refresh`` adds the rest. CommandError if it cannot be listed.

    A row is valid for a log of the same name and length: uploads never overwrite a log.

    Attributes:
        stale: the logs that have to be read, and ``stale_bytes`` their length.
        being_written: always empty: a store shows only whole logs.
        notes: lines for people.
    """

    def __init__(
        self,
        objects: Objects,
        place: StoreAddress,
        columns: Sequence[str],
        cache: LogCache,
    ) -> None:
        self.notes: list[str] = []
        self.being_written: list[Path] = []
        self._objects = objects
        self._place = place
        self._cache = cache
        self._columns = list(columns)
        with self._reachable(place.url):
            if not place.has_list:
                text = f"find cannot search {shown_url(place.url)}: an HTTP server has no list of its logs"
                raise CommandError(text, ExitCode.USAGE)
            listed = {one.name: one.bytes for one in objects.names()}
        self._logs = {name: size for name, size in listed.items() if name.endswith(SUFFIX)}
        with self._reachable(place.url):
            self._rows = list(self._uploaded([name for name in sorted(self._logs) if name + ROW_SUFFIX in listed]))
        known = {row.file for row in self._rows}
        self.stale = [name for name in sorted(self._logs) if name not in known]

    @property
    def stale_bytes(self) -> int:
        return sum(self._logs[name] for name in self.stale)

    @property
    def table(self) -> pa.Table:
        """The wanted columns, ordered by the logs' start; after ``refresh``."""
        table = to_table(self._rows).sort_by([("start_ns", "ascending"), ("file", "ascending")])
        return table.select(self._columns).combine_chunks()

    def refresh(
        self,
        faults: Faults,
        progress: Progress = lambda _: None,
        in_time: Callable[[int, Progress], Progress] = lambda _, progress: progress,
    ) -> None:
        """Read copies of the logs without a valid row; ``in_time`` as in ``Catalog.refresh``."""
        if self.stale:
            url = shown_url(self._place.url)
            self.notes.append(f"{len(self.stale)} logs of {url} had no valid row: they were read")
        while self.stale:
            name = self.stale[0]
            try:
                self._rows.append(self._made(name, in_time(self._logs[name], progress)))
            except CommandError as error:
                if error.code is ExitCode.UNREACHABLE:
                    raise
                faults.add(f"{name}: {error}" if error.code is ExitCode.PARTIAL else str(error))
            self.stale.pop(0)

    def _uploaded(self, names: Sequence[str]) -> Iterator[CatalogRow]:
        """The valid rows beside these logs, fetched in parallel."""
        pool = ThreadPoolExecutor(AT_ONCE)
        try:
            # Unpacked one by one: each may be large.
            for name, data in zip(names, pool.map(self._fetched, names), strict=True):
                with suppress(CatalogUnreadableError):
                    yield msgspec.structs.replace(read_row(data, self._logs[name]), file=name)
        finally:
            # Stop asking a store that is gone.
            pool.shutdown(cancel_futures=True)

    def _fetched(self, name: str) -> bytes:
        """The object of a row; empty if it is gone or too long."""
        row = name + ROW_SUFFIX
        found = self._objects.look(row)
        is_there = found is not None and 0 < found.bytes <= ROW_MAX
        return self._objects.read(row, 0, found.bytes, found.e_tag) if found and is_there else b""

    def _made(self, name: str, progress: Progress) -> CatalogRow:
        path = self._cache.fetch(self._objects, self._place, name, progress)
        try:
            return row_of(path, name, 0)
        except CommandError as error:
            url = shown_url(self._place.join(name).url)
            raise CommandError(str(error).replace(plain(str(path)), url)) from error

    @contextmanager
    def _reachable(self, url: str) -> Iterator[None]:
        try:
            yield
        except StoreError as error:
            raise CommandError(f"cannot read {shown_url(url)}: {error}", ExitCode.UNREACHABLE) from error
        except OSError as error:
            raise CommandError(f"cannot copy {shown_url(url)}: {error.strerror or error}") from error
