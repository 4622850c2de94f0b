"""The note beside the logs that says which of them are safe elsewhere: a line for each, as JSON.

The uploader writes it, and retention reads it. A line holds for a file of the same length and the same time of its
last change; what cannot be read of it holds for none. Who can write it could name any log: before the recorder
deletes one because of its line, it makes the hash of the file itself.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Final, Self

import msgspec

from recorder.disk.part_file import clear_errors
from schemas.command_line import CommandError, ExitCode, check_regular, plain

NAME: Final = ".uploaded.jsonl"

NOTE_BYTES_MAX: Final = 64_000_000
"""No more of it is read."""

GONE_LINES: Final = 1000
"""So many lines of logs that are gone, and the note is written anew without them."""


class UploadedLog(msgspec.Struct, frozen=True):
    """A line: a log that is safe elsewhere.

    Attributes:
        modified_ns: the time of its last change.
        sha256: of its bytes, hexadecimal.
        url: the store's, and ``object`` its name there.
    """

    file: str
    bytes: int
    modified_ns: int
    sha256: str
    url: str
    object: str


SafeLogs = Mapping[str, tuple[int, int, str]]
"""Length, time of the last change and SHA-256 of each log that is safe elsewhere, by its name."""

NONE_SAFE: Final[SafeLogs] = MappingProxyType({})


class SafeLogReader:
    """Reads the note, where it has changed since the last time.

    Args:
        directory: of the logs.
    """

    def __init__(self, directory: Path) -> None:
        self._path = directory / NAME
        self._state: tuple[int, int, int] | None = None
        self._safe: SafeLogs = NONE_SAFE

    def read(self) -> SafeLogs:
        """Return what is safe; nothing, where there is no note or it cannot be read."""
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
        # The last one may be torn, and whatever else is there is none of ours.
        try:
            found.append(msgspec.json.decode(line, type=UploadedLog))
        except (msgspec.MsgspecError, UnicodeDecodeError):
            continue
    return found


class UploadNote:
    """The note, held by the one that uploads from this directory.

    Args:
        directory: of the logs.

    Raises:
        CommandError: it cannot be written, or another upload holds it.
    """

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
        """The logs that are safe elsewhere."""
        return self._reader.read()

    def add(self, log: UploadedLog) -> None:
        """Have the disk keep that a log is safe.

        Raises:
            CommandError: it does not.
        """
        with clear_errors(self._path):
            # After a line that was torn this one begins anew.
            self._stream.write(b"\n" * self._is_torn() + msgspec.json.encode(log) + b"\n")
            os.fsync(self._stream.fileno())

    def forget(self, there: Collection[str]) -> None:
        """Forget the logs that are gone, if they are many. What is torn then is uploaded once more.

        Raises:
            CommandError: the disk does not take it.
        """
        with clear_errors(self._path):
            lines = _lines(self._read())
            kept = {one.file: one for one in lines if one.file in there}
            if len(lines) - len(kept) < GONE_LINES:
                return
            # In place: who uploads may be let write this one file, and make none beside it.
            os.ftruncate(self._stream.fileno(), 0)
            self._stream.write(b"".join(msgspec.json.encode(one) + b"\n" for one in kept.values()))
            os.fsync(self._stream.fileno())

    def _read(self) -> bytes:
        return os.pread(self._stream.fileno(), NOTE_BYTES_MAX, 0)

    def _is_torn(self) -> bool:
        size = os.fstat(self._stream.fileno()).st_size
        return bool(size) and os.pread(self._stream.fileno(), 1, size - 1) != b"\n"
