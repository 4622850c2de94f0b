"""The tables of logs, which are read when a statement asks for them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any

import duckdb
import msgspec
import pyarrow as pa
import pyarrow.dataset as ds

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import BlockReader, Progress, Selection, no_topic
from recorder.reading.topics import Topic
from recorder.review.columns.reader import read_batches
from recorder.review.columns.tables import LOG_TIME, ROBOT, TOPIC, Columns, columns_of
from recorder.review.export.manifest import described
from recorder.review.querying.tables import WHOSE, TableInfo, free_name, own_columns, shown


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
    """Tables that are read from logs while a statement runs.

    Args:
        logs: in the order of their beginnings.
        selection: topics and time.
        faults: takes what cannot be read, once, however often a statement reads it.
        progress: receives the number of bytes that were read.
    """

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

    Args:
        rows: with every column that the statement needs.
        schema: of these.
        columns: those that DuckDB wants to see.
        wanted: the wanted rows, an expression of pyarrow's; None for all.
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
