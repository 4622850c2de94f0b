"""Selection of the logs for a question: files and directories, in the order of time."""

from __future__ import annotations

import fcntl
import os
import stat
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO, Protocol

import msgspec
from mcap import records

from recorder.disk.log_names import is_log
from recorder.mcap.reader import LoggedMessage, MessageBlock, PackedChunk, is_mcap, read_pieces
from recorder.mcap.summary_reader import read_summary
from recorder.reading.covered import without_covered
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from schemas import keys
from schemas.command_line import CommandError, plain


class KnownLog(Protocol):
    """A log that need not be opened."""

    @property
    def log(self) -> LogFile:
        """The same as ``look_at`` gives."""

    @property
    def is_covered(self) -> bool | None:
        """It is an incident, and its directory's other logs hold every message of it; None if not known."""


def find_logs(
    paths: Sequence[Path],
    faults: Faults,
    *,
    with_covered: bool = False,
    known: Mapping[Path, KnownLog] = MappingProxyType({}),
    stored: Sequence[LogFile] = (),
) -> list[LogFile]:
    """The logs at these paths, by their beginning.

    Args:
        paths: files, and directories whose logs are taken, whole or still being written. Of a directory an
            incident is left out if its other logs hold every message of it, and can be read.
        faults: takes what is wrong with single files of several.
        with_covered: leave no incident out.
        known: logs of these directories that need not be opened.
        stored: copies of logs of object stores that are asked about with them.

    Raises:
        CommandError: there is nothing to read.
    """
    found: dict[Path, LogFile] = {}
    failure: CommandError | None = None
    for path in dict.fromkeys(paths):
        for name in [path] if not path.is_dir() else _logs_of(path):
            if name in found:
                continue
            if name in known:
                found[name] = known[name].log
                continue
            try:
                found[name] = look_at(name)
            except CommandError as error:
                failure = failure or error
                faults.add(str(error))
        if path.is_dir() and not with_covered:
            named = {log.path: log for log in found.values() if log.path in paths}
            found = named | {log.path: log for log in _uncovered(list(found.values()), known)}
    if not found and not stored:
        raise failure or CommandError(f"there is no log in {', '.join(plain(str(path)) for path in paths)}")
    return sorted(_with_namesakes([*found.values(), *stored]), key=lambda log: (log.start_ns, log.name))


def _uncovered(logs: list[LogFile], known: Mapping[Path, KnownLog]) -> list[LogFile]:
    """The logs without the incidents that others hold; what has to be compared is opened."""
    covered = {log.path: known[log.path].is_covered if log.path in known else None for log in logs}
    # What a directory's logs hold, more of them hold too.
    left = [log for log in logs if not covered[log.path]]
    is_settled = None not in covered.values() and len({log.path.parent for log in logs}) == 1
    return left if is_settled else without_covered(left)


def _with_namesakes(logs: list[LogFile]) -> list[LogFile]:
    """The logs, with the names that robots under several roots have in them."""
    roots = Counter(name for _, name in {robot for log in logs for robot in log.robots})
    namesakes = frozenset(name for name, count in roots.items() if count > 1)
    return [msgspec.structs.replace(log, namesakes=namesakes) for log in logs] if namesakes else logs


def look_at(path: Path) -> LogFile:
    """One log.

    Raises:
        CommandError: it cannot be opened, is empty, or is no MCAP file.
    """
    with open_log(path) as (stream, size):
        is_written = is_being_written(stream)
        start_ns, end_ns, channels = _span(stream, size)
    return LogFile(path, size, start_ns, end_ns, _robots(channels), is_being_written=is_written)


def _robots(channels: Sequence[records.Channel]) -> frozenset[tuple[str, str]]:
    parts = [keys.parse(channel.topic) for channel in channels]
    return frozenset((one.root, one.robot) for one in parts if one is not None and one.robot)


@contextmanager
def open_log(path: Path) -> Generator[tuple[BinaryIO, int], None, None]:
    """The file, and its length in bytes.

    Raises:
        CommandError: it cannot be read, is no file (a FIFO, a device), is empty, or is no MCAP file.
    """
    shown = plain(str(path))
    try:
        # Before it is opened: opening a FIFO waits for somebody who writes to it.
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
            raise CommandError(f"{shown} is no regular file")
        with path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if size == 0:
                raise CommandError(f"{shown} is empty")
            if not is_mcap(stream):
                raise CommandError(f"{shown} is no MCAP file")
            yield stream, size
    except OSError as error:
        raise CommandError(f"cannot read {shown}: {error.strerror or error}") from error


def is_being_written(stream: BinaryIO) -> bool:
    """Return True if a recorder holds its lock on the file. False where the file system has no locks."""
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        fcntl.flock(stream.fileno(), fcntl.LOCK_UN)
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


def _span(stream: BinaryIO, size: int) -> tuple[int, int, list[records.Channel]]:
    """First and last log time, and channels: by the summary if there is one, else by what is outside of chunks."""
    summary = read_summary(stream)
    if summary is not None and summary.statistics is not None:
        counts = summary.statistics
        times = (counts.message_start_time, counts.message_end_time) if counts.message_count else (0, 0)
        return *times, list(summary.channels.values())
    start_ns, end_ns = -1, 0
    channels = []
    for piece in read_pieces(stream, size, is_verifying=False):
        if isinstance(piece, PackedChunk):
            found_ns = [piece.start_ns, piece.end_ns]
        elif isinstance(piece, MessageBlock):
            found_ns = [one.log_ns for one in piece.messages() if isinstance(one, LoggedMessage)]
        else:
            channels += [piece] if isinstance(piece, records.Channel) else []
            continue
        start_ns = min([*found_ns, *([start_ns] if start_ns >= 0 else [])], default=start_ns)
        end_ns = max([*found_ns, end_ns])
    return max(start_ns, 0), end_ns, channels


def _logs_of(directory: Path) -> list[Path]:
    try:
        return sorted(one for one in directory.iterdir() if is_log(one.name))
    except OSError as error:
        raise CommandError(f"cannot read {plain(str(directory))}: {error.strerror or error}") from error
