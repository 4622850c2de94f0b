"""The directory of logs: how files are called, locked and begun; see ``part_file`` for the rest of their life.

A file is ``NAME-START.mcap.part`` while it is written and ``NAME-START.mcap`` when it is whole. Nothing is ever
overwritten. A part is locked as long as its writer lives. An OSError becomes one clear CommandError here.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from typing import Final

from recorder.disk.log_names import INCIDENT_SUFFIX, PART_SUFFIX, SUFFIX
from recorder.disk.part_file import PartFile, clear_errors, sync_directory
from recorder.record.retention import START_FORMAT
from recorder.record.signature import LogSigner
from schemas.command_line import CommandError

SYNC_THREADS: Final = 4
"""Files that are synced at once: a file system syncs several in about the time of one."""

STEM_MAX: Final = 150
"""Characters of a log's name before the time: who makes up a robot may call it longer than a disk takes."""

NAMESAKES_MAX: Final = 1000
"""Files of one name and second that are numbered; any more have the time of the try in their place."""


class LogDirectory:
    """The directory of the logs. It is made if it does not exist.

    Args:
        path: its place.
        signer: signs each log when it is whole; None leaves them unsigned.

    Raises:
        CommandError: it cannot be made or written to.
    """

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
        """Begin a file whose name holds ``name`` and the time.

        A directory that somebody has removed is made again, but not where its disk was unmounted.

        Raises:
            CommandError: the file cannot be made.
        """
        stem = f"{safe_name(name)}-{start_in_name(wall_ns)}{INCIDENT_SUFFIX if is_incident else ''}"
        with clear_errors(self._path):
            self._make_again()
            part, path, stream = self._create(stem)
            try:
                sync_directory(self._path)
                return PartFile(part, path, stream, library, self._disk, self._signer)
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
        for unique in _namesakes(stem):
            part, path = self._path / f"{unique}{PART_SUFFIX}", self._path / f"{unique}{SUFFIX}"
            try:
                stream = FileIO(part, "xb")
            except FileExistsError:
                continue
            # Another start may take a part without a lock for a leftover; then it is that one's.
            if not lock_own(stream.fileno()):
                stream.close()
                continue
            if not path.exists():
                return part, path, stream
            # Its writer has renamed it; the name of the part was free again, that of the whole is not.
            part.unlink()
            stream.close()
        raise FileExistsError(0, f"too many files of the name {stem}")


def safe_name(text: str) -> str:
    """The text as the beginning of a file's name on any system; no command takes such a name for an option."""
    return re.sub(r"^-|[^A-Za-z0-9._-]+", "_", text.lstrip("."))[:STEM_MAX] or "log"


def start_in_name(wall_ns: int) -> str:
    """A time since 1970 as a file's name has it, in UTC."""
    return datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).strftime(START_FORMAT)


def _namesakes(stem: str) -> Iterator[str]:
    """Names for files that would have the same one."""
    yield stem
    for number in range(2, NAMESAKES_MAX + 1):
        yield f"{stem}-{number}"
    # However many there are, and whatever the clock says: for want of a name nothing is lost.
    yield f"{stem}-{time.time_ns()}"


def free_path(directory: Path, stem: str, suffix: str, but_for: Path | None = None) -> Path:
    """A path of which no file exists, nor a part that may become one; ``but_for`` is one's own part."""
    for unique in _namesakes(stem):
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


def lock_own(descriptor: int) -> bool:
    """As ``lock``; True also where this file system has no locks."""
    try:
        return lock(descriptor)
    except OSError:
        return True  # Without locks here nothing is recovered here either.
