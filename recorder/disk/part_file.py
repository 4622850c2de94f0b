"""One file of a log: written as a part, synced beside the writing, and renamed when it is whole.

Only the end of the file waits for a sync. An OSError becomes one clear CommandError here.
"""

from __future__ import annotations

import os
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, wait
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import Final

from recorder.layouts.attached import COUNT as LAYOUTS
from recorder.mcap.chunk import NO_LIMIT
from recorder.mcap.writer import McapFile
from recorder.record.actions import (
    CloseLog,
    DeclareChannel,
    LogAction,
    SyncLog,
    WriteAttachment,
    WriteChunk,
    WriteMetadata,
)
from recorder.record.signature import SIGNATURE_SUFFIX, LogSigner
from schemas.command_line import CommandError, plain
from schemas.settings import ROBOT_LIMIT

ATTACHMENTS_MAX: Final = (2 + LAYOUTS) * ROBOT_LIMIT
"""A configuration, a DBC and layouts for each robot; beyond it the oldest go, for a robot may make up names."""


@contextmanager
def clear_errors(path: Path) -> Iterator[None]:
    """Raise one CommandError for whatever the system reports."""
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


def write_signature(log: Path, sha256: str, signer: LogSigner) -> None:
    """Write the signature of a log beside it, before the log has its name: what has it is signed.

    Raises:
        OSError: the disk does not take it.
    """
    with log.with_name(log.name + SIGNATURE_SUFFIX).open("wb") as file:
        file.write(signer.sign(sha256, log.name))
        file.flush()
        os.fsync(file.fileno())


class Prologue:
    """The actions that every file of a log begins with, so that each can be read alone."""

    def __init__(self) -> None:
        self._channels: dict[int, DeclareChannel] = {}
        self._metadata: dict[str, WriteMetadata] = {}
        self._attachments: dict[str, WriteAttachment] = {}

    def add(self, action: LogAction) -> None:
        """Remember an action that is repeated: of metadata and attachments the newest of each name."""
        if isinstance(action, DeclareChannel):
            self._channels[action.channel.channel_id] = action
        elif isinstance(action, WriteMetadata) and action.lasts:
            self._metadata[action.name] = action
        elif isinstance(action, WriteAttachment):
            self._attachments.pop(action.name, None)
            self._attachments[action.name] = action
            if len(self._attachments) > ATTACHMENTS_MAX:
                del self._attachments[next(iter(self._attachments))]

    def copy(self) -> Prologue:
        """Copy it for a log that begins with the same."""
        other = Prologue()
        other._channels |= self._channels
        other._metadata |= self._metadata
        other._attachments |= self._attachments
        return other

    def write_to(self, file: McapFile) -> None:
        """Write all of it; the channels, of which there may be thousands, in one write."""
        for action in [*self._metadata.values(), *self._attachments.values()]:
            action.write_to(file)
        file.add_channels([action.channel for action in self._channels.values()])


def _nothing() -> None:
    """Do nothing: nobody waits for the disk."""


