"""One log that is being written: as a part, synced beside the writing, and renamed when it is whole.

Nobody waits for a sync but who ends the file. An OSError becomes one clear CommandError here.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, wait
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import assert_never

from recorder.mcap.writer import McapFile
from recorder.record.effects import (
    CloseLog,
    DeclareChannel,
    FileEffect,
    SyncLog,
    WriteAttachment,
    WriteChunk,
    WriteMetadata,
)
from schemas.exit_codes import CommandError
from schemas.printable import plain


@contextmanager
def clear_errors(path: Path) -> Iterator[None]:
    """Whatever the system says against it is one CommandError."""
    try:
        yield
    except OSError as error:
        raise CommandError(f"cannot write {plain(str(path))}: {error.strerror or error}") from error


def sync_directory(path: Path) -> None:
    """Have the names in a directory reach the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _nothing() -> None:
    """Nobody waits for the disk."""


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
        self._changed = threading.Lock()
        self._sync: Future[None] | None = None
        """The sync that goes on, or waits for a thread; of one file there is but one."""
        self._wants_sync = False
        """Something was written that the present sync may not cover: another is to follow it."""
        self._fault: OSError | None = None
        """What a sync has failed with, until the next write tells."""
        self.when_synced: Callable[[], None] = _nothing
        """Called on another thread after each sync, whatever became of it."""
        self.has_synced = False
        """Whether the disk has taken anything of this file."""
        self.kept_size = 0
        """Bytes that the disk has said it keeps."""
        self.is_doubtful = False
        """The disk has failed to keep what it had taken: what is beyond ``kept_size`` may be anything."""
        self.is_left = False
        """It could not be made whole, and holds messages."""
        with clear_errors(part):
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

    @property
    def has_failed(self) -> bool:
        """A sync has failed, which the next write tells."""
        return self._fault is not None

    def begin(self, effects: Iterable[FileEffect]) -> None:
        """Carry out what the file begins with; its channels, of which there may be thousands, in one write.

        Raises:
            CommandError: the disk does not take it.
        """
        channels = []
        for effect in effects:
            if isinstance(effect, DeclareChannel):
                channels.append(effect.channel)
            else:
                self.write(effect)
        with clear_errors(self.path):
            self._mcap.add_channels(channels)

    def write(self, effect: FileEffect) -> None:
        """Carry an effect out. A sync goes on beside what is written next; its failure is that one's.

        Raises:
            CommandError: the disk does not take it.
        """
        with clear_errors(self.path):
            self._raise_fault()
            match effect:
                case WriteChunk():
                    self._mcap.write_chunk(effect.chunk)
                case SyncLog():
                    self.sync()
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

    def sync(self) -> None:
        """Have the disk keep all that is written so far. Does not wait for it."""
        with self._changed:
            if self._sync is None:
                self._sync = self._disk.submit(self._keep)
            else:
                self._wants_sync = True

    def salvage(self) -> None:
        """After a failure: leave all that was written, and a whole file if there is room for its end.

        A file without a message only repeats what another says, and is not left. Where the disk has failed to keep
        what it had taken, the file is cut back to what it keeps: a part, which the next start makes whole.
        """
        if self._stream.closed:
            return
        with suppress(OSError):
            self._wait_for_sync()
        with suppress(OSError):
            if not self.is_doubtful:
                self._mcap.cut_back()
                if not self._mcap.messages:
                    self._find().unlink()
                else:
                    self._salvage()
        with suppress(OSError):
            if self.is_doubtful and not self._stream.closed:
                self._cut_to_kept()
        with suppress(OSError):
            if not self._stream.closed:
                self.is_left = self._mcap.messages > 0 and os.fstat(self._stream.fileno()).st_nlink > 0
                self.path = self._find()
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
            self._find().unlink()

    def _find(self) -> Path:
        """Where the part is now: somebody may have moved it with its directory, and another be in its place.

        Raises:
            OSError: it is nowhere to be found.
        """
        descriptor = self._stream.fileno()
        state = os.fstat(descriptor)
        link = Path("/proc/self/fd", str(descriptor))
        with suppress(OSError):
            if os.path.samestat(self._part.stat(), state):
                return self._part
        with suppress(OSError):
            path = link.readlink()
            if path.name == self._part.name and os.path.samestat(path.stat(), state):
                return path
        raise FileNotFoundError(0, "somebody has moved the log while it was written")

    def _sync_all(self) -> None:
        try:
            os.fsync(self._stream.fileno())
            self._look_for_name()
        except OSError:
            self.is_doubtful = True
            raise

    def _look_for_name(self) -> None:
        if os.fstat(self._stream.fileno()).st_nlink == 0:
            raise FileNotFoundError(0, "somebody has removed the log while it was written")

    def _keep(self) -> None:
        """On another thread: have the disk keep what is written so far."""
        with self._changed:
            # What was asked for until here this one covers.
            self._wants_sync = False
        size = self._mcap.size
        try:
            os.fdatasync(self._stream.fileno())
            self._look_for_name()
        except OSError as error:
            # The system tells of it once, and forgets what it could not write.
            self.is_doubtful = True
            self._fault = error
        else:
            self.kept_size = size
            self.has_synced = True
        with self._changed:
            # Behind those of other files that wait: it must not take a thread for itself.
            wants_more = self._wants_sync and not self.is_doubtful
            self._sync = self._disk.submit(self._keep) if wants_more else None
        self.when_synced()

    def _raise_fault(self) -> None:
        fault, self._fault = self._fault, None
        if fault is not None:
            raise fault

    def _wait_for_sync(self) -> None:
        """Of the sync that goes on; what has not begun need not: whoever ends the file syncs it himself."""
        with self._changed:
            self._wants_sync = False
            sync = self._sync
            if sync is not None and sync.cancel():
                self._sync = sync = None
        if sync is not None:
            wait([sync])
        self._raise_fault()

    def _finish(self) -> None:
        self._wait_for_sync()
        self._mcap.finish()
        self._sync_all()
        # Renamed while it is locked: an unlocked part is one that somebody may recover.
        part = self._find()
        self.path = part.rename(part.with_name(self._whole_path.name))
        self.has_synced = True
        self._stream.close()
        sync_directory(self.path.parent)
