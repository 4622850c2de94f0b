"""Which files a question is about: files and directories, in the order of time."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import msgspec

from recorder.mcap_summary import MAGIC
from recorder.ports.log_directory import INCIDENT_SUFFIX, PART_SUFFIX, SUFFIX
from recorder.review.faults import Faults
from recorder.review.pieces import LooseMessage, PackedChunk, read_pieces
from recorder.review.summary import read_summary
from recorder.review.walk import LoggedMessage, messages
from schemas.exit_codes import CommandError
from schemas.printable import plain


class LogFile(msgspec.Struct, frozen=True):
    """A log.

    Attributes:
        bytes: its length when it was found.
        start_ns, end_ns: the first and the last log time; both 0 if it holds no message.
    """

    path: Path
    bytes: int
    start_ns: int
    end_ns: int

    @property
    def is_incident(self) -> bool:
        """It repeats what happened around an incident, and most of it is in a log too."""
        return self.path.name.removesuffix(PART_SUFFIX).removesuffix(SUFFIX).endswith(INCIDENT_SUFFIX)

    @property
    def series(self) -> Path:
        """The same for all files that a recorder wrote one after the other: the name up to the time."""
        return self.path.with_name(self.path.name.rpartition("-")[0])


def find_logs(paths: Sequence[Path], faults: Faults, *, with_covered: bool = False) -> list[LogFile]:
    """The logs at these paths, by their beginning.

    Args:
        paths: files, and directories whose logs are taken, whole or still being written. Of a directory an
            incident is left out whose time its other logs cover: all of it is in them.
        faults: takes what is wrong with single files of several.
        with_covered: leave no incident out.

    Raises:
        CommandError: there is nothing to read.
    """
    found: list[LogFile] = []
    failure: CommandError | None = None
    for path in dict.fromkeys(paths):
        for name in [path] if not path.is_dir() else sorted(_logs_of(path)):
            if any(log.path == name for log in found):
                continue
            try:
                found.append(look_at(name))
            except CommandError as error:
                failure = failure or error
                faults.add(str(error))
        if path.is_dir() and not with_covered:
            found = [log for log in found if log.path in paths or not _is_covered(log, found)]
    if not found:
        raise failure or CommandError(f"there is no log in {', '.join(plain(str(path)) for path in paths)}")
    return sorted(found, key=lambda log: (log.start_ns, log.path))


def look_at(path: Path) -> LogFile:
    """One log.

    Raises:
        CommandError: it cannot be opened, is empty, or is no MCAP file.
    """
    with open_log(path) as (stream, size):
        start_ns, end_ns = _span(stream, size)
    return LogFile(path, size, start_ns, end_ns)


@contextmanager
def open_log(path: Path) -> Generator[tuple[BinaryIO, int], None, None]:
    """The file, and its length in bytes.

    Raises:
        CommandError: it cannot be read, is empty, or is no MCAP file.
    """
    shown = plain(str(path))
    try:
        with path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if size == 0:
                raise CommandError(f"{shown} is empty")
            if stream.read(len(MAGIC)) != MAGIC:
                raise CommandError(f"{shown} is no MCAP file")
            yield stream, size
    except OSError as error:
        raise CommandError(f"cannot read {shown}: {error.strerror or error}") from error


def _span(stream: BinaryIO, size: int) -> tuple[int, int]:
    """First and last log time, by the summary if there is one, else by the heads of the chunks."""
    summary = read_summary(stream)
    statistics = None if summary is None else summary.statistics
    if statistics is not None:
        return (statistics.message_start_time, statistics.message_end_time) if statistics.message_count else (0, 0)
    start_ns, end_ns = -1, 0
    for piece in read_pieces(stream, size, is_verifying=False):
        if isinstance(piece, PackedChunk):
            times = [piece.start_ns, piece.end_ns]
        elif isinstance(piece, LooseMessage):
            found = messages(piece.offset, piece.raw)
            times = [one.log_ns for one in found if isinstance(one, LoggedMessage)]
        else:
            continue
        start_ns = min([*times, *([start_ns] if start_ns >= 0 else [])], default=start_ns)
        end_ns = max([*times, end_ns])
    return max(start_ns, 0), end_ns


def _logs_of(directory: Path) -> Iterator[Path]:
    for suffix in (SUFFIX, PART_SUFFIX):
        yield from directory.glob(f"*{suffix}")


def _is_covered(incident: LogFile, logs: Sequence[LogFile]) -> bool:
    """Whether logs of the same directory reach from its beginning to its end without a break between them."""
    if not incident.is_incident:
        return False
    reached_ns = incident.start_ns
    for log in sorted(logs, key=lambda one: one.start_ns):
        if log.series == incident.series and not log.is_incident and log.start_ns <= reached_ns:
            reached_ns = max(reached_ns, log.end_ns)
    return reached_ns >= incident.end_ns
