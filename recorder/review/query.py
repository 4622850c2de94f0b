"""SQL over logs, or over a dataset made of them, with DuckDB: a table for each subject.

The tables of logs are read when a statement asks for them: of the log only chunks that hold their topics are
unpacked, and only the columns that are asked for are made. DuckDB holds MEMORY_LIMIT and uses a directory on the
disk beyond that. Nothing is loaded from a network: extensions are neither looked for nor installed.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import duckdb
import msgspec
import pyarrow as pa
import pyarrow.dataset as ds
from mcap import records

from recorder.mcap_scan import BROKEN
from recorder.review.columns.reader import read_batches
from recorder.review.columns.tables import LOG_TIME, ROBOT, UNIT_KEY, Columns, columns_of
from recorder.review.export.known_rows import KnownRows, overlapping
from recorder.review.export.manifest import Manifest, Part, described
from recorder.review.faults import Faults
from recorder.review.logs import LogFile
from recorder.review.pieces import PackedChunk, read_pieces
from recorder.review.rows import Progress, Selection
from recorder.review.summary import read_summary
from recorder.review.topics import Topic, topic_of
from recorder.review.walk import messages
from schemas.exit_codes import CommandError, ExitCode

MEMORY_LIMIT: Final = "160MB"

BATCH_ROWS: Final = 8192
"""Rows of an answer that are handed on at once."""

MESSAGE_MAX: Final = 500
"""Letters of what is told to a person."""

_BESIDES: Final = ("LINE ", "Candidate functions:", "Please try installing")

_ROBOT_FIELD: Final = pa.field(ROBOT, pa.string())

_WRONG_SQL: Final = (duckdb.ProgrammingError, duckdb.NotSupportedError, duckdb.DataError)


class ColumnInfo(msgspec.Struct, frozen=True):
    """A column of a table.

    Attributes:
        type: by Arrow's name.
        unit: empty if there is none.
    """

    name: str
    type: str
    unit: str


class TableInfo(msgspec.Struct, frozen=True):
    """A table.

    Attributes:
        topics: whose messages it holds.
    """

    name: str
    topics: list[str]
    columns: list[ColumnInfo]


class Table(msgspec.Struct, eq=False):
    """A table of logs: topics whose columns are the same.

    Attributes:
        schema: with the robot as its first column.
        topics: by the log's place the names of the topics that it holds.
    """

    name: str
    schema: pa.Schema
    topics: dict[int, set[str]]


def tables_of(logs: Sequence[LogFile], faults: Faults, wanted: Selection) -> list[Table]:
    """The tables of logs, by name. Topics of one name whose columns differ get a number: ``odometry_2``."""
    found: dict[tuple[str, str], Table] = {}
    for place, log in enumerate(logs):
        for topic in topics_of(log, faults):
            if wanted.wants(topic):
                _add_topic(found, place, columns_of(topic))
    return sorted(found.values(), key=lambda table: table.name)


def _add_topic(found: dict[tuple[str, str], Table], place: int, columns: Columns) -> None:
    key = columns.table, described(columns.schema)[0]
    table = found.get(key)
    if table is None:
        name = _free_name(columns.table, {one.name for one in found.values()})
        table = found[key] = Table(name, pa.schema([_ROBOT_FIELD, *columns.schema]), {})
    table.topics.setdefault(place, set()).add(columns.topic.name)


def _free_name(name: str, taken: Collection[str]) -> str:
    free, number = name, 1
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


def topics_of(log: LogFile, faults: Faults) -> list[Topic]:
    """The topics of a log, by its summary, or else by all that is in it."""
    schemas: dict[int, records.Schema] = {}
    channels: dict[int, records.Channel] = {}
    try:
        with log.path.open("rb") as stream:
            summary = read_summary(stream)
            if summary is not None and summary.channels:
                schemas, channels = dict(summary.schemas), dict(summary.channels)
            else:
                for one in _declared(stream, log.bytes):
                    if isinstance(one, records.Schema):
                        schemas.setdefault(one.id, one)
                    else:
                        channels.setdefault(one.id, one)
    except OSError as error:
        faults.add(f"{log.path}: {error.strerror or error}")
    return [topic_of(channel, schemas.get(channel.schema_id)) for channel in channels.values()]


def _declared(stream: Any, size: int) -> Iterator[records.Schema | records.Channel]:  # noqa: ANN401 - BinaryIO
    known: set[int] = set()
    for piece in read_pieces(stream, size, is_verifying=False):
        found: Iterator[Any] = iter([piece])
        if isinstance(piece, PackedChunk):
            if piece.index is not None and piece.index.keys() <= known:
                continue
            try:
                found = messages(piece.offset, piece.unpack(stream))
            except BROKEN:
                continue
        for one in found:
            if isinstance(one, records.Channel):
                known.add(one.id)
            if isinstance(one, records.Schema | records.Channel):
                yield one


class LogSource:
    """Tables that are read from logs while a statement runs.

    Args:
        logs: in the order of their beginnings.
        selection: topics and time.
        faults: takes what cannot be read, once, however often a statement reads it.
        progress: is told of bytes that were read.
    """

    def __init__(
        self, logs: Sequence[LogFile], selection: Selection, faults: Faults, progress: Progress = lambda _: None
    ) -> None:
        self._logs = logs
        self._selection = selection
        self._faults = faults
        self._told: set[str] = set()
        self._progress = progress
        self._tables = tables_of(logs, faults, selection)

    @property
    def tables(self) -> list[TableInfo]:
        """What there is."""
        return [
            TableInfo(
                table.name,
                sorted(set().union(*table.topics.values())),
                [_column_info(field) for field in table.schema],
            )
            for table in self._tables
        ]

    def declare(self, connection: duckdb.DuckDBPyConnection, _names: Collection[str]) -> None:
        """Make the tables known."""
        for table in self._tables:
            connection.register(table.name, _LogTable(self, table))

    def batches(self, table: Table, wanted: Collection[str]) -> Iterator[pa.RecordBatch]:
        """The rows of a table, with the wanted columns only."""
        schema = pa.schema([field for field in table.schema if field.name in wanted])
        own = table.schema.remove(0)
        for place, names in table.topics.items():
            log = self._logs[place]
            selection = msgspec.structs.replace(
                self._selection, wants=lambda topic, names=names: topic.name in names
            )
            faults = Faults()
            known = KnownRows(log, overlapping(log, self._logs[:place]), selection)
            # Without any column of the log nothing would say how many rows there are.
            for batch in read_batches(log, selection, faults, self._progress, known.sift, {*wanted, LOG_TIME}):
                if batch.columns.schema == own:
                    robot = pa.repeat(pa.scalar(batch.columns.robot or None, pa.string()), batch.rows.num_rows)
                    columns = [robot if name == ROBOT else batch.rows.column(name) for name in schema.names]
                    yield pa.RecordBatch.from_arrays(columns, schema=schema)
            self._tell(faults)

    def _tell(self, faults: Faults) -> None:
        for fault in faults.told:
            if fault not in self._told:
                self._told.add(fault)
                self._faults.add(fault)


class _LogTable(ds.InMemoryDataset):  # type: ignore[misc]  # pyarrow has no annotations
    """What DuckDB takes for a dataset: each time that it scans, it says which columns it wants."""

    def __init__(self, source: LogSource, table: Table) -> None:
        super().__init__([], schema=table.schema)
        self._source = source
        self._table = table

    def scanner(self, columns: Sequence[str] | None = None, filter: Any = None, **_rest: Any) -> ds.Scanner:  # noqa: A002, ANN401 - pyarrow's names
        names = self._table.schema.names
        about = "" if filter is None else str(filter)
        wanted = [name for name in names if columns is None or name in columns or name in about]
        schema = pa.schema([self._table.schema.field(name) for name in wanted])
        rows = self._source.batches(self._table, frozenset(wanted))
        return ds.Scanner.from_batches(rows, schema=schema, columns=columns, filter=filter)


class DatasetSource:
    """Tables of a dataset's Parquet files.

    Args:
        directory: of the dataset.
        manifest: its own.
    """

    def __init__(self, directory: Path, manifest: Manifest) -> None:
        self._directory = directory.absolute()
        self._manifest = manifest
        self._parts: dict[str, list[Part]] = {}
        names: dict[tuple[str, str], str] = {}
        for part in manifest.files:
            key = part.table, part.columns
            if key not in names:
                names[key] = _free_name(part.table, self._parts)
            self._parts.setdefault(names[key], []).append(part)

    @property
    def tables(self) -> list[TableInfo]:
        """What there is."""
        return [
            TableInfo(
                name,
                sorted({part.topic for part in parts}),
                [
                    _column_info(_ROBOT_FIELD),
                    *(
                        ColumnInfo(one.name, _type_name(one.type), one.unit)
                        for one in self._manifest.schemas.get(parts[0].columns, [])
                    ),
                ],
            )
            for name, parts in sorted(self._parts.items())
        ]

    def declare(self, connection: duckdb.DuckDBPyConnection, names: Collection[str]) -> None:
        """Make the named tables known, or all if none is named."""
        for name, parts in self._parts.items():
            # Looking into files costs time; but where a name is unknown, DuckDB knows one that is like it.
            if names and name not in names and all(one in self._parts for one in names):
                continue
            files = ", ".join(_quoted(_unglobbed(str(self._directory / part.path))) for part in parts)
            # The names are made of letters, digits and lines; the files are quoted.
            connection.execute(
                f'CREATE VIEW "{name}" AS SELECT {ROBOT}, * EXCLUDE (topic, {ROBOT}, date) '  # noqa: S608
                f"FROM read_parquet([{files}], hive_partitioning = true, hive_types_autocast = false)"
            )


Source = LogSource | DatasetSource


@contextmanager
def answer(source: Source, sql: str) -> Generator[pa.RecordBatchReader | None, None, None]:
    """The rows that a statement gives, as they come; None if it gives none.

    Raises:
        CommandError: DuckDB does not understand it, or cannot do it; also while the rows are read, see ``told``.
    """
    with TemporaryDirectory(prefix="cruiser-query-") as scratch:
        connection = duckdb.connect(":memory:", config=_configuration(scratch))
        try:
            with told():
                connection.execute("SET TimeZone = 'UTC'")
                source.declare(connection, _names_in(connection, sql))
                connection.execute("SET lock_configuration = true")
                relation = connection.sql(sql)
                rows = None if relation is None else relation.to_arrow_reader(BATCH_ROWS)
            yield rows
        finally:
            connection.close()


@contextmanager
def told() -> Generator[None, None, None]:
    """What DuckDB says is wrong becomes one line."""
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


def _names_in(connection: duckdb.DuckDBPyConnection, sql: str) -> set[str]:
    """The tables that a statement names; none where DuckDB cannot tell before it knows them."""
    try:
        return {name.lower() for name in connection.get_table_names(sql)}
    except duckdb.Error:
        return set()


def _one_line(text: str) -> str:
    """What DuckDB says, without its drawing of the statement, and without its advice to go to the network."""
    lines = []
    for line in map(str.strip, text.splitlines()):
        if line.startswith(_BESIDES):
            break
        lines.append(line)
    return " ".join(filter(None, lines))[:MESSAGE_MAX]


def _column_info(field: pa.Field) -> ColumnInfo:
    unit = (field.metadata or {}).get(UNIT_KEY, b"").decode()
    return ColumnInfo(field.name, _type_name(str(field.type)), unit)


def _type_name(text: str) -> str:
    """A type by Arrow's name; that of an enumeration is a text all the same."""
    return "string" if text.startswith("dictionary<") else text


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _unglobbed(path: str) -> str:
    """A path in which DuckDB sees no pattern."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in path)