class PartFile:
    """A file that is being written.

    Args:
        part: the path while it is written.
        path: the path when it is whole.
        stream: the open file, unbuffered.
        library: the writer's name.
        disk: runs the syncs.
        signer: signs it when it is whole; None leaves it unsigned.
    """

    def __init__(
        self,
        part: Path,
        path: Path,
        stream: FileIO,
        library: str,
        disk: Executor,
        signer: LogSigner | None = None,
    ) -> None:
        self._signer = signer
        self._stream = stream
        self._part = part
        self._whole_path = path
        self.path = part
        self._disk = disk
        self._changed = threading.Lock()
        self._sync: Future[None] | None = None
        """The sync that runs, or waits for a thread; each file has at most one."""
        self._wants_sync = False
        """Something was written that the present sync may not cover: another is to follow it."""
        self._fault: OSError | None = None
        """The failure of a sync, until the next write raises it."""
        self.when_synced: Callable[[], None] = _nothing
        """Called on another thread after each sync, whatever became of it."""
        self.has_synced = False
        """True if the disk has taken anything of this file."""
        self.kept_size = 0
        """Bytes that the disk has said it keeps."""
        self.is_doubtful = False
        """The disk has failed to keep what it had taken: what is beyond ``kept_size`` may be anything."""
        self.is_left = False
        """It could not be made whole, and holds messages."""
        self.unkept_bytes = 0
        """Memory of the chunks that were written, and that the disk may not keep yet."""
        self._unkept: deque[tuple[int, WriteChunk]] = deque()
        """Those chunks, each with its end in the file: they may have to be written again."""
        self.kept_counts: Counter[int] = Counter()
        """Messages of each channel that the disk keeps."""
        self.kept_from_ns, self.kept_to_ns = NO_LIMIT, 0
        """Their first and last log time."""
        self.is_removed = False
        """Somebody has removed it before it was ended."""
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
        """True if there is a file, which ``salvage`` may have found not worth keeping."""
        with suppress(OSError):  # A disk that is gone may not even say that it has no such file.
            return self.path.exists()
        return False

    @property
    def has_failed(self) -> bool:
        """True if a sync has failed, which the next write reports."""
        return self._fault is not None

    def begin(self, prologue: Prologue) -> None:
        """Write what the file begins with.

        Raises:
            CommandError: the disk does not take it.
        """
        with clear_errors(self.path):
            prologue.write_to(self._mcap)

    def write(self, action: LogAction) -> None:
        """Apply an action. A sync runs beside the next write, which reports the sync's failure.

        Raises:
            CommandError: the disk does not take it.
        """
        with clear_errors(self.path):
            self._raise_fault()
            if isinstance(action, SyncLog):
                self.sync()
            elif isinstance(action, CloseLog):
                self._finish()
            else:
                action.write_to(self._mcap)
        if isinstance(action, WriteChunk):
            self._unkept.append((self.size, action))
            self.unkept_bytes += action.bytes
        self.release()

    def release(self) -> None:
        """Forget the chunks that the disk keeps by now."""
        while self._unkept and self._unkept[0][0] <= self.kept_size:
            _, action = self._unkept.popleft()
            self.unkept_bytes -= action.bytes
            chunk = action.chunk
            self.kept_counts.update(chunk.counts)
            self.kept_from_ns = min(self.kept_from_ns, chunk.start_ns)
            self.kept_to_ns = max(self.kept_to_ns, chunk.end_ns)

    def sync(self) -> None:
        """Have the disk keep all that is written so far. Does not wait for it."""
        with self._changed:
            if self._sync is None:
                self._sync = self._disk.submit(self._keep)
            else:
                self._wants_sync = True

    def salvage(self) -> list[WriteChunk]:
        """End the file as well as can be: leave all that was written, whole if there is room for the end.

        A file without a message only repeats what another one holds, and is deleted. Where the disk has failed to
        keep what it had taken, the file is cut back to what the disk keeps: a part, which the next start makes
        whole.

        Returns:
            The chunks that the disk has failed to keep.
        """
        if not self._stream.closed:
            self._end()
        self.release()
        unkept = [action for _, action in self._unkept] if self.is_doubtful else []
        self._unkept.clear()
        self.unkept_bytes = 0
        return unkept

    def _end(self) -> None:
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
                self.is_removed = os.fstat(self._stream.fileno()).st_nlink == 0
                self.is_left = self._mcap.messages > 0 and not self.is_removed
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
        """Return the part's path now: its directory may have been moved, and another file be in its place.

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
        """Wait for the running sync, and cancel one that has not begun: the caller syncs the file itself."""
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
        whole = part.with_name(self._whole_path.name)
        if self._signer is not None:
            write_signature(whole, self._mcap.sha256, self._signer)
        self.path = part.rename(whole)
        self.has_synced = True
        self._stream.close()
        sync_directory(self.path.parent)
