"""The directory of logs: opens files, has them reach the disk, and renames them when they are whole.

A file is ``NAME-START.mcap.part`` while it is written and ``NAME-START.mcap`` when it is whole. Nothing is ever
overwritten. An OSError becomes one clear CommandError here, and nowhere else.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from typing import Final, assert_never

from recorder.effects import CloseLog, DeclareChannel, SyncLog, WriteAttachment, WriteChunk, WriteMetadata
from recorder.mcap_file import McapFile
from schemas.exit_codes import CommandError
from schemas.printable import plain

SUFFIX: Final = ".mcap"
PART_SUFFIX: Final = ".mcap.part"
NAMESAKES_MAX: Final = 1000
"""Files of one name and second at most: recorders that were started at once."""

FileEffect = DeclareChannel | WriteChunk | WriteMetadata | WriteAttachment | SyncLog | CloseLog


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
    """

    def __init__(self, part: Path, path: Path, stream: FileIO, library: str) -> None:
        self._stream = stream
        self._part = part
        self._whole_path = path
        self.path = part
        with _clear_errors(part):
            self._mcap = McapFile(stream, library)

    @property
    def size(self) -> int:
        """Bytes of whole records so far."""
        return self._mcap.size

    def write(self, effect: FileEffect) -> None:
        """Carry an effect out.

        Raises:
            CommandError: the disk does not take it.
        """
        with _clear_errors(self.path):
            match effect:
                case WriteChunk():
                    self._mcap.write_chunk(effect.chunk)
                case SyncLog():
                    os.fdatasync(self._stream.fileno())
                    if os.fstat(self._stream.fileno()).st_nlink == 0:
                        raise FileNotFoundError(0, "somebody has removed the log while it was written")
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
        """After a failure: leave all that was written, and a whole file if there is room for its end."""
        if self._stream.closed:
            return
        with suppress(OSError):
            self._mcap.cut_back()
            try:
                self._finish()
            except OSError:
                if not self._stream.closed:
                    self._mcap.cut_back()
                    os.fsync(self._stream.fileno())
        with suppress(OSError):
            self._stream.close()

    def _finish(self) -> None:
        self._mcap.finish()
        os.fsync(self._stream.fileno())
        self._stream.close()
        self._part.rename(self._whole_path)
        self.path = self._whole_path
        _sync_directory(self.path.parent)


class LogDirectory:
    """Where the logs go. It is made if it does not exist.

    Raises:
        CommandError: it cannot be made or written to.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with _clear_errors(path):
            path.mkdir(parents=True, exist_ok=True)
            if not os.access(path, os.W_OK | os.X_OK):
                raise PermissionError(0, "no permission to write there")

    def open(self, name: str, wall_ns: int, library: str) -> LogFile:
        """Begin a file whose name holds ``name`` and the time.

        Raises:
            CommandError: the file cannot be made.
        """
        start = datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
        stem = f"{safe_name(name)}-{start}"
        with _clear_errors(self._path):
            part, path, stream = self._create(stem)
            _sync_directory(self._path)
        try:
            return LogFile(part, path, stream, library)
        except CommandError:
            # Not even the header fits: there is nothing to keep.
            stream.close()
            part.unlink(missing_ok=True)
            raise

    def _create(self, stem: str) -> tuple[Path, Path, FileIO]:
        for number in range(1, NAMESAKES_MAX + 1):
            unique = stem if number == 1 else f"{stem}-{number}"
            part, path = self._path / f"{unique}{PART_SUFFIX}", self._path / f"{unique}{SUFFIX}"
            try:
                stream = FileIO(part, "xb")
            except FileExistsError:
                continue
            if not path.exists():
                return part, path, stream
            # Its writer has renamed it; the name of the part was free again, that of the whole is not.
            stream.close()
            part.unlink()
        raise FileExistsError(0, f"too many files of the name {stem}")


def safe_name(text: str) -> str:
    """The text as part of a file's name on any system."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", text).lstrip(".") or "log"


def _sync_directory(path: Path) -> None:
    """Have the names in a directory reach the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
