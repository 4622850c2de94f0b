"""The Parquet files of one log, written while it is read, in bounded memory.

Rows are below ``topic=.../robot=.../date=YYYY-MM-DD``, as Hive names directories. Of a key of ours the topic is
what follows the robot, so that all robots' rows of one kind are below one directory.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final
from urllib.parse import quote

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from recorder.review.columns.tables import LOG_TIME, Columns
from recorder.review.export.manifest import Column, Part, described

FILE_BYTES: Final = 16_000_000
"""Bytes of columns at which a topic's rows become a file."""

HELD_BYTES: Final = 40_000_000
"""Bytes of all columns held at which those of the largest topic become a file."""

WAITING_MAX: Final = 1
"""Files that wait to be written."""

NAME_MAX: Final = 200
"""A directory's name may have 255 bytes on most file systems. One that is longer is cut, and ends in a hash."""

NOBODY: Final = "__HIVE_DEFAULT_PARTITION__"
"""Hive's name for no value."""

COMPRESSION: Final = "zstd"
COMPRESSION_LEVEL: Final = 1


class Parts:
    """Takes batches and writes them below a directory.

    Args:
        root: the directory.
        sha256: of the log.

    Attributes:
        closed: the files that are whole.
        schemas: their columns.
    """

    def __init__(self, root: Path, sha256: str) -> None:
        self._root = root
        self._sha256 = sha256
        self._held: dict[Columns, list[pa.RecordBatch]] = {}
        self._bytes: dict[Columns, int] = {}
        self._count = 0
        # Writing is half of the work, and none of it Python's: it goes on while the next batch is read.
        self._worker = ThreadPoolExecutor(1, "parquet")
        self._jobs: deque[Future[None]] = deque()
        self.closed: list[Part] = []
        self.schemas: dict[str, list[Column]] = {}

    def add(self, columns: Columns, rows: pa.RecordBatch) -> None:
        """Rows of a topic.

        Raises:
            OSError: the disk does not take them.
        """
        self._held.setdefault(columns, []).append(rows)
        self._bytes[columns] = self._bytes.get(columns, 0) + rows.nbytes
        if self._bytes[columns] >= FILE_BYTES:
            self._flush(columns)
        while sum(self._bytes.values()) >= HELD_BYTES:
            self._flush(max(self._bytes, key=lambda one: self._bytes[one]))

    def close(self) -> None:
        """Write what is held.

        Raises:
            OSError: the disk does not take it.
        """
        for columns in list(self._held):
            self._flush(columns)
        self._wait(0)
        self.closed.sort(key=lambda part: part.path)

    def abandon(self) -> None:
        """Let go of what is not written."""
        self._worker.shutdown(cancel_futures=True)

    def _flush(self, columns: Columns) -> None:
        batches = self._held.pop(columns)
        del self._bytes[columns]
        self._count += 1
        self._wait(WAITING_MAX)
        self._jobs.append(self._worker.submit(self._write, columns, batches, self._count))

    def _wait(self, left: int) -> None:
        while len(self._jobs) > left:
            self._jobs.popleft().result()

    def _write(self, columns: Columns, batches: list[pa.RecordBatch], number: int) -> None:
        table = pa.Table.from_batches(batches).unify_dictionaries()
        key, self.schemas[key] = described(columns.schema)
        kinds = {field.name: field.type for field in table.schema}
        for date, rows in _by_date(table):
            directory = f"topic={_escaped(columns.place)}/robot={_escaped(columns.robot)}/date={date}"
            path = self._root / directory / f"part-{self._sha256[:16]}-{number}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(
                rows,
                path,
                row_group_size=rows.num_rows,
                compression=COMPRESSION,
                compression_level=COMPRESSION_LEVEL,
                use_dictionary=[name for name, kind in kinds.items() if _is_text(kind)],
                column_encoding={
                    name: "DELTA_BINARY_PACKED" for name, kind in kinds.items() if _is_whole_number(kind)
                },
            )
            span = pc.min_max(rows[LOG_TIME].cast(pa.int64()))
            self.closed.append(
                Part(
                    path=f"{directory}/{path.name}",
                    table=columns.table,
                    topic=columns.topic.name,
                    robot=columns.robot,
                    date=date,
                    rows=rows.num_rows,
                    bytes=path.stat().st_size,
                    start_ns=span["min"].as_py(),
                    end_ns=span["max"].as_py(),
                    columns=key,
                    sha256=self._sha256,
                )
            )


def _by_date(table: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """The rows of each day, by their log times."""
    days = table[LOG_TIME].cast(pa.date32(), safe=False)
    for day in sorted(pc.unique(days).to_pylist()):
        of_day = pc.equal(days, pa.scalar(day, pa.date32()))
        yield str(day), table if pc.all(of_day).as_py() else table.filter(of_day)


def _escaped(text: str) -> str:
    """A text as a part of a directory's name: as in a URL, so that it comes back when it is read."""
    name = quote(text, safe="@ ", errors="replace")
    if len(name) > NAME_MAX:
        digest = hashlib.sha256(text.encode(errors="replace")).hexdigest()[:16]
        name = f"{name[:NAME_MAX].rpartition('%')[0] or name[:NAME_MAX]}~{digest}"
    return name or NOBODY


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_dictionary(kind) or pa.types.is_string(kind))


def _is_whole_number(kind: pa.DataType) -> bool:
    """Times and counts: mostly a little more than the one before."""
    return bool(pa.types.is_integer(kind) or pa.types.is_timestamp(kind))
