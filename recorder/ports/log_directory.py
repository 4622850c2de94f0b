"""The directory of logs: opens files, has them reach the disk, and renames them when they are whole.

A file is ``NAME-START.mcap.part`` while it is written and ``NAME-START.mcap`` when it is whole. Nothing is ever
overwritten. A part is locked as long as its writer lives. An OSError becomes one clear CommandError here.
"""

from __future__ import annotations

import fcntl
import os
import re
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from typing import Final, assert_never

from recorder.effects import (
    CloseLog,
    DeclareChannel,
    FileEffect,
    SyncLog,
    WriteAttachment,
    WriteChunk,
    WriteMetadata,
)
from recorder.mcap_file import McapFile
from schemas.exit_codes import CommandError
from schemas.printable import plain

SUFFIX: Final = ".mcap"
PART_SUFFIX: Final = ".mcap.part"
INCIDENT_SUFFIX: Final = ".incident"
"""Stands before ``.mcap`` in the name of an incident: such a file is never deleted for want of room."""

SYNCS_MAX: Final = 2

SYNC_THREADS: Final = 4
"""Files that the disk is told to keep at once: a file system takes several in about the time of one."""

STEM_MAX: Final = 150
"""Characters of a log's name before the time: who makes up a robot may call it longer than a disk takes."""

NAMESAKES_MAX: Final = 1000
"""Files of one name and second at most: recorders that were started at once."""


@contextmanager
def _clear_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CommandError(f"cannot write {plain(str(path))}: {error.strerror or error}") from error


class LogFile:
    """A log that is being written.

    Args:
        part: the path while it is written.
        path: the path when it is whole.
        stream: the open file, unbuffered.
        library: who writes.
        disk: runs the syncs.
    """

    def __init__(self, part: Path, path: Path, stream: FileIO, library: str, disk: Executor) -> None:
        self._stream = stream
        self._part = part
        self._whole_path = path
        self.path = part
        self._disk = disk
        # One that goes on and one that waits for it: the later covers what was written meanwhile.
        self._syncs: deque[tuple[int, Future[None]]] = deque()
        self.has_synced = False
        """Whether the disk has taken anything of this file."""
        self.kept_size = 0
        """Bytes that the disk has said it keeps."""
        self.is_doubtful = False
        """The disk has failed to keep what it had taken: what is beyond ``kept_size`` may be anything."""
        with _clear_errors(part):
            self._mcap = McapFile(stream, library)

    @property
    def size(self) -> int:
        """Bytes of whole records so far."""
        return self._mcap.size

    @property
    def name(self) -> str:
        """Its name when it is whole, without the directory."""
        return self._whole_path.name

    @property
    def is_kept(self) -> bool:
        """Whether there is a file, which ``salvage`` may have found not worth keeping."""
        with suppress(OSError):  # A disk that is gone may not even say that it has no such file.
            return self.path.exists()
        return False

    def write(self, effect: FileEffect) -> None:
        """Carry an effect out. A sync goes on beside what is written next; its failure is that one's.

        Raises:
            CommandError: the disk does not take it.
        """
        with _clear_errors(self.path):
            self._look_at_syncs()
            match effect:
                case WriteChunk():
                    self._mcap.write_chunk(effect.chunk)
                case SyncLog():
                    if len(self._syncs) < SYNCS_MAX:
                        self._syncs.append((self._mcap.size, self._disk.submit(self._sync)))
                case DeclareChannel():
                    self._mcap.add_channel(effect.channel)
                case WriteMetadata():
                    self._mcap.add_metadata(effect.name, effect.entries)
                case WriteAttachment():
                    self._mcap.add_attachment(effect.name, effect.media_type, effect.data, effect.wall_ns)
                case CloseLog():
                    self._finish()
                case _:
                    assert_never(effect)

    def salvage(self) -> None:
        """After a failure: leave all that was written, and a whole file if there is room for its end.

        A file without a message only repeats what another says, and is not left. Where the disk has failed to keep
        what it had taken, the file is cut back to what it keeps: a part, which the next start makes whole.
        """
        if self._stream.closed:
            return
        with suppress(OSError):
            self._wait_for_syncs()
        with suppress(OSError):
            if not self.is_doubtful:
                self._mcap.cut_back()
                if not self._mcap.messages:
                    self._part.unlink()
                else:
                    self._salvage()
        with suppress(OSError):
            if self.is_doubtful and not self._stream.closed:
                self._cut_to_kept()
        with suppress(OSError):
            self._stream.close()

    def _salvage(self) -> None:
        try:
            self._finish()
        except OSError:
            if not self._stream.closed and not self.is_doubtful:
                self._mcap.cut_back()
                self._sync_all()

    def _cut_to_kept(self) -> None:
        if self.kept_size:
            os.ftruncate(self._stream.fileno(), self.kept_size)
        else:
            self._part.unlink()

    def _sync_all(self) -> None:
        try:
            os.fsync(self._stream.fileno())
        except OSError:
            self.is_doubtful = True
            raise

    def _sync(self) -> None:
        os.fdatasync(self._stream.fileno())
        if os.fstat(self._stream.fileno()).st_nlink == 0:
            raise FileNotFoundError(0, "somebody has removed the log while it was written")

    def _look_at_syncs(self) -> None:
        while self._syncs and self._syncs[0][1].done():
            size, sync = self._syncs.popleft()
            if sync.exception() is not None:
                # The system tells of it once, and forgets what it could not write.
                self.is_doubtful = True
            if not self.is_doubtful:
                self.has_synced = True
                self.kept_size = size
            sync.result()

    def _wait_for_syncs(self) -> None:
        wait([sync for _, sync in self._syncs])
        self._look_at_syncs()

    def _finish(self) -> None:
        self._wait_for_syncs()
        self._mcap.finish()
        self._sync_all()
        # Renamed while it is locked: an unlocked part is one that somebody may recover.
        self._part.rename(self._whole_path)
        self.path = self._whole_path
        self._stream.close()
        sync_directory(self.path.parent)


