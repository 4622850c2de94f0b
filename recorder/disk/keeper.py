"""Keeps the log directory in order: applies ``retention`` once a second, and recovers files after a crash.

Recovery deletes nothing of value. It cuts off only what a killed writer leaves behind the last whole record: the
beginning of a write, or zeros. Other bytes behind the good data are moved to ``NAME.mcap.rest``. The good data of
a file that is damaged before its end is copied into ``NAME.mcap``, and the file itself becomes
``NAME.mcap.damaged``, as does an unreadable part.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import re
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final

import msgspec

from recorder.disk.files import (
    NONE_SAFE,
    SafeLogReader,
    SafeLogs,
    free_path,
    sync_directory,
    write_signature,
)
from recorder.disk.log_names import INCIDENT_SUFFIX, PART_SUFFIX, SIGNATURE_SUFFIX, SUFFIX, lock
from recorder.mcap.recovery import FileSurvey, copy_good, survey
from recorder.record.actions import Deleted, DiskBack, DiskRoom, Moved, Notice, Recovered
from recorder.record.retention import DiskLimits, LogEntry, judge
from schemas.command_line import plain
from schemas.settings import MARK_SHARE

if TYPE_CHECKING:
    from recorder.record.signed_mode import LogSigner

log = logging.getLogger(__name__)

REST_SUFFIX: Final = ".mcap.rest"
DAMAGED_SUFFIX: Final = ".mcap.damaged"
COPY_SUFFIX: Final = ".mcap.copy"  # an unfinished copy, which the next try overwrites

_SUFFIXES: Final = (PART_SUFFIX, DAMAGED_SUFFIX, REST_SUFFIX, SUFFIX)


class RecoveryOutcome(Enum):
    """The outcome of recovering a file."""

    WHOLE = "whole"  # it was whole already
    RECOVERED = "recovered"  # it is whole now, with all that was written
    DAMAGED = "damaged"  # it was damaged; what is good is whole now
    NOTHING = "nothing"  # nothing in it can be read
    BUSY = "busy"  # a recorder is writing it
    FAILED = "failed"  # the disk or the system does not let it be recovered; it is as it was


class Recovery(msgspec.Struct, frozen=True):
    """The recovery of a file.

    Attributes:
        kept: the file with the bytes that are not in the result; None if there is none.
        faults: the first of ``fault_count`` damages.
    """

    path: str
    outcome: RecoveryOutcome
    result: str
    messages: int = 0
    chunks: int = 0
    cut_bytes: int = 0
    kept: str | None = None
    faults: list[str] = []
    fault_count: int = 0
    detail: str = ""


NO_LOCKS: Final = "cannot check whether a recorder is writing it; copy it to a disk with file locks"


def recover(path: Path, library: str, *, set_aside: bool = False, signer: LogSigner | None = None) -> Recovery:
    """Make a log whole. ``set_aside`` renames an unreadable file, so that it is not tried again."""
    name = str(path)
    try:
        with path.open("r+b") as stream:
            try:
                is_free = lock(stream.fileno())
            except OSError as error:
                return Recovery(name, RecoveryOutcome.FAILED, name, detail=f"{error.strerror}: {NO_LOCKS}")
            if not is_free:
                return Recovery(name, RecoveryOutcome.BUSY, name, detail="a recorder is writing it")
            # Its writer may have renamed it before we got the lock.
            if not os.path.samestat(path.stat(), os.fstat(stream.fileno())):
                return Recovery(name, RecoveryOutcome.BUSY, name, detail="a recorder has just written it")
            return _recover(path, stream, library, signer, set_aside=set_aside)
    except OSError as error:
        return Recovery(name, RecoveryOutcome.FAILED, name, detail=error.strerror or str(error))


def _recover(path: Path, stream: BinaryIO, library: str, signer: LogSigner | None, *, set_aside: bool) -> Recovery:
    size = os.fstat(stream.fileno()).st_size
    found = survey(stream, size)
    if not found.end or (found.fault_count and not found.messages):
        kept = _rename(path, DAMAGED_SUFFIX) if set_aside else path
        return Recovery(
            str(path), RecoveryOutcome.NOTHING, str(kept), cut_bytes=size, detail="nothing in it can be read"
        )
    if found.fault_count:
        return _copy(path, stream, size, library, found, signer)
    kept_rest = None
    if not found.is_whole:
        if not found.is_torn:
            kept_rest = _keep_rest(path, stream, found.end)
        _end_with(stream.fileno(), found.end, found.ending)
    os.fsync(stream.fileno())
    result = _rename(path, SUFFIX, signer=signer) if path.name.endswith(PART_SUFFIX) else path
    whole_now = RecoveryOutcome.DAMAGED if kept_rest else RecoveryOutcome.RECOVERED
    return Recovery(
        str(path),
        RecoveryOutcome.WHOLE if found.is_whole else whole_now,
        str(result),
        messages=found.messages,
        chunks=found.chunks,
        cut_bytes=0 if found.is_whole else size - found.end,
        kept=str(kept_rest) if kept_rest else None,
    )


def _end_with(file: int, end: int, data: bytes) -> None:
    os.ftruncate(file, end)
    written = 0
    try:
        while written < len(data):
            written += os.pwrite(file, data[written:], end + written)
    except OSError:
        os.ftruncate(file, end)
        raise


def _keep_rest(path: Path, stream: BinaryIO, end: int) -> Path:
    _check_room(path.parent, os.fstat(stream.fileno()).st_size - end)
    rest = free_path(path.parent, _stem(path), REST_SUFFIX, but_for=path)
    stream.seek(end)
    with rest.open("xb") as kept:
        try:
            shutil.copyfileobj(stream, kept)
            kept.flush()
            os.fsync(kept.fileno())
        except OSError:
            rest.unlink()
            raise
    sync_directory(path.parent)
    return rest


def _copy(
    path: Path, stream: BinaryIO, size: int, library: str, found: FileSurvey, signer: LogSigner | None
) -> Recovery:
    _check_room(path.parent, size + len(found.ending))
    copy = path.with_name(_stem(path) + COPY_SUFFIX)
    try:
        with copy.open("wb") as sink:
            copy_good(stream, size, sink, library)
            sink.flush()
            os.fsync(sink.fileno())
    except OSError:
        copy.unlink(missing_ok=True)
        raise
    if path.name.endswith(PART_SUFFIX):
        result = _rename(copy, SUFFIX, beside=path, signer=signer)
        kept = _rename(path, DAMAGED_SUFFIX)
    else:
        kept = _rename(path, DAMAGED_SUFFIX)
        result = _rename(copy, SUFFIX)
    return Recovery(
        str(path),
        RecoveryOutcome.DAMAGED,
        str(result),
        messages=found.messages,
        chunks=found.chunks,
        kept=str(kept),
        faults=found.faults,
        fault_count=found.fault_count,
    )


def _check_room(directory: Path, size: int) -> None:
    """Check that a file fits: filling the disk in vain would cost finished logs."""
    if shutil.disk_usage(directory).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _rename(path: Path, suffix: str, beside: Path | None = None, signer: LogSigner | None = None) -> Path:
    """Give a file another suffix, and a number if the name is taken. Signs it first, if there is a signer."""
    target = free_path(path.parent, _stem(path), suffix, but_for=beside or path)
    if signer is not None:
        with path.open("rb") as stream:
            write_signature(target, hashlib.file_digest(stream, "sha256").hexdigest(), signer)
    path.rename(target)
    sync_directory(path.parent)
    return target


def _stem(path: Path) -> str:
    for suffix in (*_SUFFIXES, COPY_SUFFIX):
        if path.name.endswith(suffix):
            return path.name.removesuffix(suffix)
    return path.name


def recover_leftovers(parts: Iterable[Path], library: str, signer: LogSigner | None = None) -> Iterator[Recovery]:
    """Recover and report each part that no recorder is writing."""
    for path in parts:
        recovery = recover(path, library, set_aside=True, signer=signer)
        if recovery.outcome is not RecoveryOutcome.BUSY:
            _tell(recovery)
            yield recovery


def _tell(recovery: Recovery) -> None:
    path, result = plain(recovery.path), plain(recovery.result)
    if recovery.outcome in {RecoveryOutcome.WHOLE, RecoveryOutcome.RECOVERED}:
        log.info("recovered %d messages of %s into %s", recovery.messages, path, result)
    elif recovery.outcome is RecoveryOutcome.DAMAGED:
        log.warning(
            "recovered %d messages of %s, which is damaged, into %s; the rest is in %s",
            recovery.messages,
            path,
            result,
            plain(recovery.kept or ""),
        )
    else:
        log.warning("cannot recover %s: %s; the file is now %s", path, recovery.detail or "no message", result)


class LeftoverThread:
    """Recovers the leftovers of a directory while the next recording is already running.

    The next start repeats an interrupted recovery. Without disk space, a recovery is retried when there is some.
    """

    def __init__(self, directory: Path, library: str, signer: LogSigner | None = None) -> None:
        self.recoveries: list[Recovery] = []
        self._notices: deque[Notice] = deque()
        self._directory = directory
        self._library = library
        self._signer = signer
        self._has_failed = False  # the last look could not recover a part
        self._is_wanted = False  # another look begins when the current one ends
        # Only parts that exist now: those begun later are not leftovers.
        self._thread = self._begin(sorted(directory.glob(f"*{PART_SUFFIX}")))

    def receive_notice(self, notice: Notice) -> None:
        """Look again when the disk works again, or has space for a failed recovery; open files are locked."""
        has_room = isinstance(notice, DiskRoom) and notice.has_room
        if isinstance(notice, DiskBack) or (has_room and self._has_failed):
            self._is_wanted = True
            self._begin_wanted()

    def _begin_wanted(self) -> None:
        # One at a time. The thread reads the directory: the caller must not wait for the disk.
        if self._is_wanted and not self._thread.is_alive():
            self._is_wanted = False
            self._thread = self._begin(self._directory.glob(f"*{PART_SUFFIX}"))

    def _begin(self, parts: Iterable[Path]) -> threading.Thread:
        self._has_failed = False
        thread = threading.Thread(target=self._run, args=[parts], name="leftovers", daemon=True)
        thread.start()
        return thread

    def _run(self, parts: Iterable[Path]) -> None:
        for recovery in recover_leftovers(parts, self._library, self._signer):
            self.recoveries.append(recovery)
            if recovery.outcome is RecoveryOutcome.FAILED:
                self._has_failed = True
            elif recovery.outcome is not RecoveryOutcome.NOTHING:
                self._notices.append(Recovered(plain(Path(recovery.result).name), recovery.messages))

    def notices(self) -> Iterator[Notice]:
        self._begin_wanted()
        while self._notices:
            yield self._notices.popleft()

    def wait(self, timeout_s: float) -> None:
        """Wait for the current look, at most this long."""
        self._thread.join(timeout_s)


LOOK_S: Final = 1.0  # pause between two looks at the disk
RETRY_S: Final = 10.0  # pause before deleting a file is tried again; meanwhile others are deleted instead
END_S: Final = 2.0  # at the end, longest wait for a disk that does not respond
NOTICES_MAX: Final = 10_000
PIECE_BYTES: Final = 1 << 20  # read at once
FLOOR_MAX_SHARE: Final = 0.1  # greatest share of a file system kept free

_NAME: Final = re.compile(
    r"(?P<robot>[A-Za-z0-9._-]+)-(?P<start>\d{8}T\d{6}Z)(?P<kind>\.[a-z]+)?(-(?P<number>\d+))*(?P<suffix>\.mcap(\.part|\.damaged|\.rest)?)"
)
"""The names of a recorder's files; other files in the directory are neither deleted nor counted."""


