"""Files that outlive a restart of the gateway, and how they are written.

- A stop by the guard, or by ``cruiser halt``: one line per message. While the file exists the stop is latched,
  whatever its content; a reset removes it. The guard writes it without the gateway.
- The gateway's latches: written at once and removed by the reset, so that no restart clears a latch.
- The total mileage: a large difference at a start suggests another chassis, for instance where a computer was
  moved, or a configuration was copied with its name.
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
from typing import ClassVar, Final, Generic, Self, TypeVar

import msgspec

from gateway.host.process import request_realtime
from schemas.command_line import plain
from schemas.reasons import Reason
from schemas.settings import MILEAGE_DIFFERS_KM, Settings

WRITE_TIMEOUT_S: Final = 2.0  # longest wait for a stalled disk when the gateway ends


def state_directory(setting: str, environment: Mapping[str, str]) -> Path | None:
    """The directory that ``gateway.state_dir`` names; None if there is none.

    Auto is ``$STATE_DIRECTORY``, which systemd sets, else ``$XDG_STATE_HOME/cruiser``, else
    ``~/.local/state/cruiser``.
    """
    if setting != "auto":
        return Path(setting) if setting else None
    given = environment.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    state = environment.get("XDG_STATE_HOME", "")
    home = environment.get("HOME", "")
    if state.startswith("/"):
        return Path(state) / "cruiser"
    return Path(home) / ".local" / "state" / "cruiser" if home else None


def write_whole(path: Path, content: bytes) -> None:
    """Replace a file atomically, and make its directory. Raises OSError; the file is then unchanged."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    unfinished = path.with_suffix(".unfinished")
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)
    sync_directory(path.parent)


