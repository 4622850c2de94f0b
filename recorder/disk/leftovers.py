"""Logs that their recorder could not finish: made whole in place, at the next start or by hand.

Nothing of value is deleted. Cut off without a trace is only what a killed writer leaves behind the last whole
record: the beginning of one last write, or zeros. Anything else behind the good data is kept beside as
``NAME.mcap.rest``. A file with damage before its end is not changed: what is good in it is copied into
``NAME.mcap``, and it becomes ``NAME.mcap.damaged``. So does a part of which nothing can be read.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import shutil
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from recorder.disk.log_directory import free_path, lock
from recorder.disk.log_names import PART_SUFFIX, SUFFIX
from recorder.disk.part_file import sync_directory, write_signature
from recorder.mcap.recovery import FileSurvey, copy_good, survey
from recorder.record.notices import DiskBack, DiskRoom, Notice, Recovered
from recorder.record.signature import LogSigner
from schemas.command_line import plain

log = logging.getLogger(__name__)

REST_SUFFIX: Final = ".mcap.rest"
DAMAGED_SUFFIX: Final = ".mcap.damaged"
COPY_SUFFIX: Final = ".mcap.copy"
"""A copy that is not finished; the next try begins it anew."""

_SUFFIXES: Final = (PART_SUFFIX, DAMAGED_SUFFIX, REST_SUFFIX, SUFFIX)


class RecoveryOutcome(Enum):
    """The outcome of recovering a file."""

    WHOLE = "whole"
    """It was whole already."""
    RECOVERED = "recovered"
    """It is whole now, with all that was written."""
    DAMAGED = "damaged"
    """It was damaged; what is good is whole now."""
    NOTHING = "nothing"
    """Nothing in it can be read."""
    BUSY = "busy"
    """A recorder is writing it."""
    FAILED = "failed"
    """The disk or the system does not let it be recovered; it is as it was."""


class Recovery(msgspec.Struct, frozen=True):
    """The recovery of a file.

    Attributes:
        result: the log as it is called now.
        messages, chunks: that it holds.
        cut_bytes: that stood behind its good data.
        kept: the file of the parts that are not in the result; None if none is worth keeping.
        faults: damage; ``fault_count`` of them, the first ones listed.
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


NO_LOCKS: Final = "this disk does not tell whether a recorder writes it; copy it to one that has locks"


def recover(path: Path, library: str, *, set_aside: bool = False, signer: LogSigner | None = None) -> Recovery:
    """Make a log whole.

    Args:
        path: the log.
        library: the writer's name, for the header of a copy.
        set_aside: rename a file of which nothing can be read, so that nobody tries it again.
        signer: signs what becomes a whole log of a part; None leaves it unsigned.
    """
    name = str(path)
    try:
        with path.open("r+b") as stream:
            try:
                is_free = lock(stream.fileno())
            except OSError as error:
                return Recovery(name, RecoveryOutcome.FAILED, name, detail=f"{error.strerror}: {NO_LOCKS}")
            if not is_free:
                return Recovery(name, RecoveryOutcome.BUSY, name, detail="a recorder is writing it")
            # Its writer may have renamed it before the lock was ours.
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
        _finish(stream, found)
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


def _finish(stream: BinaryIO, found: FileSurvey) -> None:
    """Cut back to the good data and end the file, or not, if there is no room."""
    _end_with(stream.fileno(), found.end, found.ending)


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
    """Check that a file fits beside the others: one that fills the disk in vain would cost logs that are whole.

    Raises:
        OSError: it does not.
    """
    if shutil.disk_usage(directory).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _rename(path: Path, suffix: str, beside: Path | None = None, signer: LogSigner | None = None) -> Path:
    """Give a file another suffix, and a number where the name is taken; before it has it, it is signed."""
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
    """Recover each part that nobody writes any more, and say so in the log."""
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
            "recovered %d messages of %s, which is damaged, into %s; the rest is kept in %s",
            recovery.messages,
            path,
            result,
            plain(recovery.kept or ""),
        )
    else:
        log.warning("cannot recover %s: %s; it is kept as %s", path, recovery.detail or "no message", result)


class LeftoverThread:
    """Recovers what a directory holds while the next recording is already going on: it must not wait for that.

    A recovery that is broken off at any instant is begun anew by the next start. One that found no room is tried
    again when there is some.
    """

    def __init__(self, directory: Path, library: str, signer: LogSigner | None = None) -> None:
        self.recoveries: list[Recovery] = []
        self._notices: deque[Notice] = deque()
        self._directory = directory
        self._library = library
        self._signer = signer
        self._has_failed = False
        """The last look has left a part as it was."""
        self._is_wanted = False
        """A look is to begin as soon as the present one ends."""
        # What is there now: a part that is begun later is none of them.
        self._thread = self._begin(sorted(directory.glob(f"*{PART_SUFFIX}")))

    def receive_notice(self, notice: Notice) -> None:
        """Look again when the disk takes the logs again, or has room for what could not be recovered."""
        has_room = isinstance(notice, DiskRoom) and notice.has_room
        if isinstance(notice, DiskBack) or (has_room and self._has_failed):
            self.look_again()

    def look_again(self) -> None:
        """Recover what is left now, this recorder's own included; once at a time.

        What is being written is locked. The directory is read on the thread: who calls must not wait for it.
        """
        self._is_wanted = True
        self._begin_wanted()

    def _begin_wanted(self) -> None:
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
        """Return the notices since the last call; begin a look that had to wait."""
        self._begin_wanted()
        while self._notices:
            yield self._notices.popleft()

    def wait(self, timeout_s: float) -> None:
        """Give it this long to end by itself."""
        self._thread.join(timeout_s)
