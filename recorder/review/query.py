"""SQL over logs, over a dataset, or over catalogs, with DuckDB: a table for each subject.

The tables of logs in a statement are first written as a dataset into a temporary directory, which DuckDB also uses
beyond MEMORY_LIMIT. Nothing is loaded from a network.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache, partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, TypeVar

import duckdb
import msgspec
import pyarrow as pa
from mcap import records

from recorder.encoding.protobuf import descriptor_set, schema_name
from recorder.encoding.routes import Route
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Progress, Selection
from recorder.reading.survey import survey
from recorder.reading.topics import topic_of
from recorder.review.columns import HEAD, ROBOT, TOPIC, Columns, columns_of
from recorder.review.export import (
    FORMAT,
    VERSION,
    Column,
    ExportRange,
    ExportTask,
    Manifest,
    Part,
    described,
    export_log,
)
from schemas import keys
from schemas.command_line import CommandError, ExitCode
from schemas.messages import RawSample
from schemas.subjects import RECORDER_SUBJECTS, SUBJECTS

WHOSE: Final = (pa.field(ROBOT, pa.string()), pa.field(TOPIC, pa.string()))
"""The first columns of each table."""


class TableInfo(msgspec.Struct, frozen=True):
    """A table of SQL."""

    name: str
    topics: list[str]
    columns: list[Column]


@cache
def own_columns() -> dict[str, Columns]:
    """The columns of our own subjects, by the names of their tables."""
    kinds: list[tuple[str, type[msgspec.Struct]]] = [("x", RawSample)]
    for subject in SUBJECTS:
        bus = "can0" if "{bus}" in subject.name else ""
        kinds.append((keys.build("x", "x", subject, bus), Route(0, subject, "").kind))
    kinds += [(keys.of_recorder("x", "x", one.name), Route(0, one, "").kind) for one in RECORDER_SUBJECTS]
    found = {}
    for topic, kind in kinds:
        channel = records.Channel(0, topic, "protobuf", {}, 1)
        schema = records.Schema(1, descriptor_set(kind), "protobuf", schema_name(kind))
        columns = columns_of(topic_of(channel, schema))
        found[columns.table] = columns
    return found


def free_name(name: str, taken: Collection[str]) -> str:
    """The name, or the first of ``name_2``, ``name_3``, ... that is free."""
    free, number = name, 1
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


def shown(columns: Sequence[Column]) -> list[Column]:
    """Columns for people: an enumeration is a text."""
    return [
        msgspec.structs.replace(one, type="string") if one.type.startswith("dictionary<") else one
        for one in columns
    ]


CATALOG: Final = "catalog"  # the table's name


class CatalogSource:
    """A table of catalogs' rows."""

    directories: Final[list[str]] = []
    tables: Final[list[TableInfo]] = []

    def __init__(self, rows: pa.Table) -> None:
        self._rows = rows

    def declare(self, connection: duckdb.DuckDBPyConnection, _names: Collection[str], _scratch: Path) -> None:
        connection.register(CATALOG, self._rows)


