"""The files of a recorder: parts, finished logs, their directory, the upload note.

A file is ``NAME-START.mcap.part`` while it is written, locked by its writer, and synced on another thread. A
finished file is renamed to ``NAME-START.mcap``. No file is ever overwritten. OSErrors become a CommandError.

The upload note lists uploaded logs, one line of JSON each: the uploader writes it, retention reads it. A line is
valid for a file of the same length and time of change. Before deleting a log by such a line, the recorder hashes
the file itself.
"""

from __future__ import annotations

import fcntl
import os
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Generator, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from io import BufferedWriter, FileIO
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Final, Self

import msgspec

from recorder.disk.log_names import INCIDENT_SUFFIX, PART_SUFFIX, SIGNATURE_SUFFIX, SUFFIX, lock, lock_own
from recorder.layouts.attached import COUNT as LAYOUTS
from recorder.mcap.writer import NO_LIMIT, McapFile
from recorder.record.actions import (
    CloseLog,
    DeclareChannel,
    LogAction,
    SyncLog,
    WriteAttachment,
    WriteChunk,
    WriteMetadata,
)
from recorder.record.retention import START_FORMAT
from schemas.command_line import CommandError, ExitCode, check_regular, plain
from schemas.settings import ROBOT_LIMIT

if TYPE_CHECKING:
    from recorder.record.signed_mode import LogSigner

ATTACHMENTS_MAX: Final = (2 + LAYOUTS) * ROBOT_LIMIT
"""A configuration, a DBC and layouts for each robot; the oldest beyond it are dropped, as names are untrusted."""


@contextmanager
def clear_errors(path: Path) -> Iterator[None]:
    """Turn an OSError into a CommandError."""
    try:
        yield
    except OSError as error:
        raise CommandError(f"cannot write {plain(str(path))}: {error.strerror or error}") from error


