"""One CSV file a topic. Nested values are JSON; see ``cells``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Final
from urllib.parse import quote

import msgspec
import pyarrow as pa
from pyarrow import csv

from recorder.review.columns.reader import read_batches
from recorder.review.columns.tables import Columns
from recorder.review.export.cells import cells
from recorder.review.export.known_rows import KnownRows, overlapping
from recorder.review.export.manifest import described
from recorder.review.export.one_log import Wanted
from recorder.review.faults import Faults
from recorder.review.logs import LogFile
from recorder.review.rows import Progress
from schemas.exit_codes import CommandError
from schemas.printable import plain

SUFFIX: Final = ".csv"
OPEN_MAX: Final = 64


class CsvFile(msgspec.Struct, frozen=True):
    """A file that was written."""

    path: str
    topic: str
    rows: int


def file_name(topic: str) -> str:
    """``fleet/cruiser-1/state`` is ``fleet.cruiser-1.state``; what a name may not hold is escaped as in a URL."""
    chunks = [quote(chunk, safe="@ ", errors="replace").replace(".", "%2E") for chunk in topic.split("/")]
    name = ".".join(chunks)
    # ROS's topics begin with a slash, and a name that begins with a dot is a hidden file's.
    return (f"%2F{name[1:]}" if name.startswith(".") else name)[:200] or "%"


def export_csv(
    logs: Sequence[LogFile],
    directory: Path,
    wanted: Wanted,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> list[CsvFile]:
    """Write logs as CSV.

    Raises:
        CommandError: one of the files is there already, or the disk does not take it.
    """
    files = _Files(directory)
    selection = wanted.selection
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for place, log in enumerate(logs):
            known = KnownRows(log, overlapping(log, logs[:place]), selection)
            for batch in read_batches(log, selection, faults, progress, known.sift):
                files.add(batch.columns, batch.rows)
    except OSError as error:
        raise CommandError(f"cannot write {plain(str(directory))}: {error.strerror or error}") from error
    finally:
        files.close()
    return files.written


class _File:
    def __init__(self, path: Path, topic: str) -> None:
        self.path = path
        self.topic = topic
        self.rows = 0
        self.stream: BinaryIO | None = None


class _Files:
    """By topic and columns; the last ones are open."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._files: dict[tuple[str, str], _File] = {}

    @property
    def written(self) -> list[CsvFile]:
        """What was written so far."""
        return [CsvFile(str(one.path), one.topic, one.rows) for one in self._files.values()]

    def add(self, columns: Columns, rows: pa.RecordBatch) -> None:
        """Rows of a topic."""
        key = columns.topic.name, described(columns.schema)[0]
        file = self._files.get(key)
        if file is None:
            file = self._files[key] = _File(self._new_path(columns.topic.name), columns.topic.name)
            file.path.touch(exist_ok=False)
        if file.stream is None:
            self._make_room()
            file.stream = file.path.open("ab")
        options = csv.WriteOptions(include_header=file.rows == 0)
        csv.write_csv(cells(rows), file.stream, options)
        file.rows += rows.num_rows

    def close(self) -> None:
        """End all files."""
        for file in self._files.values():
            if file.stream is not None:
                file.stream.close()

    def _new_path(self, topic: str) -> Path:
        """A name that none of ours has; one that was there before is not overwritten."""
        taken = {file.path for file in self._files.values()}
        path, number = self._directory / (file_name(topic) + SUFFIX), 1
        while path in taken:
            number += 1
            path = self._directory / f"{file_name(topic)}~{number}{SUFFIX}"
        if path.exists():
            raise CommandError(f"{plain(str(path))} is there already; nothing is overwritten")
        return path

    def _make_room(self) -> None:
        opened = [file for file in self._files.values() if file.stream is not None]
        if len(opened) >= OPEN_MAX and opened[0].stream is not None:
            opened[0].stream.close()
            opened[0].stream = None
