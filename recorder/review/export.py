"""Logs as datasets of Parquet files by topic, robot and date, and as CSV.

Directories have Hive's names, ``topic=.../robot=.../date=YYYY-MM-DD``. No file is overwritten: files are written
in a hidden directory, moved when all are finished, and ``manifest.json`` comes last. In CSV and JSON times are ISO
8601 in UTC, to the nanosecond; bytes are hexadecimal in their own cell, else base64.
"""

from __future__ import annotations

import hashlib
from base64 import b64encode
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pyarrow import csv

from recorder.disk.files import give_name, new_path, staging
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import END_OF_TIME_NS, Progress, Selection, file_name, wants_of
from recorder.review.columns import LOG_TIME, UNIT_KEY, Columns, read_batches
from recorder.review.tasks import HERE, Act
from schemas.command_line import CommandError, plain

MANIFEST_NAME: Final = "manifest.json"
FORMAT: Final = "cruiser-dataset"
VERSION: Final = 1

_BLOCK_BYTES: Final = 1 << 20


class Column(msgspec.Struct, frozen=True):
    """A column; ``unit`` is empty if it is unknown."""

    name: str
    type: str
    unit: str = ""


class Input(msgspec.Struct, frozen=True):
    """A log that was read.

    Attributes:
        path: as given, with escapes where it cannot be printed.
        sha256: of the whole file, hexadecimal.
        faults: the first of ``fault_count`` unreadable parts.
    """

    path: str
    bytes: int
    sha256: str
    rows: int
    faults: list[str]
    fault_count: int


class Part(msgspec.Struct, frozen=True):
    """A Parquet file; ``columns`` is the key in the manifest's ``schemas``."""

    path: str
    table: str
    topic: str
    robot: str
    rows: int
    bytes: int
    columns: str


class Manifest(msgspec.Struct, frozen=True):
    """The manifest; ``schemas`` are columns by their hash."""

    format: str
    version: int
    product: str
    inputs: list[Input]
    files: list[Part]
    schemas: dict[str, list[Column]]


