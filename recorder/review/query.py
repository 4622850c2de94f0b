"""SQL over logs, over a dataset made of them, or over catalogs, with DuckDB: a table for each subject.

Tables of logs are read when a statement asks for them, the columns that it asks for alone. DuckDB holds
MEMORY_LIMIT, and uses a directory beyond that. Nothing is loaded from a network.
"""

from __future__ import annotations

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
import pyarrow.dataset as ds
from mcap import records

from recorder.encoding.protobuf import descriptor_set, schema_name
from recorder.encoding.routes import Route
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import BlockReader, Progress, Selection, no_topic
from recorder.reading.topics import Topic, topic_of
from recorder.review.columns import HEAD, LOG_TIME, ROBOT, TOPIC, Columns, columns_of, read_batches
from recorder.review.export import Column, Manifest, Part, described
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

    def declare(self, connection: duckdb.DuckDBPyConnection, _names: Collection[str]) -> None:
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

    def declare(self, connection: duckdb.DuckDBPyConnection, names: Collection[str]) -> None:
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


class Table(msgspec.Struct, eq=False):
    """A table of logs: topics whose columns are the same.

    Attributes:
        schema: with robot and topic as its first columns.
        topics: by the log's place the names of the topics that it holds.
    """

    name: str
    schema: pa.Schema
    topics: dict[int, set[str]]


def tables_of(logs: Sequence[LogFile], selection: Selection, faults: Faults) -> list[Table]:
    """The tables of logs, by name; those of our own subjects are there in any case, if only without a row.

    Topics of one name whose columns differ get a number: ``odometry_2``.
    """
    found: dict[tuple[str, str], Table] = {}
    for columns in own_columns().values():
        _table_of(found, columns)
    for place, log in enumerate(logs):
        for topic in topics_of(log, faults):
            if selection.wants(topic):
                columns = columns_of(topic)
                _table_of(found, columns).topics.setdefault(place, set()).add(topic.name)
    return sorted(found.values(), key=lambda table: table.name)


def _table_of(found: dict[tuple[str, str], Table], columns: Columns) -> Table:
    key = columns.table, described(columns.schema)[0]
    table = found.get(key)
    if table is None:
        name = free_name(columns.table, {one.name for one in found.values()})
        table = found[key] = Table(name, pa.schema([*WHOSE, *columns.schema]), {})
    return table


def topics_of(log: LogFile, faults: Faults) -> list[Topic]:
    """The topics of a log, by its summary, or else by all that is in it."""
    try:
        with log.path.open("rb") as stream:
            reader = BlockReader(stream, log, Selection(no_topic), faults)
            if not reader.topics:
                reader.declare_all()
            return list(reader.topics.values())
    except OSError as error:
        faults.add(f"{log.path}: {error.strerror or error}")
        return []


class LogSource:
    """Tables that are read from logs while a statement runs."""

    def __init__(
        self, logs: Sequence[LogFile], selection: Selection, faults: Faults, progress: Progress = lambda _: None
    ) -> None:
        self._logs = logs
        self._selection = selection
        self._faults = faults
        self._told: set[str] = set()
        self._progress = progress
        self._tables = tables_of(logs, selection, faults)

    @property
    def directories(self) -> list[str]:
        """Return the directories that DuckDB itself reads: none."""
        return []

    @property
    def tables(self) -> list[TableInfo]:
        """Return the tables that have rows."""
        return [
            TableInfo(
                table.name,
                sorted(set().union(*table.topics.values())),
                shown(described(table.schema)[1]),
            )
            for table in self._tables
            if table.topics
        ]

    def declare(self, connection: duckdb.DuckDBPyConnection, _names: Collection[str]) -> None:
        """Make the tables known."""
        for table in self._tables:
            connection.register(table.name, _LogTable(self, table))

    def batches(self, table: Table, wanted: Collection[str]) -> Iterator[pa.RecordBatch]:
        """The rows of a table, with the wanted columns only."""
        schema = pa.schema([field for field in table.schema if field.name in wanted])
        own = pa.schema(list(table.schema)[len(WHOSE) :])
        for place, names in table.topics.items():
            log = self._logs[place]
            selection = msgspec.structs.replace(
                self._selection, wants=lambda topic, names=names: topic.name in names
            )
            faults = Faults()
            # Without any column of the log nothing would say how many rows there are.
            for batch in read_batches(log, selection, faults, self._progress, {*wanted, LOG_TIME}):
                if batch.columns.schema == own:
                    whose = {ROBOT: batch.columns.robot or None, TOPIC: batch.columns.place}
                    columns = [
                        pa.repeat(pa.scalar(whose[name], pa.string()), batch.rows.num_rows)
                        if name in whose
                        else batch.rows.column(name)
                        for name in schema.names
                    ]
                    yield pa.RecordBatch.from_arrays(columns, schema=schema)
            self._tell(faults)

    def _tell(self, faults: Faults) -> None:
        for fault in faults.told:
            if fault not in self._told:
                self._told.add(fault)
                self._faults.add(fault)


