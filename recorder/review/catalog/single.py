"""The row of one log as a Parquet file of its own, which lies beside the log in an object store."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import pyarrow as pa

from recorder.review.catalog.directory import row_of
from recorder.review.catalog.table import CatalogUnreadableError, read_stream, to_table, write_stream


def write_row(path: Path, file: str, modified_ns: int) -> bytes:
    """Make the row of a log, which is read from its beginning to its end.

    Args:
        path: the file.
        file: the log's name, as the row has it.
        modified_ns: the time of its last change.

    Raises:
        CommandError: it cannot be opened.
    """
    stream = BytesIO()
    write_stream(stream, to_table([row_of(path, file, modified_ns)]))
    return stream.getvalue()


def read_row(data: bytes, log_bytes: int) -> pa.Table:
    """Read the row of a log of this length, as a table of one row.

    Raises:
        CatalogUnreadableError: it is damaged, of another version, or of another log.
    """
    table = read_stream(BytesIO(data))
    if table.num_rows != 1 or table.column("bytes").to_pylist() != [log_bytes]:
        raise CatalogUnreadableError("is of another log")
    return table
