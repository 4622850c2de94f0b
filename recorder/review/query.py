"""SQL over logs, over a dataset made of them, or over catalogs, with DuckDB: a table for each subject.

The tables of logs are read when a statement asks for them: of the log only chunks that hold their topics are
unpacked, and only the columns that are asked for are made. DuckDB holds MEMORY_LIMIT and uses a directory on the
disk beyond that. Nothing is loaded from a network: extensions are neither looked for nor installed.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import partial
from itertools import count
from tempfile import TemporaryDirectory
from typing import Any, Final, TypeVar

import duckdb
import pyarrow as pa

from recorder.review.querying.catalog_source import CATALOG, CatalogSource
from recorder.review.querying.dataset_source import DatasetSource
from recorder.review.querying.log_source import LogSource
from schemas.command_line import CommandError, ExitCode

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

    Args:
        source: the tables that it may read.
        sql: the statement.
        stopped: turns true when nobody waits for the answer any more. DuckDB heeds no signal by itself, so it
            works in a thread of its own.
        may_use_files: the statement may read and write files of the user's, and not only what the source gives.
        parameters: values of what the statement names with ``$``.

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
