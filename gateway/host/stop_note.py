"""The note of a stop by the guard: a small file, so that its latch outlives a restart of the gateway.

The guard, or ``cruiser halt``, adds a line for each thing that it says. While the file exists the stop is latched,
whatever the file holds. A reset removes it.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from queue import SimpleQueue
from typing import Final, Self

from gateway.host.realtime import request_realtime
from gateway.host.state_directory import state_directory, sync_directory
from schemas.command_line import plain
from schemas.settings import Settings

log = logging.getLogger(__name__)

NOTE_MAX_BYTES: Final = 2048
"""A longer note is neither extended nor read to its end: its first lines say what happened."""

WRITE_TIMEOUT_S: Final = 10.0
"""The longest wait of a guard, or a halt, that has done for a disk that stalls."""

CLEAR_TIMEOUT_S: Final = 1.0
"""The longest wait of a gateway that ends for a disk that stalls; a note that stays latches once more."""


class StopNote:
    """The file of one robot. Everything here may block for as long as the disk does.

    Attributes:
        path: of the file; None if no note is kept.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path

    @classmethod
    def of(cls, settings: Settings, environment: Mapping[str, str] = os.environ) -> Self:
        """The note of the robot that the settings name."""
        directory = state_directory(settings.gateway.state_dir, environment)
        robot = f"{settings.robot.root}/{settings.robot.name}".replace("/", ".")
        return cls(None if directory is None else directory / f"{robot}.guard-stop")

    def why_not(self) -> str:
        """Why no note can be kept, for people; empty if one can. Makes the directory."""
        if self.path is None:
            return "gateway.state_dir is empty, or there is no home directory to take its place"
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            return f"{self.path.parent} cannot be made: {error.strerror}"
        return "" if os.access(self.path.parent, os.W_OK | os.X_OK) else f"{self.path.parent} cannot be written to"

    def read(self) -> str:
        """Return the note's text in one line; empty if there is none. A damaged note is a note."""
        if self.path is None:
            return ""
        try:
            if not self.path.is_file() and self.path.exists():
                return f"the note {self.path} is no file"
            with self.path.open("rb") as file:
                content = file.read(NOTE_MAX_BYTES)
        except FileNotFoundError:
            return ""
        except OSError as error:
            return f"the note {self.path} cannot be read: {error.strerror}"
        if not content:
            return f"the note {self.path} is empty: the disk was full"
        lines = content.decode(errors="backslashreplace").splitlines()
        if not content.endswith(b"\n") or not all(map(_is_whole, lines)):
            return f"the note {self.path} is damaged: {plain(' / '.join(lines))}"
        return plain("; ".join(lines))

    def last(self) -> tuple[datetime, str] | None:
        """The last line, and when it was added; None if there is none, or it is damaged."""
        try:
            content = b"" if self.path is None else self.path.read_bytes()[:NOTE_MAX_BYTES]
        except OSError:
            return None
        lines = content.decode(errors="backslashreplace").splitlines()
        if not content.endswith(b"\n") or not lines or not _is_whole(lines[-1]):
            return None
        time, _, text = lines[-1].partition(" ")
        return datetime.fromisoformat(time), text

    def add(self, line: str) -> None:
        """Add a line with the time of day; the file is there with its first line or not at all.

        Raises:
            OSError: it cannot be written.
        """
        if self.path is None:
            return
        content = f"{datetime.now(UTC).isoformat(timespec='milliseconds')} {line}\n".encode()
        try:
            descriptor = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        except FileNotFoundError:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            unfinished = self.path.with_suffix(".unfinished")
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW
            descriptor = os.open(unfinished, flags, 0o600)
            try:
                _write(descriptor, content)
            finally:
                # On a full disk the note is empty, and latches all the same.
                unfinished.replace(self.path)
            sync_directory(self.path.parent)
        else:
            is_full = os.fstat(descriptor).st_size + len(content) > NOTE_MAX_BYTES
            _write(descriptor, b"" if is_full else content)

    def clear(self) -> None:
        """Remove the note: it was reset.

        Raises:
            OSError: it cannot be removed.
        """
        if self.path is not None:
            with suppress(FileNotFoundError):
                self.path.unlink()
                sync_directory(self.path.parent)


class NoteWriter:
    """Writes a note on a thread of its own: a disk that stalls must not hold up a stop."""

    def __init__(self, note: StopNote, complain: Callable[[str], None], realtime_priority: int = 0) -> None:
        """Start the thread.

        Args:
            note: where to.
            complain: is given the one line that says why a line could not be written.
            realtime_priority: of the thread, which must not hold the interpreter while others run: that of the
                process's main thread.
        """
        self._note = note
        self._complain = complain
        self._realtime_priority = realtime_priority
        self._lines: SimpleQueue[str | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="note-writer", daemon=True)
        self._thread.start()

    def add(self, line: str) -> None:
        """Have this line written, without waiting."""
        self._lines.put(line)

    def close(self) -> None:
        """Wait until all lines are written, or until the disk has had its time."""
        self._lines.put(None)
        self._thread.join(WRITE_TIMEOUT_S)

    def _run(self) -> None:
        request_realtime(self._realtime_priority)
        while (line := self._lines.get()) is not None:
            try:
                self._note.add(line)
            except OSError as error:
                self._complain(f"the note {self._note.path} cannot be written: {error.strerror}")


class NoteClearer:
    """Removes the note when what it latched was reset; nothing blocks but ``close``."""

    def __init__(self, note: StopNote) -> None:
        self._note = note
        self._was_latched = False
        self._thread: threading.Thread | None = None

    def follow(self, *, is_latched: bool) -> None:
        """Each tick: whether a stop by the guard is latched."""
        if self._was_latched and not is_latched:
            # Seldom, and only while the robot is told nothing: starting a thread takes a tenth of a millisecond.
            self._thread = threading.Thread(target=self._clear, name="note-clearer", daemon=True)
            self._thread.start()
        self._was_latched = is_latched

    def close(self) -> None:
        """Wait until the note is removed, or until the disk has had its time."""
        if self._thread is not None:
            self._thread.join(CLEAR_TIMEOUT_S)

    def _clear(self) -> None:
        try:
            self._note.clear()
        except OSError as error:
            log.warning("the note %s cannot be removed: %s", self._note.path, error.strerror)


def _is_whole(line: str) -> bool:
    """A line of a note begins with its time, and all of it can be printed."""
    try:
        datetime.fromisoformat(line.partition(" ")[0])
    except ValueError:
        return False
    return line.isprintable()


def _write(descriptor: int, content: bytes) -> None:
    try:
        os.write(descriptor, content)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
