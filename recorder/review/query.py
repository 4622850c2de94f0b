"""SQL over logs, over a dataset made of them, or over catalogs, with DuckDB: a table for each subject.

The tables of logs that a statement names are first written as a dataset, in a directory that goes with the answer.
DuckDB holds MEMORY_LIMIT, and uses that directory beyond. Nothing is loaded from a network.
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
    """A table."""

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
    """Columns as people see them: an enumeration is a text all the same."""
    return [
        msgspec.structs.replace(one, type="string") if one.type.startswith("dictionary<") else one
        for one in columns
    ]


CATALOG: Final = "catalog"
"""The table's name."""


class CatalogSource:
    """A table of catalogs' rows."""

    directories: Final[list[str]] = []
    tables: Final[list[TableInfo]] = []

    def __init__(self, rows: pa.Table) -> None:
        self._rows = rows

    def declare(self, connection: duckdb.DuckDBPyConnection, _names: Collection[str], _scratch: Path) -> None:
        """Make the table known."""
        connection.register(CATALOG, self._rows)


class DatasetSource:
    """Tables of a dataset's Parquet files."""

    def __init__(self, directory: Path, manifest: Manifest) -> None:
        self._directory = directory.absolute()
        self._manifest = manifest
        self._parts: dict[str, list[Part]] = {}
        own = {(name, described(columns.schema)[0]) for name, columns in own_columns().items()}
        names: dict[tuple[str, str], str] = {}
        # Our own subjects have their names before others.
        for part in sorted(manifest.files, key=lambda part: (part.table, part.columns) not in own):
            key = part.table, part.columns
            if key not in names:
                is_own = key in own or self._is_like(part)
                taken = self._parts if is_own else {*self._parts, *own_columns()}
                names[key] = free_name(part.table, taken)
            self._parts.setdefault(names[key], []).append(part)

    def _is_like(self, part: Part) -> bool:
        """Report whether a table is of a subject of ours, as another version had it: it has fields in common."""
        own = own_columns().get(part.table)
        names = {column.name for column in self._manifest.schemas.get(part.columns, [])}
        return own is not None and bool(names & set(own.schema.names[len(HEAD) :]))

    @property
    def directories(self) -> list[str]:
        """Return the directory of its files, as DuckDB sees it before and after it looks for patterns."""
        return [str(self._directory), _unglobbed(str(self._directory))]

    @property
    def tables(self) -> list[TableInfo]:
        """Return the tables of the dataset."""
        return [
            TableInfo(
                name,
                sorted({part.topic for part in parts}),
                shown([*described(pa.schema(WHOSE))[1], *self._manifest.schemas.get(parts[0].columns, [])]),
            )
            for name, parts in sorted(self._parts.items())
        ]

    def declare(self, connection: duckdb.DuckDBPyConnection, names: Collection[str], _scratch: Path) -> None:
        """Make the named tables known, or all if none is named; and those of our own subjects that are empty."""
        for name, columns in own_columns().items():
            if name not in self._parts:
                connection.register(name, pa.schema([*WHOSE, *columns.schema]).empty_table())
        for name, parts in self._parts.items():
            # Looking into files costs time; but where a name is unknown, DuckDB knows one that is like it.
            if names and name not in names and all(one in self._parts or one in own_columns() for one in names):
                continue
            files = ", ".join(_quoted(_unglobbed(str(self._directory / part.path))) for part in parts)
            # The names are made of letters, digits and lines; the files are quoted.
            connection.execute(
                f'CREATE VIEW "{name}" AS SELECT {ROBOT}, {TOPIC}, * EXCLUDE ({TOPIC}, {ROBOT}, date) '  # noqa: S608
                f"FROM read_parquet([{files}], hive_partitioning = true, hive_types_autocast = false)"
            )


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _unglobbed(path: str) -> str:
    """A path in which DuckDB sees no pattern."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in path)


class LogSource:
    """Tables of logs: those that a statement names become a dataset for as long as it is answered."""

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
        """Return the tables whose topics the logs declare."""
        found = [columns_of(one) for log in self._logs for one in survey([log], self._faults).topics.values()]
        parts = [Part("", one.table, one.topic.name, one.robot, 0, 0, described(one.schema)[0]) for one in found]
        return DatasetSource(Path(), _manifest(parts, dict(described(one.schema) for one in found))).tables

    def declare(self, connection: duckdb.DuckDBPyConnection, names: Collection[str], scratch: Path) -> None:
        """Write the named tables as files, and make them known; the second table of a name has a number."""
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

BATCH_ROWS: Final = 8192
"""Rows of an answer that are handed on at once."""

MESSAGE_MAX: Final = 500
"""Length at which a text for people is cut."""

_BESIDES: Final = ("LINE ", "Candidate functions:", "Please try installing")

_WRONG_SQL: Final = (
    duckdb.PermissionException,
    duckdb.ProgrammingError,
    duckdb.NotSupportedError,
    duckdb.DataError,
)

LOOK_S: Final = 0.1
"""Interval at which a stop is looked for while DuckDB is at work."""

Source = LogSource | DatasetSource | CatalogSource


@contextmanager
def answer(
    source: Source,
    sql: str,
    stopped: Callable[[], bool] = lambda: False,
    *,
    parameters: Mapping[str, Any] | None = None,
) -> Generator[pa.RecordBatchReader | None, None, None]:
    """The rows that a statement gives, as they come; None if it gives none.

    DuckDB heeds no signal by itself, so it works in a thread of its own; ``stopped`` ends that.

    Raises:
        CommandError: DuckDB does not understand it, or cannot do it; also while the rows are read, see ``told``.
        KeyboardInterrupt: it was stopped; also while the rows are read.
    """
    with TemporaryDirectory(prefix="cruiser-query-") as scratch, ThreadPoolExecutor(1) as thread:
        connection = duckdb.connect(":memory:", config=_configuration(scratch))

        def run(act: Callable[..., T], *words: Any) -> T:  # noqa: ANN401 - whatever it takes
            future = thread.submit(act, *words)
            while not wait([future], LOOK_S).done:
                if stopped():
                    connection.interrupt()
            if stopped():
                raise KeyboardInterrupt
            return future.result()

        try:
            with told():
                connection.execute("SET TimeZone = 'UTC'")
                _check(connection, sql)
                source.declare(connection, _names_in(connection, sql), Path(scratch))
                _shut_in(connection, [scratch, *source.directories])
                connection.execute("SET lock_configuration = true")
                relation = run(partial(connection.sql, params=parameters), sql)
                rows = None if relation is None else run(relation.to_arrow_reader, BATCH_ROWS)
            yield None if rows is None else _renamed(rows, run)
        finally:
            connection.close()


def _renamed(rows: pa.RecordBatchReader, run: Callable[..., Any]) -> pa.RecordBatchReader:
    """The same rows, with a number behind the names that columns share: an object has each name once."""
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
def told() -> Generator[None, None, None]:
    """Turn an error of DuckDB into one line."""
    try:
        yield
    except duckdb.Error as error:
        code = ExitCode.USAGE if isinstance(error, _WRONG_SQL) else ExitCode.FAILURE
        raise CommandError(_one_line(str(error)), code) from None
    except BrokenPipeError:
        raise
    except (pa.ArrowException, OSError) as error:
        # What goes wrong while the rows of an answer are read comes through Arrow.
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
    """Refuse what is no SQL, or no question: DuckDB lets a statement write wherever it lets it read."""
    if any(one.type is not duckdb.StatementType.SELECT for one in connection.extract_statements(sql)):
        raise CommandError("the statement is not a SELECT", ExitCode.USAGE)


def _shut_in(connection: duckdb.DuckDBPyConnection, directories: list[str]) -> None:
    """Let the statement see no file but in these directories: it may come from anybody, as a log may."""
    connection.execute("SET allowed_directories = $1", [directories])
    connection.execute("SET enable_external_access = false")


def asks_catalog(sql: str) -> bool:
    """Report whether a statement reads the catalogs of directories, and not their logs."""
    with duckdb.connect(":memory:", config={"enable_external_access": "false"}) as connection:
        return CATALOG in _names_in(connection, sql)


def _names_in(connection: duckdb.DuckDBPyConnection, sql: str) -> set[str]:
    """The tables that a statement names; any, as a pattern, where DuckDB does not know before it has them."""
    try:
        return {name.lower() for name in connection.get_table_names(sql)}
    except duckdb.Error:
        return {"*"}


def _one_line(text: str) -> str:
    """DuckDB's message without its drawing of the statement, and without its advice to go to the network."""
    lines = []
    for line in map(str.strip, text.splitlines()):
        if line.startswith(_BESIDES):
            break
        lines.append(line)
    return " ".join(filter(None, lines))[:MESSAGE_MAX]
