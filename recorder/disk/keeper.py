"""Keeps the directory of logs within its limits: looks once a second, and deletes what ``retention`` says."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from recorder.disk.log_names import INCIDENT_SUFFIX, PART_SUFFIX
from recorder.disk.upload_note import NONE_SAFE, SafeLogReader, SafeLogs
from recorder.record.notices import Deleted, DiskRoom, Moved, Notice
from recorder.record.retention import DiskLimits, LogEntry, judge
from recorder.record.signature import SIGNATURE_SUFFIX
from schemas.command_line import plain
from schemas.settings import MARK_SHARE

log = logging.getLogger(__name__)

LOOK_S: Final = 1.0
"""Pause between two looks at the disk."""

RETRY_S: Final = 10.0
"""Pause before a file that could not be deleted is tried again; others go in its place."""

END_S: Final = 2.0
"""Longest wait of the end for a disk that does not answer."""

NOTICES_MAX: Final = 10_000

PIECE_BYTES: Final = 1 << 20
"""So much of a log is read at once."""

FLOOR_MAX_SHARE: Final = 0.1
"""No more than this of a file system is kept free, however small it is."""

_NAME: Final = re.compile(
    r"(?P<robot>[A-Za-z0-9._-]+)-(?P<start>\d{8}T\d{6}Z)(?P<kind>\.[a-z]+)?(-(?P<number>\d+))*(?P<suffix>\.mcap(\.part|\.damaged|\.rest)?)"
)
"""The names that a recorder gives; whatever else is in the directory is not ours to delete or to count."""


class DiskUse(msgspec.Struct, frozen=True):
    """Use of the disk, in bytes, and whether marks may take more of the budget."""

    free: int = 0
    used: int = 0
    incidents: int = 0
    has_mark_room: bool = True


def read_entries(directory: Path, own: Collection[str] = (), safe: SafeLogs = NONE_SAFE) -> list[LogEntry]:
    """The recorder's files in a directory.

    Args:
        directory: of the logs.
        own: names of those that are being written here.
        safe: those that are safe elsewhere, as long as they have not changed since.

    Raises:
        OSError: it cannot be read.
    """
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
    """A thread that looks at the disk from its beginning to ``close``.

    Args:
        directory: of the logs.
        limits: the space that they may take.
        own: names of the files that are being written here.
    """

    def __init__(
        self, directory: Path, limits: DiskLimits, own: Callable[[], Collection[str]] = frozenset
    ) -> None:
        self._directory = directory
        self._limits = limits
        self._own = own
        self._uploaded: SafeLogReader | None = SafeLogReader(directory)
        """None once a line of it was wrong: whoever wrote that can write others."""
        self._notices: deque[Notice] = deque(maxlen=NOTICES_MAX)
        self._room = DiskRoom(has_room=True, has_incident_room=True)
        self._stuck: dict[str, float] = {}
        """Names of files that could not be deleted, and when to try again."""
        self._place: os.stat_result | None = None
        """The directory as it was at the last look; None if it was not there."""
        self._closed = threading.Event()
        self.use = DiskUse()
        self._thread = threading.Thread(target=self._run, name="disk keeper", daemon=True)
        self._thread.start()

    def notices(self) -> Iterable[Notice]:
        """Return the notices since the last call."""
        while self._notices:
            yield self._notices.popleft()

    def close(self) -> None:
        """End the thread, unless the disk holds it up."""
        self._closed.set()
        self._thread.join(END_S)

    def _run(self) -> None:
        while True:
            try:
                self._look()
            except OSError as error:
                # Whoever writes there says so; there is nothing to delete.
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
                return  # The next look judges without the note.
            self._delete(name, sizes[name])
        room = DiskRoom(judgement.has_room, judgement.has_incident_room, judgement.roll)
        if room != self._room or room.roll:
            self._room = room
            self._notices.append(room)

    def _look_for_own(self) -> None:
        """If the directory was replaced and lacks the open logs, end these where they are and begin new ones."""
        place, self._place = self._place, _state(self._directory)
        if place is None or _is_same(place, self._place):
            return
        own = self._own()
        if any(not (self._directory / name).exists() for name in own):
            path = plain(str(self._directory))
            log.warning("somebody has moved or removed %s; the logs go on in a new one", path)
            self._notices.append(Moved(path))
            self._notices.append(msgspec.structs.replace(self._room, roll=True))

    def _is_as_uploaded(self, name: str, size: int, modified_ns: int, sha256: str) -> bool:
        """Read a log, and hold it against its line of the note. After a wrong line none is believed."""
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
        log.warning("%s is not what an upload says of it: until the next start no upload is believed", plain(name))
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
        log.info("deleted %s for want of room", plain(name))
        self._notices.append(Deleted(name, size))


def _state(directory: Path) -> os.stat_result | None:
    try:
        return directory.stat()
    except FileNotFoundError:
        return None


def _is_same(before: os.stat_result, now: os.stat_result | None) -> bool:
    """True if it is the directory that it was, or another disk's in its place: what is there may come back."""
    return now is not None and (before.st_dev != now.st_dev or before.st_ino == now.st_ino)