def sync_directory(directory: Path) -> None:
    """Sync a directory's entries, so that a power cut undoes no earlier change."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


log = logging.getLogger(__name__)

Value = TypeVar("Value")


class Aside(Generic[Value]):
    """Writes values on a separate thread, in order: a stalled disk must not block the caller."""

    def __init__(
        self,
        name: str,
        write: Callable[[Value], None],
        close_timeout_s: float = WRITE_TIMEOUT_S,
        realtime_priority: int = 0,
    ) -> None:
        """Start the thread at the main thread's priority, so that it never holds the interpreter for long."""
        self._write = write
        self._close_timeout_s = close_timeout_s
        self._realtime_priority = realtime_priority
        self._values: SimpleQueue[Value | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        return self._values.qsize()

    def add(self, value: Value) -> None:
        self._values.put(value)

    def close(self) -> None:
        """Wait until all is written, within the time limit."""
        self._values.put(None)
        self._thread.join(self._close_timeout_s)

    def _run(self) -> None:
        request_realtime(self._realtime_priority)
        while (value := self._values.get()) is not None:
            self._write(value)


class StateNote:
    """A file of one robot in ``gateway.state_dir``."""

    ENDING: ClassVar[str]

    def __init__(self, path: Path | None) -> None:
        self.path = path  # None if there is no state directory

    @classmethod
    def of(cls, settings: Settings, environment: Mapping[str, str] = os.environ) -> Self:
        """Open the note of the robot in the settings."""
        directory = state_directory(settings.gateway.state_dir, environment)
        robot = f"{settings.robot.root}/{settings.robot.name}".replace("/", ".")
        return cls(None if directory is None else directory / f"{robot}.{cls.ENDING}")

    def remove(self) -> None:
        """Remove the file, if it is there. Raises OSError."""
        if self.path is not None:
            with suppress(FileNotFoundError):
                self.path.unlink()
                sync_directory(self.path.parent)


STOP_NOTE_MAX_BYTES: Final = 2048
"""A longer note is neither extended nor read further: its first lines say what happened."""

STOP_WRITE_TIMEOUT_S: Final = 10.0  # longest wait for a stalled disk when a guard, or a halt, ends

CLEAR_TIMEOUT_S: Final = 1.0
"""Longest wait for a stalled disk when the gateway ends; a note that remains latches again."""


class StopNote(StateNote):
    """A stop by the guard or by a halt. Every method may block as long as the disk does."""

    ENDING = "guard-stop"

    def why_not(self) -> str:
        """Return why no note can be written; empty if one can. Makes the directory."""
        if self.path is None:
            return "gateway.state_dir is empty, or there is no home directory to take its place"
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            return f"{self.path.parent} cannot be made: {error.strerror}"
        return "" if os.access(self.path.parent, os.W_OK | os.X_OK) else f"{self.path.parent} cannot be written to"

    def read(self) -> str:
        """Return the note's text in one line; empty if there is none. A damaged note counts as a note."""
        if self.path is None:
            return ""
        try:
            if not self.path.is_file() and self.path.exists():
                return f"the note {self.path} is no file"
            with self.path.open("rb") as file:
                content = file.read(STOP_NOTE_MAX_BYTES)
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
        """Return the last line and its time; None if there is none or it is damaged."""
        try:
            content = b"" if self.path is None else self.path.read_bytes()[:STOP_NOTE_MAX_BYTES]
        except OSError:
            return None
        lines = content.decode(errors="backslashreplace").splitlines()
        if not content.endswith(b"\n") or not lines or not _is_whole(lines[-1]):
            return None
        time, _, text = lines[-1].partition(" ")
        return datetime.fromisoformat(time), text

    def add(self, line: str) -> None:
        """Add a line with the time of day; the file appears with its first line. Raises OSError."""
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
                _write_all(descriptor, content)
            finally:
                # On a full disk the note is empty, but latches all the same.
                unfinished.replace(self.path)
            sync_directory(self.path.parent)
        else:
            is_full = os.fstat(descriptor).st_size + len(content) > STOP_NOTE_MAX_BYTES
            _write_all(descriptor, b"" if is_full else content)


class NoteWriter(Aside[str]):
    """Writes lines of a stop's note on a thread, and reports write errors to ``complain``."""

    def __init__(self, note: StopNote, complain: Callable[[str], None], realtime_priority: int = 0) -> None:
        def write(line: str) -> None:
            try:
                note.add(line)
            except OSError as error:
                complain(f"the note {note.path} cannot be written: {error.strerror}")

        super().__init__("note-writer", write, STOP_WRITE_TIMEOUT_S, realtime_priority)


class NoteClearer:
    """Removes the note when its latch was reset. Only ``close`` blocks."""

    def __init__(self, note: StopNote) -> None:
        self._note = note
        self._was_latched = False
        self._aside: Aside[bool] = Aside("note-clearer", self._clear, CLEAR_TIMEOUT_S)

    def follow(self, *, is_latched: bool) -> None:
        """Note, each tick, whether a stop by the guard is latched."""
        if self._was_latched and not is_latched:
            self._aside.add(True)  # noqa: FBT003 - any value
        self._was_latched = is_latched

    def close(self) -> None:
        self._aside.close()

    def _clear(self, _is_reset: bool) -> None:  # noqa: FBT001 - any value
        try:
            self._note.remove()
        except OSError as error:
            log.warning("the note %s cannot be removed: %s", self._note.path, error.strerror)


def _is_whole(line: str) -> bool:
    """Check that a line of a note begins with its time and is printable."""
    try:
        datetime.fromisoformat(line.partition(" ")[0])
    except ValueError:
        return False
    return line.isprintable()


def _write_all(descriptor: int, content: bytes) -> None:
    try:
        os.write(descriptor, content)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


LATCH_NOTE_MAX_BYTES: Final = 65_536  # a longer file is no note of ours


class LatchNote(StateNote):
    """The latches in force."""

    ENDING = "latched.json"

    def __init__(self, path: Path | None) -> None:
        super().__init__(path)
        self._last: dict[Reason, str] = {}
        self._faults: SimpleQueue[str] = SimpleQueue()
        self._aside = Aside("latch-note", self._store)

    def read(self) -> dict[Reason, str]:
        """Return the latches with their details, oldest first. A note that cannot be read latches a stop."""
        if self.path is None:
            return {}
        try:
            with self.path.open("rb") as file:
                content = file.read(LATCH_NOTE_MAX_BYTES)
            found = msgspec.json.decode(content, type=dict[str, str])
            self._last = {Reason(name): plain(detail) for name, detail in found.items()}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else "it is damaged"
            # ``follow`` then writes the note again, and a reset removes it.
            return {Reason.REMOTE_STOP: f"the note of what was latched cannot be read: {self.path}: {why}"}
        return dict(self._last)

    def follow(self, latched: Mapping[Reason, str]) -> str:
        """Note changed latches, each tick. Returns once why a change could not be written; else nothing."""
        if latched != self._last:
            self._last = dict(latched)
            self._aside.add({one.value: text for one, text in latched.items() if one is not Reason.GUARD})
        return "" if self._faults.empty() else self._faults.get()

    def close(self) -> None:
        self._aside.close()

    def _store(self, latched: dict[str, str]) -> None:
        if self._aside.waiting > 1:
            return  # Stops by changing names may outpace the disk: only the last one counts.
        try:
            self._write(latched)
        except OSError as error:
            fault = f"a restart would forget or bring back what is latched: {self.path}: {error.strerror}"
            log.warning("%s", fault)
            self._faults.put(fault)

    def _write(self, latched: dict[str, str]) -> None:
        if not latched:
            self.remove()
        elif self.path is not None:
            write_whole(self.path, msgspec.json.encode(latched))


class RunNote(StateNote):
    """A file that exists while the gateway runs, so that the next start knows how this run ended."""

    ENDING = "running"

    def begin(self) -> bool:
        """Write the file. Returns True if it existed: the gateway before did not end in order."""
        if self.path is None:
            return False
        is_there = self.path.exists()
        try:
            write_whole(self.path, b"")
        except OSError as error:
            log.warning("the next start will not know how this run ended: %s: %s", self.path, error.strerror)
        return is_there

    def end(self) -> None:
        with suppress(OSError):
            self.remove()


STEP_KM: Final = 0.1  # distance after which the note is updated, and so the error that a power cut leaves

MILEAGE_NOTE_MAX_BYTES: Final = 256


class MileageNote(StateNote):
    """The total mileage, read at the start and updated while driving. A damaged file counts as missing."""

    ENDING = "mileage.json"

    def __init__(self, path: Path | None) -> None:
        super().__init__(path)
        self._noted_km = None if path is None else _read(path)
        self._is_first = True
        self._aside: Aside[float] = Aside("mileage-note", self._write)

    def follow(self, mileage_km: float | None) -> str:
        """Note the mileage, each tick. Returns once a question whether it is the same chassis; else nothing."""
        if self.path is None or mileage_km is None or self._aside.waiting:
            return ""
        noted_km, is_first, self._is_first = self._noted_km, self._is_first, False
        if noted_km is not None and abs(mileage_km - noted_km) < STEP_KM:
            return ""
        self._noted_km = mileage_km
        self._aside.add(mileage_km)
        if not is_first or noted_km is None or abs(mileage_km - noted_km) <= MILEAGE_DIFFERS_KM:
            return ""
        robot = self.path.name.removesuffix(f".{self.ENDING}").rpartition(".")[2]
        return (
            f"its mileage reads {mileage_km:.1f} km, and read {noted_km:.1f} km when this computer last saw "
            f"{robot}: is this the same chassis? If not, give it a name of its own (robot.name)"
        )

    def _write(self, mileage_km: float) -> None:
        try:
            if self.path is not None:
                write_whole(self.path, msgspec.json.encode(mileage_km))
        except OSError as error:
            log.warning("the mileage cannot be noted: %s: %s", self.path, error.strerror)


def _read(path: Path) -> float | None:
    try:
        with path.open("rb") as file:
            return msgspec.json.decode(file.read(MILEAGE_NOTE_MAX_BYTES), type=float)
    except (OSError, ValueError):
        return None