class DiskUse(msgspec.Struct, frozen=True):
    """Use of the disk in bytes, and whether marks may use more of the budget."""

    free: int = 0
    used: int = 0
    incidents: int = 0
    has_mark_room: bool = True


def read_entries(directory: Path, own: Collection[str] = (), safe: SafeLogs = NONE_SAFE) -> list[LogEntry]:
    entries = []
    now_s = time.time()
    with os.scandir(directory) as found:
        for one in found:
            match = _NAME.fullmatch(one.name)
            if match is None:
                continue
            try:
                status = one.stat(follow_symlinks=False)
            except FileNotFoundError:
                continue
            entries.append(
                LogEntry(
                    name=one.name,
                    bytes=status.st_size,
                    started=match["start"],
                    number=int(match["number"] or 1),
                    robot=match["robot"],
                    is_incident=match["kind"] == INCIDENT_SUFFIX,
                    is_open=match["suffix"] == PART_SUFFIX,
                    is_own=one.name in own,
                    is_safe=safe.get(one.name, ())[:2] == (status.st_size, status.st_mtime_ns),
                    age_s=now_s - status.st_mtime,
                )
            )
    return entries


class DiskKeeper:
    """A thread that checks the disk until ``close``."""

    def __init__(
        self, directory: Path, limits: DiskLimits, own: Callable[[], Collection[str]] = frozenset
    ) -> None:
        self._directory = directory
        self._limits = limits
        self._own = own
        self._uploaded: SafeLogReader | None = SafeLogReader(directory)
        """None after a wrong line: then the note is not trusted any more."""
        self._notices: deque[Notice] = deque(maxlen=NOTICES_MAX)
        self._room = DiskRoom(has_room=True, has_incident_room=True)
        self._stuck: dict[str, float] = {}  # files that could not be deleted, and when to try again
        self._place: os.stat_result | None = None  # the directory at the last look, if it existed
        self._closed = threading.Event()
        self.use = DiskUse()
        self._thread = threading.Thread(target=self._run, name="disk keeper", daemon=True)
        self._thread.start()

    def notices(self) -> Iterable[Notice]:
        while self._notices:
            yield self._notices.popleft()

    def close(self) -> None:
        """End the thread, unless the disk does not respond."""
        self._closed.set()
        self._thread.join(END_S)

    def _run(self) -> None:
        while True:
            try:
                self._look()
            except OSError as error:
                # The writer reports it; there is nothing to delete.
                log.debug("cannot look at %s: %s", self._directory, error)
            if self._closed.wait(LOOK_S):
                return

    def _look(self) -> None:
        self._look_for_own()
        safe = NONE_SAFE if self._uploaded is None else self._uploaded.read()
        entries = read_entries(self._directory, self._own(), safe)
        disk = os.statvfs(self._directory)
        free = disk.f_bavail * disk.f_frsize
        floor = min(self._limits.floor_bytes, int(FLOOR_MAX_SHARE * disk.f_blocks * disk.f_frsize))
        limits = msgspec.structs.replace(self._limits, floor_bytes=floor)
        incidents = sum(entry.bytes for entry in entries if entry.is_incident)
        self.use = DiskUse(
            free=free,
            used=sum(entry.bytes for entry in entries),
            incidents=incidents,
            has_mark_room=not limits.budget_bytes or incidents < MARK_SHARE * limits.budget_bytes,
        )
        sizes = {entry.name: entry.bytes for entry in entries}
        marked = {entry.name for entry in entries if entry.is_safe}
        self._stuck = {name: until_s for name, until_s in self._stuck.items() if name in sizes}
        now_s = time.monotonic()
        entries = [
            msgspec.structs.replace(entry, is_stuck=self._stuck.get(entry.name, now_s) > now_s)
            for entry in entries
        ]
        judgement = judge(entries, free, limits, is_full=not self._room.has_room)
        for name in judgement.delete:
            if name in marked and not self._is_as_uploaded(name, *safe[name]):
                return  # The next look ignores the note.
            self._delete(name, sizes[name])
        room = DiskRoom(judgement.has_room, judgement.has_incident_room, judgement.roll)
        if room != self._room or room.roll:
            self._room = room
            self._notices.append(room)

    def _look_for_own(self) -> None:
        """If the directory was replaced and lacks the open logs, end these and begin new ones."""
        place, self._place = self._place, _state(self._directory)
        if place is None or _is_same(place, self._place):
            return
        own = self._own()
        if any(not (self._directory / name).exists() for name in own):
            path = plain(str(self._directory))
            log.warning("%s was moved or removed; the logs continue in a new directory", path)
            self._notices.append(Moved(path))
            self._notices.append(msgspec.structs.replace(self._room, roll=True))

    def _is_as_uploaded(self, name: str, size: int, modified_ns: int, sha256: str) -> bool:
        """Compare a log with its line of the note. After a wrong line the note is not trusted any more."""
        whole = hashlib.sha256()
        try:
            with (self._directory / name).open("rb") as stream:
                while piece := stream.read(PIECE_BYTES):
                    if self._closed.is_set():
                        return False
                    whole.update(piece)
                status = os.fstat(stream.fileno())
        except FileNotFoundError:
            return False
        except OSError as error:
            log.warning("cannot read %s: %s", plain(name), error.strerror or error)
        else:
            if (status.st_size, status.st_mtime_ns, whole.hexdigest()) == (size, modified_ns, sha256):
                return True
        log.warning("%s differs from its upload: uploads are ignored until the next start", plain(name))
        self._uploaded = None
        return False

    def _delete(self, name: str, size: int) -> None:
        try:
            (self._directory / name).unlink()
        except FileNotFoundError:
            return
        except OSError as error:
            level = logging.DEBUG if name in self._stuck else logging.WARNING
            log.log(level, "cannot delete %s: %s", plain(name), error.strerror or error)
            self._stuck[name] = time.monotonic() + RETRY_S
            return
        with suppress(OSError):
            (self._directory / f"{name}{SIGNATURE_SUFFIX}").unlink()
        log.info("deleted %s to free disk space", plain(name))
        self._notices.append(Deleted(name, size))


def _state(directory: Path) -> os.stat_result | None:
    try:
        return directory.stat()
    except FileNotFoundError:
        return None


def _is_same(before: os.stat_result, now: os.stat_result | None) -> bool:
    """True if it is the same directory, or one of another disk: the first one may be mounted again."""
    return now is not None and (before.st_dev != now.st_dev or before.st_ino == now.st_ino)
