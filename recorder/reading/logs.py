"""Log files in the order of time, what they cover, and their faults."""

from __future__ import annotations

import fcntl
import os
import stat
from collections import Counter
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

import msgspec
from mcap import records

from recorder.disk.log_names import INCIDENT_SUFFIX, PART_SUFFIX, SUFFIX, is_log
from recorder.mcap.reader import (
    DamagedError,
    Fault,
    Index,
    LoggedMessage,
    MessageBlock,
    PackedChunk,
    is_mcap,
    read_pieces,
)
from recorder.mcap.summary_reader import read_summary
from recorder.reading.topics import Declared
from schemas import keys
from schemas.command_line import CommandError, plain

FAULTS_SHOWN: Final = 20  # more are only counted


KNOWN_MAX: Final = 10_000  # a question may read a log more than once


class Faults:
    """Gathers faults, each once.

    Attributes:
        told: the first ones.
        count: the number of all.
    """

    def __init__(self) -> None:
        self.told: list[str] = []
        self.count = 0
        self._known: dict[str, None] = {}

    def add(self, detail: str) -> None:
        if detail in self._known:
            return
        if len(self._known) < KNOWN_MAX:
            self._known[detail] = None
        self.count += 1
        if len(self.told) < FAULTS_SHOWN:
            self.told.append(detail)

    def add_all(self, others: Faults) -> None:
        for detail in others._known:
            self.add(detail)

    def __bool__(self) -> bool:
        return self.count > 0


class LogFile(msgspec.Struct, frozen=True):
    """A log.

    Attributes:
        path: of the file.
        bytes: its size when it was found.
        start_ns, end_ns: the first and the last log time; both 0 without a message.
        robots: root and name of each robot, as far as known outside of chunks.
        is_being_written: a recorder had it open when it was found.
        namesakes: names that robots of several roots share, in the logs that were found together.
        url: the address in an object store that the file is a copy of; empty for none.
    """

    path: Path
    bytes: int
    start_ns: int
    end_ns: int
    robots: frozenset[tuple[str, str]] = frozenset()
    namesakes: frozenset[str] = frozenset()
    is_being_written: bool = False
    url: str = ""

    @property
    def name(self) -> str:
        return self.url or str(self.path)

    def open(self) -> BinaryIO:
        return self.path.open("rb")

    @property
    def is_incident(self) -> bool:
        """True for a file with the minutes around an incident, which repeats a part of a log."""
        return self.path.name.removesuffix(PART_SUFFIX).removesuffix(SUFFIX).endswith(INCIDENT_SUFFIX)


def logs_of(robot: str, logs: Sequence[LogFile]) -> list[LogFile]:
    """The logs of a robot, named with or without its root; all logs with messages if none names it."""
    filled = [log for log in logs if log.end_ns]
    its = [log for log in filled if any(robot in {name, f"{root}/{name}"} for root, name in log.robots)]
    # An unfinished file may not name its robots.
    return [log for log in filled if log in its or not log.robots] or filled


def without_covered(logs: Sequence[LogFile]) -> list[LogFile]:
    """The logs of a directory without the incidents whose messages are all in its other logs.

    Messages are compared by topic and log time, in chunks with valid checksums.
    """
    others = [log for log in logs if not log.is_incident]
    return [log for log in logs if log in others or not log.end_ns or not _is_covered(log, others)]


def _is_covered(incident: LogFile, others: Sequence[LogFile]) -> bool:
    held: Counter[tuple[str, int]] = Counter()
    for log in others:
        if log.start_ns <= incident.end_ns and incident.start_ns <= log.end_ns:
            held |= _messages(log, incident)
    own = _messages(incident, incident)
    return bool(own) and own <= held


