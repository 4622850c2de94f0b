"""The rows of a catalog as an Arrow table, and as a Parquet file that says of which form it is."""

from __future__ import annotations

import os
import resource
from collections.abc import Collection, Generator, Iterable
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from msgspec import inspect

from recorder.review.catalog.rows import FORMAT, NEVER_NS, VERSION, CatalogRow, CatalogUnreadableError
from schemas.command_line import other_kind

ROWS_IN_GROUP: Final = 8192

READ_MAX_BYTES: Final = 2 << 30
"""The memory that reading a catalog may take: one of a few megabytes can be made that unpacks to any size."""


def _field(name: str, kind: inspect.Type) -> pa.Field:
    """The column or part of one; null is no value but where the row's class has None."""
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
"""The columns, made of the fields of ``CatalogRow``."""


def to_table(rows: Iterable[CatalogRow]) -> pa.Table:
    """Rows as a table."""
    return pa.Table.from_pylist([_bounded(msgspec.to_builtins(row)) for row in rows], SCHEMA)


def _bounded(value: Any) -> Any:  # noqa: ANN401 - any of a row's parts
    """The same with all counts in the range of a column: those of a log may be of anybody's making."""
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
    """The rows of a table with all columns."""
    return msgspec.convert(table.to_pylist(maps_as_pydicts="strict"), list[CatalogRow])


def read_table(path: Path, columns: Collection[str] | None = None) -> pa.Table:
    """Read a catalog.

    Args:
        path: the file.
        columns: these alone, ``file`` among them; all unless told otherwise.

    Raises:
        FileNotFoundError: there is none.
        CatalogUnreadableError: it cannot be read.
    """
    try:
        if kind := other_kind(path.stat().st_mode):
            raise CatalogUnreadableError(f"is {kind}")
        with path.open("rb") as stream:
            return read_stream(stream, columns)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise CatalogUnreadableError("is damaged") from error


def read_stream(stream: BinaryIO, columns: Collection[str] | None = None) -> pa.Table:
    """Read a catalog from an open file.

    Args:
        stream: the file.
        columns: these alone, ``file`` among them; all unless told otherwise.

    Raises:
        CatalogUnreadableError: it cannot be read.
    """
    try:
        with bounded_memory(), pq.ParquetFile(stream, page_checksum_verification=True) as file:
            schema = file.schema_arrow
            told: dict[bytes, bytes] = schema.metadata or {}
            version = told.get(b"version", b"").decode(errors="replace")
            if told.get(b"format") != FORMAT.encode():
                raise CatalogUnreadableError("is no catalog")
            if version != str(VERSION) or not schema.equals(SCHEMA):
                raise CatalogUnreadableError("is of another version")
            table = file.read(columns=None if columns is None else list(columns)).combine_chunks()
            if pc.count_distinct(table.column("file")).as_py() < table.num_rows:
                raise CatalogUnreadableError("names a log twice")
            return table
    except MemoryError as error:
        raise CatalogUnreadableError("unpacks to too much") from error
    except (pa.ArrowException, OSError, ValueError) as error:
        raise CatalogUnreadableError("is damaged") from error


@contextmanager
def bounded_memory() -> Generator[None, None, None]:
    """Let this process take ``READ_MAX_BYTES`` more than it has. Whoever asks for more gets a MemoryError."""
    before, hard = resource.getrlimit(resource.RLIMIT_DATA)
    taken = int(Path("/proc/self/statm").read_text("ascii").split()[5]) * resource.getpagesize()
    bounds = [one for one in (taken + READ_MAX_BYTES, before, hard) if one != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min(bounds), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, hard))


def write_table(path: Path, table: pa.Table) -> None:
    """Replace a catalog in one step: whoever reads meanwhile sees the old one or the new one.

    Raises:
        OSError: the disk does not take it.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    # A link of that name may lead to anywhere.
    beside.unlink(missing_ok=True)
    try:
        with beside.open("xb") as stream:
            write_stream(stream, table)
            stream.flush()
            os.fsync(stream.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def write_stream(stream: BinaryIO, table: pa.Table) -> None:
    """Write a catalog into an open file.

    Raises:
        OSError: the disk does not take it.
    """
    pq.write_table(
        table.replace_schema_metadata(SCHEMA.metadata),
        stream,
        row_group_size=ROWS_IN_GROUP,
        compression="zstd",
        write_page_checksum=True,
    )
