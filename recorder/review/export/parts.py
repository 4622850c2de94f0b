"""The Parquet files of one log, written while it is read, in bounded memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from recorder.review.columns.tables import Columns
from recorder.review.export.manifest import Column, Part, described
from recorder.review.export.partitions import bounds_ns, by_date, directory_of

GROUP_BYTES: Final = 8_000_000
"""Bytes of columns at which a row group is written."""

HELD_BYTES: Final = 32_000_000
"""Bytes of all columns held at which the largest row group is written."""

GROUPS_MAX: Final = 32
"""After so many row groups a file is ended, and continued in another part: their metadata is held until then."""

OPEN_MAX: Final = 64
"""Files that are open at once; one that is closed continues in another part."""

WAITING_MAX: Final = 1
"""Row groups that wait to be written."""

COMPRESSION: Final = "zstd"
COMPRESSION_LEVEL: Final = 1


class _Open(msgspec.Struct):
    """A file that is being written."""

    writer: pq.ParquetWriter
    path: str
    start_ns: int
    end_ns: int
    rows: int = 0
    groups: int = 0


class _Partition:
    """The rows of one topic and day."""

    def __init__(self, columns: Columns, date: str) -> None:
        self.columns = columns
        self.date = date
        self.directory = directory_of(columns, date)
        self.batches: list[pa.RecordBatch] = []
        self.held_bytes = 0
        self.open: _Open | None = None


class Parts:
    """Takes batches and writes them below a directory.

    Args:
        root: the directory.
        stem: the files' name before their number: the same for no two logs.
        sha256: of the log.

    Attributes:
        closed: the files that are whole.
        schemas: their columns.
    """

    def __init__(self, root: Path, stem: str, sha256: str) -> None:
        self._root = root
        self._stem = stem
        self._sha256 = sha256
        self._partitions: dict[tuple[Columns, str], _Partition] = {}
        self._numbers: dict[str, int] = {}
        self._held_bytes = 0
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
        for date, of_day in by_date(rows):
            key = columns, date
            partition = self._partitions.get(key)
            if partition is None:
                partition = self._partitions[key] = _Partition(columns, date)
            size = of_day.nbytes
            partition.batches.append(of_day)
            partition.held_bytes += size
            self._held_bytes += size
            if partition.held_bytes >= GROUP_BYTES:
                self._flush(partition)
        while self._held_bytes >= HELD_BYTES:
            self._flush(max(self._partitions.values(), key=lambda one: one.held_bytes))

    def close(self) -> None:
        """Write what is held, and end all files.

        Raises:
            OSError: the disk does not take it.
        """
        for partition in self._partitions.values():
            self._flush(partition)
            self._submit(self._end, partition)
        self._wait(0)

    def abandon(self) -> None:
        """Let go of what is still open, as it is."""
        self._worker.shutdown(cancel_futures=True)
        for partition in self._partitions.values():
            if partition.open is not None:
                with suppress(OSError):
                    partition.open.writer.close()

    def _flush(self, partition: _Partition) -> None:
        if partition.batches:
            batches, partition.batches = partition.batches, []
            self._held_bytes -= partition.held_bytes
            partition.held_bytes = 0
            self._submit(self._write, partition, batches)

    def _submit(self, job: Callable[..., None], *arguments: object) -> None:
        """Have it done by the thread that writes, behind what that has to do already."""
        self._wait(WAITING_MAX)
        self._jobs.append(self._worker.submit(job, *arguments))

    def _wait(self, left: int) -> None:
        while len(self._jobs) > left:
            self._jobs.popleft().result()

    def _write(self, partition: _Partition, batches: list[pa.RecordBatch]) -> None:
        table = pa.Table.from_batches(batches).unify_dictionaries()
        spans = [bounds_ns(batch) for batch in batches]
        file = partition.open or self._begin(partition, table.schema)
        file.start_ns = min([file.start_ns, *(start for start, _ in spans)])
        file.end_ns = max([file.end_ns, *(end for _, end in spans)])
        file.rows += table.num_rows
        file.groups += 1
        file.writer.write_table(table, row_group_size=table.num_rows)
        if file.groups >= GROUPS_MAX:
            self._end(partition)

    def _begin(self, partition: _Partition, schema: pa.Schema) -> _Open:
        # The one that was begun first is the one that is most likely done: days go by.
        opened = [one for one in self._partitions.values() if one.open is not None]
        if len(opened) >= OPEN_MAX:
            self._end(opened[0])
        number = self._numbers[partition.directory] = self._numbers.get(partition.directory, -1) + 1
        path = f"{partition.directory}/{self._stem}-{number}.parquet"
        (self._root / partition.directory).mkdir(parents=True, exist_ok=True)
        about = {"topic": partition.columns.topic.name, "log_sha256": self._sha256}
        writer = pq.ParquetWriter(
            self._root / path,
            schema.with_metadata(about),
            compression=COMPRESSION,
            compression_level=COMPRESSION_LEVEL,
            use_dictionary=[field.name for field in schema if _is_text(field.type)],
            column_encoding={
                field.name: "DELTA_BINARY_PACKED" for field in schema if _is_whole_number(field.type)
            },
        )
        partition.open = _Open(writer, path, 2**63, 0)
        return partition.open

    def _end(self, partition: _Partition) -> None:
        file = partition.open
        if file is None:
            return
        partition.open = None
        file.writer.close()
        columns = partition.columns
        key, described_columns = described(columns.schema)
        self.schemas[key] = described_columns
        self.closed.append(
            Part(
                path=file.path,
                table=columns.table,
                topic=columns.topic.name,
                robot=columns.robot,
                date=partition.date,
                rows=file.rows,
                bytes=(self._root / file.path).stat().st_size,
                start_ns=file.start_ns,
                end_ns=file.end_ns,
                columns=key,
                sha256=self._sha256,
            )
        )


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_dictionary(kind) or pa.types.is_string(kind))


def _is_whole_number(kind: pa.DataType) -> bool:
    """Times and counts: mostly a little more than the one before."""
    return bool(pa.types.is_integer(kind) or pa.types.is_timestamp(kind))