def _messages(log: LogFile, during: LogFile) -> Counter[tuple[str, int]]:
    """Count a log's readable messages in the time of another one, by topic and log time."""
    found: Counter[tuple[int, int]] = Counter()
    declared = Declared()
    with suppress(OSError), log.open() as stream:
        declared.take_summary(read_summary(stream))
        for piece in read_pieces(stream, log.bytes, is_verifying=False):
            if isinstance(piece, records.Schema | records.Channel):
                declared.take(piece)
            elif isinstance(piece, MessageBlock) or (
                isinstance(piece, PackedChunk)
                and piece.start_ns <= during.end_ns
                and during.start_ns <= piece.end_ns
            ):
                for channel_id, entries in _index(piece, declared).items():
                    times = (one for one in entries[::2] if during.start_ns <= one <= during.end_ns)
                    found.update((channel_id, time_ns) for time_ns in times)
    topics = {channel_id: topic.name for channel_id, topic in declared.topics.items()}
    by_topic: Counter[tuple[str, int]] = Counter()
    for (channel_id, time_ns), count in found.items():
        if channel_id in topics:
            by_topic[topics[channel_id], time_ns] += count
    return by_topic


def _index(piece: PackedChunk | MessageBlock, declared: Declared) -> Index:
    """The places of a piece's messages; empty for a damaged chunk."""
    if isinstance(piece, PackedChunk) and piece.index is not None and piece.index.keys() <= declared.topics.keys():
        with suppress(DamagedError):
            piece.unpack()
            return piece.index
        return {}
    index, others = piece.read_index()
    for one in others:
        if not isinstance(one, Fault):
            declared.take(one)
    return index


def find_logs(
    paths: Sequence[Path],
    faults: Faults,
    *,
    with_covered: bool = False,
    stored: Sequence[LogFile] = (),
) -> list[LogFile]:
    """The logs at these paths (files, or directories of logs), by their start.

    ``with_covered``: with incidents of a directory that its other logs cover. ``stored``: copies of logs of object
    stores. Raises CommandError if there is no log.
    """
    found: dict[Path, LogFile] = {}
    failure: CommandError | None = None
    for path in dict.fromkeys(paths):
        for name in [path] if not path.is_dir() else _logs_of(path):
            if name in found:
                continue
            try:
                found[name] = look_at(name)
            except CommandError as error:
                failure = failure or error
                faults.add(str(error))
        if path.is_dir() and not with_covered:
            named = {log.path: log for log in found.values() if log.path in paths}
            found = named | {log.path: log for log in without_covered(list(found.values()))}
    if not found and not stored:
        raise failure or CommandError(f"there is no log in {', '.join(plain(str(path)) for path in paths)}")
    return sorted(_with_namesakes([*found.values(), *stored]), key=lambda log: (log.start_ns, log.name))


def _with_namesakes(logs: list[LogFile]) -> list[LogFile]:
    roots = Counter(name for _, name in {robot for log in logs for robot in log.robots})
    namesakes = frozenset(name for name, count in roots.items() if count > 1)
    return [msgspec.structs.replace(log, namesakes=namesakes) for log in logs] if namesakes else logs


def look_at(path: Path) -> LogFile:
    with open_log(path) as (stream, size):
        is_written = is_being_written(stream)
        start_ns, end_ns, channels = _span(stream, size)
    return LogFile(path, size, start_ns, end_ns, _robots(channels), is_being_written=is_written)


def _robots(channels: Sequence[records.Channel]) -> frozenset[tuple[str, str]]:
    parts = [keys.parse(channel.topic) for channel in channels]
    return frozenset((one.root, one.robot) for one in parts if one is not None and one.robot)


@contextmanager
def open_log(path: Path) -> Generator[tuple[BinaryIO, int], None, None]:
    shown = plain(str(path))
    try:
        # Before it is opened: opening a FIFO would wait for a writer.
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
    """True if a recorder holds its lock on the file; False if the file system has no locks."""
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        fcntl.flock(stream.fileno(), fcntl.LOCK_UN)
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


def _span(stream: BinaryIO, size: int) -> tuple[int, int, list[records.Channel]]:
    """First and last log time, and the channels, by the summary or by the records outside of chunks."""
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