def sync_directory(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_signature(log: Path, sha256: str, signer: LogSigner) -> None:
    """Write the signature of a log beside it, before the log gets its final name."""
    with log.with_name(log.name + SIGNATURE_SUFFIX).open("wb") as file:
        file.write(signer.sign(sha256, log.name))
        file.flush()
        os.fsync(file.fileno())


class Prologue:
    """The actions at the start of every file of a log, so that each can be read alone."""

    def __init__(self) -> None:
        self._channels: dict[int, DeclareChannel] = {}
        self._metadata: dict[str, WriteMetadata] = {}
        self._attachments: dict[str, WriteAttachment] = {}

    def add(self, action: LogAction) -> None:
        """Store a repeated action: the newest of each name of metadata and attachments."""
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
        """Copy it for another log."""
        other = Prologue()
        other._channels |= self._channels
        other._metadata |= self._metadata
        other._attachments |= self._attachments
        return other

    def write_to(self, file: McapFile) -> None:
        """Write all actions; the channels, perhaps thousands, in one write."""
        for action in [*self._metadata.values(), *self._attachments.values()]:
            action.write_to(file)
        file.add_channels([action.channel for action in self._channels.values()])


class PartFile:
    """A file that is being written."""

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
        """The running or queued sync; each file has at most one."""
        self._wants_sync = False  # another sync must follow the current one
        self._fault: OSError | None = None  # the failure of a sync, until the next write raises it
        self.when_synced: Callable[[], object] = int
        """Called on another thread after each sync, successful or not."""
        self.has_synced = False  # a sync of this file has succeeded
        self.kept_size = 0  # bytes synced
        self.is_doubtful = False  # a sync has failed: the bytes beyond ``kept_size`` are undefined
        self.is_left = False  # it could not be finished, and holds messages
        self.unkept_bytes = 0  # memory of the chunks written but not synced
        self._unkept: deque[tuple[int, WriteChunk]] = deque()
        """Those chunks, each with its end in the file: they may have to be written again."""
        self.kept_counts: Counter[int] = Counter()  # synced messages of each channel
        self.kept_from_ns, self.kept_to_ns = NO_LIMIT, 0  # their first and last log time
        self.is_removed = False  # the file was removed before it was ended
        with clear_errors(part):
            self._mcap = McapFile(stream, library)

    @property
    def size(self) -> int:
        """Bytes of whole records so far."""
        return self._mcap.size

    @property
    def name(self) -> str:
        return self._whole_path.name

    @property
    def is_kept(self) -> bool:
        """True if the file exists: ``salvage`` deletes one without messages."""
        with suppress(OSError):  # The disk may be gone.
            return self.path.exists()
        return False

    @property
    def has_failed(self) -> bool:
        """True if a sync has failed; the next write raises its error."""
        return self._fault is not None

    def begin(self, prologue: Prologue) -> None:
        with clear_errors(self.path):
            prologue.write_to(self._mcap)

    def write(self, action: LogAction) -> None:
        """Apply an action. A sync runs beside the next write, which raises the sync's error."""
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
        """Release the chunks that are synced by now."""
        while self._unkept and self._unkept[0][0] <= self.kept_size:
            _, action = self._unkept.popleft()
            self.unkept_bytes -= action.bytes
            chunk = action.chunk
            self.kept_counts.update(chunk.counts)
            self.kept_from_ns = min(self.kept_from_ns, chunk.start_ns)
            self.kept_to_ns = max(self.kept_to_ns, chunk.end_ns)

    def sync(self) -> None:
        """Start a sync of all that is written so far, without waiting for it."""
        with self._changed:
            if self._sync is None:
                self._sync = self._disk.submit(self._keep)
            else:
                self._wants_sync = True

    def salvage(self) -> list[WriteChunk]:
        """End the file: finished if the disk has space for the summary, else as a part.

        A file without messages is deleted. After a failed sync the file is cut back to its synced bytes, as a part
        that the next start recovers. Returns the chunks to write again.
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
        """Return the part's current path: its directory may have been moved, or another file put in its place."""
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
        raise FileNotFoundError(0, "the log was moved while it was written")

    def _sync_all(self) -> None:
        try:
            os.fsync(self._stream.fileno())
            self._look_for_name()
        except OSError:
            self.is_doubtful = True
            raise

    def _look_for_name(self) -> None:
        if os.fstat(self._stream.fileno()).st_nlink == 0:
            raise FileNotFoundError(0, "the log was removed while it was written")

    def _keep(self) -> None:
        """On another thread: sync all that is written so far."""
        with self._changed:
            self._wants_sync = False  # this sync covers earlier requests
        size = self._mcap.size
        try:
            os.fdatasync(self._stream.fileno())
            self._look_for_name()
        except OSError as error:
            # The system reports the failure once, and drops the unwritten data.
            self.is_doubtful = True
            self._fault = error
        else:
            self.kept_size = size
            self.has_synced = True
        with self._changed:
            # Queued behind other files: it must not occupy a thread.
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
        # Renamed while it is locked: an unlocked part may be recovered by another process.
        part = self._find()
        whole = part.with_name(self._whole_path.name)
        if self._signer is not None:
            write_signature(whole, self._mcap.sha256, self._signer)
        self.path = part.rename(whole)
        self.has_synced = True
        self._stream.close()
        sync_directory(self.path.parent)


SYNC_THREADS: Final = 4  # files synced at once: a file system syncs several in about the time of one
STEM_MAX: Final = 150  # characters of a log's name before the time
NAMESAKES_MAX: Final = 1000  # files of one name and second that are numbered; later ones get a time instead


class LogDirectory:
    """The directory of the logs, created if missing."""

    def __init__(self, path: Path, signer: LogSigner | None = None) -> None:
        self._path = path
        self._signer = signer
        self._disk = ThreadPoolExecutor(SYNC_THREADS, "log sync")
        with clear_errors(path):
            path.mkdir(parents=True, exist_ok=True)
            self._device = path.stat().st_dev
            if not os.access(path, os.W_OK | os.X_OK):
                raise PermissionError(0, "no permission to write there")

    def open(self, name: str, wall_ns: int, library: str, *, is_incident: bool = False) -> PartFile:
        """Begin a file named by ``name`` and the time. Recreates a removed directory, but not on another disk."""
        stem = f"{safe_name(name)}-{start_in_name(wall_ns)}{INCIDENT_SUFFIX if is_incident else ''}"
        with clear_errors(self._path):
            self._make_again()
            part, path, stream = self._create(stem)
            try:
                sync_directory(self._path)
                return PartFile(part, path, stream, library, self._disk, self._signer)
            except (CommandError, OSError):
                # Not even the header could be written.
                with suppress(OSError):
                    stream.close()
                with suppress(OSError):
                    part.unlink()
                raise

    def close(self) -> None:
        self._disk.shutdown()

    def _make_again(self) -> None:
        if self._path.exists() and self._path.stat().st_dev != self._device:
            raise FileNotFoundError(0, "its disk was unmounted")
        parent = self._path.absolute().parent
        if not self._path.exists() and parent.exists() and parent.stat().st_dev == self._device:
            self._path.mkdir()

    def _create(self, stem: str) -> tuple[Path, Path, FileIO]:
        for unique in _namesakes(stem):
            part, path = self._path / f"{unique}{PART_SUFFIX}", self._path / f"{unique}{SUFFIX}"
            try:
                stream = FileIO(part, "xb")
            except FileExistsError:
                continue
            # Another recorder may have locked the new part as a leftover; then it owns it.
            if not lock_own(stream.fileno()):
                stream.close()
                continue
            if not path.exists():
                return part, path, stream
            # The name of the part is free, but that of the finished log is taken.
            part.unlink()
            stream.close()
        raise FileExistsError(0, f"too many files of the name {stem}")


def safe_name(text: str) -> str:
    """The text as the beginning of a file name that is valid on any system, and never looks like an option."""
    return re.sub(r"^-|[^A-Za-z0-9._-]+", "_", text.lstrip("."))[:STEM_MAX] or "log"


def start_in_name(wall_ns: int) -> str:
    """A time since 1970 in the form of file names, in UTC."""
    return datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).strftime(START_FORMAT)