class LogDirectory:
    """Where the logs go. It is made if it does not exist.

    Raises:
        CommandError: it cannot be made or written to.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._disk = ThreadPoolExecutor(SYNC_THREADS, "log sync")
        with _clear_errors(path):
            path.mkdir(parents=True, exist_ok=True)
            self._device = path.stat().st_dev
            if not os.access(path, os.W_OK | os.X_OK):
                raise PermissionError(0, "no permission to write there")

    def open(self, name: str, wall_ns: int, library: str, *, is_incident: bool = False) -> LogFile:
        """Begin a file whose name holds ``name`` and the time.

        A directory that somebody has removed is made again, but not where its disk was unmounted.

        Raises:
            CommandError: the file cannot be made.
        """
        start = datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
        stem = f"{safe_name(name)}-{start}{INCIDENT_SUFFIX if is_incident else ''}"
        with _clear_errors(self._path):
            self._make_again()
            part, path, stream = self._create(stem)
            try:
                sync_directory(self._path)
                return LogFile(part, path, stream, library, self._disk)
            except (CommandError, OSError):
                # Not even the header fits: there is nothing to keep.
                with suppress(OSError):
                    stream.close()
                with suppress(OSError):
                    part.unlink()
                raise

    def close(self) -> None:
        """Wait for the disk."""
        self._disk.shutdown()

    def _make_again(self) -> None:
        if self._path.exists() and self._path.stat().st_dev != self._device:
            raise FileNotFoundError(0, "its disk is not there any more")
        parent = self._path.absolute().parent
        if not self._path.exists() and parent.exists() and parent.stat().st_dev == self._device:
            self._path.mkdir()

    def _create(self, stem: str) -> tuple[Path, Path, FileIO]:
        for number in range(1, NAMESAKES_MAX + 1):
            unique = stem if number == 1 else f"{stem}-{number}"
            part, path = self._path / f"{unique}{PART_SUFFIX}", self._path / f"{unique}{SUFFIX}"
            try:
                stream = FileIO(part, "xb")
            except FileExistsError:
                continue
            # Another start may take a part without a lock for a leftover; then it is that one's.
            if not _lock_own(stream.fileno()):
                stream.close()
                continue
            if not path.exists():
                return part, path, stream
            # Its writer has renamed it; the name of the part was free again, that of the whole is not.
            part.unlink()
            stream.close()
        raise FileExistsError(0, f"too many files of the name {stem}")


def safe_name(text: str) -> str:
    """The text as part of a file's name on any system."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", text).lstrip(".")[:STEM_MAX] or "log"


def free_path(directory: Path, stem: str, suffix: str, but_for: Path | None = None) -> Path:
    """A path of which no file exists, nor a part that may become one; ``but_for`` is one's own part."""
    for number in range(1, NAMESAKES_MAX + 1):
        unique = stem if number == 1 else f"{stem}-{number}"
        path, part = directory / f"{unique}{suffix}", directory / f"{unique}{PART_SUFFIX}"
        if not path.exists() and (part == but_for or not part.exists()):
            return path
    raise FileExistsError(0, f"too many files of the name {stem}")


def lock(descriptor: int) -> bool:
    """Lock a file for this process, until it is closed. False if another one holds it.

    Raises:
        OSError: this file system has no locks.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _lock_own(descriptor: int) -> bool:
    try:
        return lock(descriptor)
    except OSError:
        return True  # Without locks here nothing is recovered here either.


def sync_directory(path: Path) -> None:
    """Have the names in a directory reach the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