class DatasetSource:
    """Tables of a dataset's Parquet files."""

    def __init__(self, directory: Path, manifest: Manifest) -> None:
        self._directory = directory.absolute()
        self._manifest = manifest
        self._parts: dict[str, list[Part]] = {}
        own = {(name, described(columns.schema)[0]) for name, columns in own_columns().items()}
        names: dict[tuple[str, str], str] = {}
        # Our own subjects take their names first.
        for part in sorted(manifest.files, key=lambda part: (part.table, part.columns) not in own):
            key = part.table, part.columns
            if key not in names:
                is_own = key in own or self._is_like(part)
                taken = self._parts if is_own else {*self._parts, *own_columns()}
                names[key] = free_name(part.table, taken)
            self._parts.setdefault(names[key], []).append(part)

    def _is_like(self, part: Part) -> bool:
        """True if a table is another version's of a subject of ours: they have fields in common."""
        own = own_columns().get(part.table)
        names = {column.name for column in self._manifest.schemas.get(part.columns, [])}
        return own is not None and bool(names & set(own.schema.names[len(HEAD) :]))

    @property
    def directories(self) -> list[str]:
        """The directory of its files, plain and with DuckDB's patterns escaped."""
        return [str(self._directory), _unglobbed(str(self._directory))]

    @property
    def tables(self) -> list[TableInfo]:
        return [
            TableInfo(
                name,
                sorted({part.topic for part in parts}),
                shown([*described(pa.schema(WHOSE))[1], *self._manifest.schemas.get(parts[0].columns, [])]),
            )
            for name, parts in sorted(self._parts.items())
        ]

    def declare(self, connection: duckdb.DuckDBPyConnection, names: Collection[str], _scratch: Path) -> None:
        """Declare the named tables, or all if none is named, and empty ones of our own subjects."""
        for name, columns in own_columns().items():
            if name not in self._parts:
                connection.register(name, pa.schema([*WHOSE, *columns.schema]).empty_table())
        for name, parts in self._parts.items():
            # Opening files costs time; but for an unknown name, DuckDB suggests a similar one.
            if names and name not in names and all(one in self._parts or one in own_columns() for one in names):
                continue
            files = ", ".join(_quoted(_unglobbed(str(self._directory / part.path))) for part in parts)
            # The names consist of letters, digits and underscores; the files are quoted.
            connection.execute(
                f'CREATE VIEW "{name}" AS SELECT {ROBOT}, {TOPIC}, * EXCLUDE ({TOPIC}, {ROBOT}, date) '  # noqa: S608
                f"FROM read_parquet([{files}], hive_partitioning = true, hive_types_autocast = false)"
            )


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _unglobbed(path: str) -> str:
    """A path with DuckDB's patterns escaped."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in path)


class LogSource:
    """Tables of logs: those named in a statement become a temporary dataset."""

    directories: Final[list[str]] = []

    def __init__(
        self, logs: Sequence[LogFile], selection: Selection, faults: Faults, progress: Progress = lambda _: None
    ) -> None:
        self._logs = logs
        self._selection = selection
        self._faults = faults
        self._progress = progress

    @property
    def tables(self) -> list[TableInfo]:
        """The tables of all topics of the logs."""
        found = [columns_of(one) for log in self._logs for one in survey([log], self._faults).topics.values()]
        parts = [Part("", one.table, one.topic.name, one.robot, 0, 0, described(one.schema)[0]) for one in found]
        return DatasetSource(Path(), _manifest(parts, dict(described(one.schema) for one in found))).tables

    def declare(self, connection: duckdb.DuckDBPyConnection, names: Collection[str], scratch: Path) -> None:
        """Write and declare the named tables; the second table of a name has a number."""
        named = sorted({re.sub(r"_\d+\Z", "", name) for name in names} | set(names))
        wanted = ExportRange(named, self._selection.from_ns, self._selection.to_ns)
        outcomes = [
            export_log(ExportTask(log, str(number), scratch, wanted), self._progress)
            for number, log in enumerate(self._logs if named else ())
        ]
        for fault in dict.fromkeys(fault for one in outcomes for fault in one.input.faults):
            self._faults.add(fault)
        parts = [part for one in outcomes for part in one.parts]
        schemas = {key: columns for one in outcomes for key, columns in one.schemas.items()}
        DatasetSource(scratch, _manifest(parts, schemas)).declare(connection, names, scratch)


def _manifest(parts: list[Part], schemas: dict[str, list[Column]]) -> Manifest:
    return Manifest(FORMAT, VERSION, "", [], parts, schemas)


T = TypeVar("T")

MEMORY_LIMIT: Final = "160MB"

BATCH_ROWS: Final = 8192  # of an answer
MESSAGE_MAX: Final = 500  # length of an error's text

_BESIDES: Final = ("LINE ", "Candidate functions:", "Please try installing")

_WRONG_SQL: Final = (
    duckdb.PermissionException,
    duckdb.ProgrammingError,
    duckdb.NotSupportedError,
    duckdb.DataError,
)

LOOK_S: Final = 0.1  # period of checks for a stop

Source = LogSource | DatasetSource | CatalogSource


@contextmanager
def answer(
    source: Source,
    sql: str,
    stopped: Callable[[], bool] = lambda: False,
    *,
    parameters: Mapping[str, Any] | None = None,
) -> Generator[pa.RecordBatchReader | None, None, None]:
    """The rows of a statement's answer as a stream; None if it has none.

    DuckDB handles no signals, so it works on another thread, which ``stopped`` interrupts.

    Raises:
        CommandError: the statement is wrong, or fails; also while the rows are read, see ``one_line_errors``.
        KeyboardInterrupt: it was stopped; also while the rows are read.
    """
    with TemporaryDirectory(prefix="cruiser-query-") as scratch, ThreadPoolExecutor(1) as thread:
        connection = duckdb.connect(":memory:", config=_configuration(scratch))

        def run(act: Callable[..., T], *words: Any) -> T:  # noqa: ANN401 - its arguments
            future = thread.submit(act, *words)
            while not wait([future], LOOK_S).done:
                if stopped():
                    connection.interrupt()
            if stopped():
                raise KeyboardInterrupt
            return future.result()

        try:
            with one_line_errors():
                connection.execute("SET TimeZone = 'UTC'")
                _check(connection, sql)
                source.declare(connection, _names_in(connection, sql), Path(scratch))
                # Statements and logs are untrusted.
                connection.execute("SET allowed_directories = $1", [[scratch, *source.directories]])
                connection.execute("SET enable_external_access = false")
                connection.execute("SET lock_configuration = true")
                relation = run(partial(connection.sql, params=parameters), sql)
                rows = None if relation is None else run(relation.to_arrow_reader, BATCH_ROWS)
            yield None if rows is None else _renamed(rows, run)
        finally:
            connection.close()


def _renamed(rows: pa.RecordBatchReader, run: Callable[..., Any]) -> pa.RecordBatchReader:
    """The rows with unique names of columns: duplicates get a number."""
    names: list[str] = []
    for name in rows.schema.names:
        others = (f"{name}_{number}" for number in count(1))
        taken = {*names, *rows.schema.names}
        names.append(next(one for one in others if one not in taken) if name in names else name)
    schema = pa.schema([field.with_name(name) for field, name in zip(rows.schema, names, strict=True)])
    return pa.RecordBatchReader.from_batches(schema, _batches(rows, names, run))


def _batches(rows: pa.RecordBatchReader, names: list[str], run: Callable[..., Any]) -> Iterator[pa.RecordBatch]:
    batches = iter(rows)
    while (batch := run(next, batches, None)) is not None:
        yield pa.RecordBatch.from_arrays(batch.columns, names=names)


@contextmanager
def one_line_errors() -> Generator[None, None, None]:
    """Turn an error of DuckDB into one line."""
    try:
        yield
    except duckdb.Error as error:
        code = ExitCode.USAGE if isinstance(error, _WRONG_SQL) else ExitCode.FAILURE
        raise CommandError(_one_line(str(error)), code) from None
    except BrokenPipeError:
        raise
    except (pa.ArrowException, OSError) as error:
        # Errors while the rows are read come through Arrow.
        raise CommandError(_one_line(str(error))) from None


def _configuration(scratch: str) -> dict[str, str | bool | int | float | list[str]]:
    return {
        "autoinstall_known_extensions": "false",
        "autoload_known_extensions": "false",
        "custom_extension_repository": scratch,
        "memory_limit": MEMORY_LIMIT,
        "python_enable_replacements": "false",
        "temp_directory": scratch,
    }


def _check(connection: duckdb.DuckDBPyConnection, sql: str) -> None:
    """Refuse anything but SELECT: DuckDB lets a statement write wherever it may read."""
    if any(one.type is not duckdb.StatementType.SELECT for one in connection.extract_statements(sql)):
        raise CommandError("the statement is not a SELECT", ExitCode.USAGE)


def asks_catalog(sql: str) -> bool:
    """True if a statement reads the catalogs of directories, not their logs."""
    with duckdb.connect(":memory:", config={"enable_external_access": "false"}) as connection:
        return CATALOG in _names_in(connection, sql)


def _names_in(connection: duckdb.DuckDBPyConnection, sql: str) -> set[str]:
    """The tables named in a statement; ``*`` if DuckDB cannot tell."""
    try:
        return {name.lower() for name in connection.get_table_names(sql)}
    except duckdb.Error:
        return {"*"}


def _one_line(text: str) -> str:
    """DuckDB's message without the excerpt of the statement, and without its advice to install extensions."""
    lines = []
    for line in map(str.strip, text.splitlines()):
        if line.startswith(_BESIDES):
            break
        lines.append(line)
    return " ".join(filter(None, lines))[:MESSAGE_MAX]