def _namesakes(stem: str) -> Iterator[str]:
    """Names for files that would have the same one."""
    yield stem
    for number in range(2, NAMESAKES_MAX + 1):
        yield f"{stem}-{number}"
    # Always unique: no log is lost for lack of a name.
    yield f"{stem}-{time.time_ns()}"


def free_path(directory: Path, stem: str, suffix: str, but_for: Path | None = None) -> Path:
    """A free path, where no other part than ``but_for`` would get the same name."""
    for unique in _namesakes(stem):
        path, part = directory / f"{unique}{suffix}", directory / f"{unique}{PART_SUFFIX}"
        if not path.exists() and (part == but_for or not part.exists()):
            return path
    raise FileExistsError(0, f"too many files of the name {stem}")


@contextmanager
def new_file(path: Path) -> Generator[BufferedWriter, None, None]:
    """Open a new file for writing; an exception removes it."""
    part = path.with_name(f"{path.name}.part")
    shown = plain(str(path))
    if path.exists() or part.exists():
        raise CommandError(f"{plain(str(path if path.exists() else part))} exists, and is not overwritten")
    try:
        with part.open("xb") as stream:
            try:
                # Else a recorder may take it for a leftover.
                with suppress(OSError):
                    lock(stream.fileno())
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
                give_name(part, path)
            except BaseException:
                part.unlink(missing_ok=True)
                raise
    except FileExistsError:
        raise CommandError(f"{shown} exists, and is not overwritten") from None
    except OSError as error:
        raise CommandError(f"cannot write {shown}: {error.strerror or error}") from error


def give_name(part: Path, path: Path) -> None:
    """Rename a finished part to its final name; FileExistsError if another process has taken it meanwhile."""
    try:
        # Unlike a rename, a link never replaces a file.
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:
        if path.exists():
            raise FileExistsError(0, "it exists") from None
        part.rename(path)
    else:
        part.unlink()


@contextmanager
def staging(directory: Path) -> Generator[Path, None, None]:
    """A temporary hidden directory for files until all are finished."""
    with TemporaryDirectory(prefix=".export-", dir=directory, ignore_cleanup_errors=True) as name:
        yield Path(name).absolute()