class _LogTable(ds.InMemoryDataset):  # type: ignore[misc]  # pyarrow has no annotations
    """A dataset in DuckDB's eyes: it asks for a scanner of the wanted columns at each scan."""

    def __init__(self, source: LogSource, table: Table) -> None:
        super().__init__([], schema=table.schema)
        self._source = source
        self._table = table

    def scanner(self, columns: Sequence[str] | None = None, filter: Any = None, **_rest: Any) -> _Scan:  # noqa: A002, ANN401 - pyarrow's names
        names = self._table.schema.names
        about = "" if filter is None else str(filter)
        wanted = [name for name in names if columns is None or name in columns or name in about]
        schema = pa.schema([self._table.schema.field(name) for name in wanted])
        return _Scan(self._source.batches(self._table, frozenset(wanted)), schema, columns or wanted, filter)


class _Scan:
    """A scanner in DuckDB's eyes: it reads on demand, in the thread of its caller.

    Arrow's own reads ahead in threads that outlive a statement that ends early, and the interpreter with it.

    The columns are those that DuckDB wants to see; the filter is an expression of pyarrow's, None for all.
    """

    def __init__(
        self,
        rows: Iterator[pa.RecordBatch],
        schema: pa.Schema,
        columns: Sequence[str],
        wanted: Any,  # noqa: ANN401 - pyarrow has no annotations
    ) -> None:
        self._rows = rows
        self._schema = pa.schema([schema.field(name) for name in columns])
        self._columns = list(columns)
        self._wanted = wanted

    def to_reader(self) -> pa.RecordBatchReader:
        """The rows that are wanted, as they come."""
        return pa.RecordBatchReader.from_batches(self._schema, self._batches())

    def _batches(self) -> Iterator[pa.RecordBatch]:
        for batch in self._rows:
            found = batch if self._wanted is None else batch.filter(self._wanted)
            yield found.select(self._columns)


T = TypeVar("T")

MEMORY_LIMIT: Final = "160MB"

BATCH_ROWS: Final = 8192
"""Rows of an answer that are handed on at once."""

MESSAGE_MAX: Final = 500
"""Length at which a text for people is cut."""

_BESIDES: Final = ("LINE ", "Candidate functions:", "Please try installing")

_WRONG_SQL: Final = (duckdb.ProgrammingError, duckdb.NotSupportedError, duckdb.DataError)

LOOK_S: Final = 0.1
"""Interval at which a stop is looked for while DuckDB is at work."""

Source = LogSource | DatasetSource | CatalogSource


@contextmanager
def answer(
    source: Source,
    sql: str,
    stopped: Callable[[], bool] = lambda: False,
    *,
    may_use_files: bool = False,
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
                source.declare(connection, _names_in(connection, sql))
                if not may_use_files:
                    _only_reads(connection, sql)
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
    except duckdb.PermissionException as error:
        raise CommandError(f"{_one_line(str(error))} (--allow-files allows files)", ExitCode.USAGE) from None
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


def _only_reads(connection: duckdb.DuckDBPyConnection, sql: str) -> None:
    """Refuse what is no question: DuckDB lets a statement write wherever it lets it read."""
    if any(one.type is not duckdb.StatementType.SELECT for one in connection.extract_statements(sql)):
        raise CommandError("the statement is not a SELECT (--allow-files allows others)", ExitCode.USAGE)


def _shut_in(connection: duckdb.DuckDBPyConnection, directories: list[str]) -> None:
    """Let the statement see no file but in these directories: it may come from anybody, as a log may."""
    connection.execute("SET allowed_directories = $1", [directories])
    connection.execute("SET enable_external_access = false")


def asks_catalog(sql: str) -> bool:
    """Report whether a statement reads the catalogs of directories, and not their logs."""
    with duckdb.connect(":memory:", config={"enable_external_access": "false"}) as connection:
        return CATALOG in _names_in(connection, sql)


def _names_in(connection: duckdb.DuckDBPyConnection, sql: str) -> set[str]:
    """The tables that a statement names; none where DuckDB does not know before it has them."""
    try:
        return {name.lower() for name in connection.get_table_names(sql)}
    except duckdb.Error:
        return set()


def _one_line(text: str) -> str:
    """DuckDB's message without its drawing of the statement, and without its advice to go to the network."""
    lines = []
    for line in map(str.strip, text.splitlines()):
        if line.startswith(_BESIDES):
            break
        lines.append(line)
    return " ".join(filter(None, lines))[:MESSAGE_MAX]
