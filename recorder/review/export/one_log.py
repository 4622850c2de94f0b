"""One log into a dataset: a function of its own, so that it may run anywhere."""

from __future__ import annotations

from pathlib import Path

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import END_OF_TIME_NS, Progress, Selection
from recorder.reading.topic_names import wants_of
from recorder.review.columns.reader import read_batches
from recorder.review.export.manifest import Column, Input, Part
from recorder.review.export.parts import Parts
from schemas.command_line import plain


class ExportRange(msgspec.Struct, frozen=True):
    """The part of the logs to export.

    Attributes:
        topics: patterns of topics; none is all. See ``topic_names.wants_of``.
        from_ns: the first log time...
        to_ns: ...and the first one that is too late, or -1.
    """

    topics: list[str] = []
    from_ns: int = 0
    to_ns: int = -1

    @property
    def selection(self) -> Selection:
        """The same for a reader."""
        return Selection(wants_of(self.topics), self.from_ns, END_OF_TIME_NS if self.to_ns < 0 else self.to_ns)


class ExportTask(msgspec.Struct, frozen=True):
    """A log to be exported.

    Attributes:
        log: the log.
        sha256: of it.
        directory: the place of the parts.
        wanted: the part of it.
    """

    log: LogFile
    sha256: str
    directory: Path
    wanted: ExportRange

    @property
    def bytes(self) -> int:
        """The length of the log."""
        return self.log.bytes


class ExportOutcome(msgspec.Struct, frozen=True):
    """The result of the export of one log."""

    input: Input
    parts: list[Part]
    schemas: dict[str, list[Column]]


def export_log(task: ExportTask, progress: Progress) -> ExportOutcome:
    """Write the parts of a log.

    Raises:
        OSError: the disk does not take them.
    """
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