def new_path(directory: Path, name: str, suffix: str, taken: Collection[str] = ()) -> Path:
    """The path of a new file, numbered if the name is in ``taken``; CommandError if the file exists."""
    endings = chain([suffix], (f"~{number}{suffix}" for number in count(2)))
    path = next(one for one in (directory / f"{name}{end}" for end in endings) if str(one) not in taken)
    if path.exists():
        raise CommandError(f"{plain(str(path))} exists, and is not overwritten")
    return path


NAME: Final = ".uploaded.jsonl"

NOTE_BYTES_MAX: Final = 64_000_000  # of the note that are read
GONE_LINES: Final = 1000  # lines of deleted logs from which the note is rewritten without them


class UploadedLog(msgspec.Struct, frozen=True):
    """A line of the note: an uploaded log, its SHA-256 in hexadecimal, the store's URL and its object there."""

    file: str
    bytes: int
    modified_ns: int
    sha256: str
    url: str
    object: str


SafeLogs = Mapping[str, tuple[int, int, str]]
"""Length, time of the last change and SHA-256 of each uploaded log, by name."""

NONE_SAFE: Final[SafeLogs] = MappingProxyType({})


class SafeLogReader:
    """Reads the note again when it has changed."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / NAME
        self._state: tuple[int, int, int] | None = None
        self._safe: SafeLogs = NONE_SAFE

    def read(self) -> SafeLogs:
        try:
            status = self._path.stat()
            state = status.st_ino, status.st_size, status.st_mtime_ns
            if state != self._state:
                check_regular(self._path, status.st_mode)
                with self._path.open("rb") as stream:
                    data = stream.read(NOTE_BYTES_MAX)
                self._safe = {one.file: (one.bytes, one.modified_ns, one.sha256) for one in _lines(data)}
                self._state = state
        except (OSError, CommandError):
            self._state, self._safe = None, NONE_SAFE
        return self._safe


def _lines(data: bytes) -> list[UploadedLog]:
    found = []
    for line in data.splitlines():
        # The last line may be torn; ignore anything else.
        try:
            found.append(msgspec.json.decode(line, type=UploadedLog))
        except (msgspec.MsgspecError, UnicodeDecodeError):
            continue
    return found


class UploadNote:
    """The note, locked by the process that uploads from this directory."""

    def __init__(self, directory: Path) -> None:
        path = directory / NAME
        with clear_errors(path):
            if path.exists():
                check_regular(path, path.stat().st_mode)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC, 0o640)
        self._stream = os.fdopen(descriptor, "r+b", buffering=0)
        self._path = path
        try:
            with clear_errors(path):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except CommandError as error:
            self._stream.close()
            if isinstance(error.__cause__, BlockingIOError):
                text = f"another upload from {plain(str(directory))} is running"
                raise CommandError(text, ExitCode.REFUSED) from None
            raise
        self._reader = SafeLogReader(directory)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.close()

    def safe(self) -> SafeLogs:
        return self._reader.read()

    def add(self, log: UploadedLog) -> None:
        with clear_errors(self._path):
            # Never continue a torn line.
            self._stream.write(b"\n" * self._is_torn() + msgspec.json.encode(log) + b"\n")
            os.fsync(self._stream.fileno())

    def forget(self, there: Collection[str]) -> None:
        """Remove the lines of deleted logs, if they are many. A torn note only means another upload."""
        with clear_errors(self._path):
            lines = _lines(self._read())
            kept = {one.file: one for one in lines if one.file in there}
            if len(lines) - len(kept) < GONE_LINES:
                return
            # In place: the uploader may have write access to this file only.
            os.ftruncate(self._stream.fileno(), 0)
            self._stream.write(b"".join(msgspec.json.encode(one) + b"\n" for one in kept.values()))
            os.fsync(self._stream.fileno())

    def _read(self) -> bytes:
        return os.pread(self._stream.fileno(), NOTE_BYTES_MAX, 0)

    def _is_torn(self) -> bool:
        size = os.fstat(self._stream.fileno()).st_size
        return bool(size) and os.pread(self._stream.fileno(), 1, size - 1) != b"\n"
