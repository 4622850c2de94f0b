"""One CSV file a topic. Nested values are JSON; see ``cells``."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final

import msgspec
import pyarrow as pa
from pyarrow import csv

from recorder.disk.new_file import give_name
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress
from recorder.reading.topic_names import file_name
from recorder.review.columns.reader import read_batches
from recorder.review.columns.tables import Columns
from recorder.review.export.cells import cells
from recorder.review.export.manifest import described
from recorder.review.export.one_log import ExportRange
from schemas.command_line import CommandError, plain

SUFFIX: Final = ".csv"
OPEN_MAX: Final = 64


class CsvFile(msgspec.Struct, frozen=True):
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
    """Write logs as CSV.

    Raises:
        CommandError: one of the files is there already, or the disk does not take it.
    """
    files = _Files(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for log in logs:
            for batch in read_batches(log, wanted.selection, faults, progress):
                files.add(batch.columns, batch.rows)
        files.close()
    except OSError as error:
        files.discard()
        raise CommandError(f"cannot write {plain(str(directory))}: {error.strerror or error}") from error
    except BaseException:
        files.discard()
        raise
    return files.written


class _File:
    """Until it is whole it is called ``.part`` behind its name."""

    def __init__(self, path: Path, topic: str) -> None:
        self.path = path
        self.part = path.with_name(f"{path.name}.part")
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
        """The files written so far."""
        return [CsvFile(str(one.path), one.topic, one.rows) for one in self._files.values()]

    def add(self, columns: Columns, rows: pa.RecordBatch) -> None:
        """Rows of a topic."""
        key = columns.topic.name, described(columns.schema)[0]
        file = self._files.get(key)
        if file is None:
            file = _File(self._new_path(columns.topic.name), columns.topic.name)
            # What is somebody else's is not ours to discard.
            file.part.touch(exist_ok=False)
            self._files[key] = file
        if file.stream is None:
            self._make_room()
            file.stream = file.part.open("ab")
        options = csv.WriteOptions(include_header=file.rows == 0)
        csv.write_csv(cells(rows), file.stream, options)
        file.rows += rows.num_rows

    def close(self) -> None:
        """End all files: they are whole.

        Raises:
            OSError: the disk does not take one.
        """
        for file in self._files.values():
            if file.stream is not None:
                file.stream.close()
            give_name(file.part, file.path)

    def discard(self) -> None:
        """Leave nothing of what is not whole."""
        for file in self._files.values():
            with suppress(OSError):
                if file.stream is not None:
                    file.stream.close()
            with suppress(OSError):
                file.part.unlink(missing_ok=True)

    def _new_path(self, topic: str) -> Path:
        """A name that none of ours has; one that was there before is not overwritten."""
        taken = {file.path for file in self._files.values()}
        path, number = self._directory / (file_name(topic) + SUFFIX), 1
        while path in taken:
            number += 1
            path = self._directory / f"{file_name(topic)}~{number}{SUFFIX}"
        for there in (path, path.with_name(f"{path.name}.part")):
            if there.exists():
                raise CommandError(f"{plain(str(there))} is there already; nothing is overwritten")
        return path

    def _make_room(self) -> None:
        opened = [file for file in self._files.values() if file.stream is not None]
        if len(opened) >= OPEN_MAX and opened[0].stream is not None:
            opened[0].stream.close()
            opened[0].stream = None