def read_manifest(directory: Path) -> Manifest | None:
    """The manifest of a dataset; None if the directory has none, CommandError if it cannot be read."""
    path = directory / MANIFEST_NAME
    try:
        text = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise CommandError(f"cannot read {plain(str(path))}: {error.strerror or error}") from error
    try:
        manifest = msgspec.json.decode(text, type=Manifest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise CommandError(f"{plain(str(path))} is no manifest of a dataset: {plain(str(error))}") from error
    if manifest.format != FORMAT or manifest.version != VERSION:
        raise CommandError(f"{plain(str(path))} has another format or version")
    return manifest


def described(schema: pa.Schema) -> tuple[str, list[Column]]:
    """The hash of a table's columns, and the columns."""
    columns = [
        Column(field.name, str(field.type), (field.metadata or {}).get(UNIT_KEY, b"").decode()) for field in schema
    ]
    return hashlib.sha256(msgspec.json.encode(columns)).hexdigest()[:12], columns


def sha256_of(path: Path, size: int) -> str:
    """The hash of a file's first bytes: it may be growing."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(min(_BLOCK_BYTES, size)):
            digest.update(block)
            size -= len(block)
    return digest.hexdigest()


FILE_BYTES: Final = 16_000_000  # bytes of columns at which a topic's rows become a file
HELD_BYTES: Final = 40_000_000  # bytes of all columns at which the largest topic's rows become a file
WAITING_MAX: Final = 1  # files that wait to be written
NAME_MAX: Final = 200  # longer directory names are cut, and end in a hash: most file systems allow 255 bytes
NO_VALUE: Final = "__HIVE_DEFAULT_PARTITION__"  # Hive's name
COMPRESSION: Final = "zstd"
COMPRESSION_LEVEL: Final = 1


class Parts:
    """Takes batches and writes them below a directory."""

    def __init__(self, root: Path, sha256: str) -> None:
        self._root = root
        self._sha256 = sha256
        self._held: dict[Columns, list[pa.RecordBatch]] = {}
        self._bytes: dict[Columns, int] = {}
        self._count = 0
        # Writing is half of the work, without the GIL: it runs beside the reading of the next batch.
        self._worker = ThreadPoolExecutor(1, "parquet")
        self._jobs: deque[Future[None]] = deque()
        self.closed: list[Part] = []
        self.schemas: dict[str, list[Column]] = {}

    def add(self, columns: Columns, rows: pa.RecordBatch) -> None:
        """Add rows of a topic."""
        self._held.setdefault(columns, []).append(rows)
        self._bytes[columns] = self._bytes.get(columns, 0) + rows.nbytes
        if self._bytes[columns] >= FILE_BYTES:
            self._flush(columns)
        while sum(self._bytes.values()) >= HELD_BYTES:
            self._flush(max(self._bytes, key=lambda one: self._bytes[one]))

    def close(self) -> None:
        """Write the remaining rows."""
        for columns in list(self._held):
            self._flush(columns)
        self._wait(0)
        self.closed.sort(key=lambda part: part.path)

    def abandon(self) -> None:
        """Drop unwritten rows."""
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
                use_dictionary=[
                    name for name, kind in kinds.items() if _types.is_dictionary(kind) or _types.is_string(kind)
                ],
                # Times and counts mostly rise in small steps.
                column_encoding={
                    name: "DELTA_BINARY_PACKED"
                    for name, kind in kinds.items()
                    if _types.is_integer(kind) or _types.is_timestamp(kind)
                },
            )
            self.closed.append(
                Part(
                    path=f"{directory}/{path.name}",
                    table=columns.table,
                    topic=columns.topic.name,
                    robot=columns.robot,
                    rows=rows.num_rows,
                    bytes=path.stat().st_size,
                    columns=key,
                )
            )


def _by_date(table: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """The rows of each day, by their log times."""
    days = table[LOG_TIME].cast(pa.date32(), safe=False)
    for day in sorted(pc.unique(days).to_pylist()):
        of_day = pc.equal(days, pa.scalar(day, pa.date32()))
        yield str(day), table if pc.all(of_day).as_py() else table.filter(of_day)


def _escaped(text: str) -> str:
    """A text as a part of a directory's name, with escapes as in a URL, so that readers can restore it."""
    name = quote(text, safe="@ ", errors="replace")
    if len(name) > NAME_MAX:
        digest = hashlib.sha256(text.encode(errors="replace")).hexdigest()[:16]
        name = f"{name[:NAME_MAX].rpartition('%')[0] or name[:NAME_MAX]}~{digest}"
    return name or NO_VALUE


class ExportRange(msgspec.Struct, frozen=True):
    """The part of the logs to export: topics by ``rows.wants_of``, and log times before ``to_ns``."""

    topics: list[str] = []
    from_ns: int = 0
    to_ns: int = END_OF_TIME_NS

    @property
    def selection(self) -> Selection:
        return Selection(wants_of(self.topics), self.from_ns, self.to_ns)


class ExportTask(msgspec.Struct, frozen=True):
    """A log to be exported."""

    log: LogFile
    sha256: str
    directory: Path
    wanted: ExportRange

    @property
    def bytes(self) -> int:
        return self.log.bytes


class ExportOutcome(msgspec.Struct, frozen=True):
    """The result of the export of one log."""

    input: Input
    parts: list[Part]
    schemas: dict[str, list[Column]]


def export_log(task: ExportTask, progress: Progress) -> ExportOutcome:
    faults = Faults()
    parts = Parts(task.directory, task.sha256)
    try:
        for batch in read_batches(task.log, task.wanted.selection, faults, progress):
            parts.add(batch.columns, batch.rows)
        parts.close()
    finally:
        parts.abandon()
    return ExportOutcome(
        input=Input(
            path=plain(task.log.name),
            bytes=task.log.bytes,
            sha256=task.sha256,
            rows=sum(part.rows for part in parts.closed),
            faults=list(map(plain, faults.told)),
            fault_count=faults.count,
        ),
        parts=parts.closed,
        schemas=parts.schemas,
    )


_types: Final = pa.types


def cells(rows: pa.RecordBatch) -> pa.RecordBatch:
    """The rows in types of CSV: numbers, flags, texts and times."""
    arrays = [_cells(column) for column in rows.columns]
    return pa.RecordBatch.from_arrays(arrays, names=rows.schema.names)


def objects(rows: pa.RecordBatch) -> Iterator[dict[str, Any]]:
    """The rows as JSON objects."""
    names = rows.schema.names
    for row in zip(*map(values, rows.columns), strict=True):
        yield dict(zip(names, row, strict=True))


def values(array: pa.Array) -> list[Any]:
    """The values as types of JSON."""
    kind = array.type
    if _types.is_dictionary(kind):
        return values(array.dictionary_decode())
    if _is_bytes(kind):
        return [None if one is None else b64encode(one).decode() for one in array.to_pylist()]
    if _types.is_map(kind):
        pairs = zip(values(array.keys), values(array.items), strict=True)
        return [None if one is None else dict(map(_entry, one)) for one in _cut(array, list(pairs))]
    if _types.is_list(kind) or _types.is_large_list(kind):
        return _cut(array, values(array.values))
    if _types.is_struct(kind):
        names = [kind.field(place).name for place in range(kind.num_fields)]
        columns = [values(column) for column in array.flatten()]
        rows = zip(*columns, strict=True) if columns else (() for _ in range(len(array)))
        found = [dict(zip(names, row, strict=True)) for row in rows]
        return [one if valid else None for one, valid in zip(found, array.is_valid().to_pylist(), strict=True)]
    if _types.is_boolean(kind) or _types.is_integer(kind) or _types.is_floating(kind) or _types.is_string(kind):
        return list(array.to_pylist())
    return _texts(array)


def _cells(array: pa.Array) -> pa.Array:
    kind = array.type
    if _types.is_dictionary(kind):
        return _cells(array.dictionary_decode())
    if _is_bytes(kind):
        return pa.array([None if one is None else one.hex() for one in array.to_pylist()], pa.string())
    if _types.is_nested(kind):
        texts = [None if one is None else msgspec.json.encode(one).decode() for one in values(array)]
        return pa.array(texts, pa.string())
    if _types.is_boolean(kind) or _types.is_integer(kind) or _types.is_floating(kind) or _types.is_string(kind):
        return array
    return pa.array(_texts(array), pa.string())


def _texts(array: pa.Array) -> list[str | None]:
    """Times and other types of SQL as texts."""
    try:
        texts = array.cast(pa.string()).to_pylist()
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        texts = [None if not one.is_valid else str(one) for one in array]
    if _types.is_timestamp(array.type):
        return [None if text is None else text.replace(" ", "T") for text in texts]
    return list(texts)


def _is_bytes(kind: pa.DataType) -> bool:
    return bool(_types.is_binary(kind) or _types.is_large_binary(kind) or _types.is_fixed_size_binary(kind))


def _cut(array: pa.Array, items: list[Any]) -> list[Any]:
    """The items of each list."""
    offsets = array.offsets.to_pylist()
    valid = array.is_valid().to_pylist()
    return [
        items[start:end] if is_there else None
        for start, end, is_there in zip(offsets[:-1], offsets[1:], valid, strict=True)
    ]


def _entry(pair: tuple[Any, Any]) -> tuple[str, Any]:
    key, value = pair
    return key if isinstance(key, str) else str(key), value


def csv_text(rows: pa.RecordBatch, *, with_header: bool) -> str:
    sink = pa.BufferOutputStream()
    csv.write_csv(cells(rows), sink, csv.WriteOptions(include_header=with_header))
    return bytes(sink.getvalue()).decode()


Runner = Callable[[Act[ExportTask, ExportOutcome], Sequence[ExportTask], Progress], Iterable[ExportOutcome]]
"""As ``tasks.TaskRunner``."""


class Exported(msgspec.Struct, frozen=True):
    """The result of an export."""

    directory: str
    inputs: list[Input]
    files: list[Part]

    @property
    def rows(self) -> int:
        return sum(part.rows for part in self.files)


def export_dataset(
    logs: Sequence[LogFile],
    directory: Path,
    wanted: ExportRange,
    faults: Faults,
    *,
    run: Runner = HERE,
    progress: Progress = lambda _: None,
) -> Exported:
    """Write logs into a dataset; CommandError if the directory is not empty, or cannot be written."""
    shown = plain(str(directory))
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if (directory / MANIFEST_NAME).exists():
            raise CommandError(f"{shown} is a dataset already, and not overwritten: export to another directory")
        if any(not path.name.startswith(".") for path in directory.iterdir()):
            raise CommandError(f"{shown} is not empty, and no dataset (it has no {MANIFEST_NAME})")
        inputs, files = _export(logs, directory, wanted, run, progress)
    except OSError as error:
        raise CommandError(f"cannot write {shown}: {error.strerror or error}") from error
    for one in inputs:
        for fault in one.faults:
            faults.add(fault)
        faults.count += one.fault_count - len(one.faults)
    return Exported(shown, inputs, files)


def _export(
    logs: Sequence[LogFile], directory: Path, wanted: ExportRange, run: Runner, progress: Progress
) -> tuple[list[Input], list[Part]]:
    with staging(directory) as hidden:
        # Use a log that is given twice once.
        by_hash = {sha256_of(log.path, log.bytes): log for log in reversed(logs)}
        tasks = [ExportTask(log, sha256, hidden, wanted) for sha256, log in reversed(by_hash.items())]
        outcomes = list(run(export_log, tasks, progress))
        inputs = [outcome.input for outcome in outcomes]
        files = [part for outcome in outcomes for part in outcome.parts]
        schemas = {key: columns for outcome in outcomes for key, columns in outcome.schemas.items()}
        for path in hidden.iterdir():
            path.rename(directory / path.name)
        product = f"cruiser-gateway {version('cruiser-gateway')}"
        manifest = Manifest(FORMAT, VERSION, product, inputs, files, schemas)
        # Last, and atomically.
        beside = hidden / MANIFEST_NAME
        beside.write_bytes(msgspec.json.format(msgspec.json.encode(manifest), indent=1) + b"\n")
        beside.replace(directory / MANIFEST_NAME)
    return inputs, files


class CsvFile(msgspec.Struct):
    """A file that was written."""

    path: str
    topic: str
    rows: int


def export_csv(
    logs: Sequence[LogFile],
    directory: Path,
    wanted: ExportRange,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> list[CsvFile]:
    """Write logs as CSV, one file for each topic and its columns; CommandError if a file cannot be written."""
    files: dict[tuple[str, str], CsvFile] = {}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with staging(directory) as hidden:
            for log in logs:
                for batch in read_batches(log, wanted.selection, faults, progress):
                    topic = batch.columns.topic.name
                    key = topic, described(batch.columns.schema)[0]
                    if key not in files:
                        taken = {one.path for one in files.values()}
                        files[key] = CsvFile(str(new_path(directory, file_name(topic), ".csv", taken)), topic, 0)
                    file = files[key]
                    with (hidden / Path(file.path).name).open("ab") as stream:
                        head = csv.WriteOptions(include_header=not file.rows)
                        csv.write_csv(cells(batch.rows), stream, head)
                    file.rows += batch.rows.num_rows
            for file in files.values():
                give_name(hidden / Path(file.path).name, Path(file.path))
    except OSError as error:
        raise CommandError(f"cannot write {plain(str(directory))}: {error.strerror or error}") from error
    return list(files.values())
