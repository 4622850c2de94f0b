"""The note of what is latched: a small file, so that no restart of the gateway's process clears a latch.

It is written as soon as something is latched, and removed by the reset. A stop by the guard has a note of its own
(``gateway.host.stop_note``), for the guard writes it when the gateway is gone.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Final, Self

import msgspec

from gateway.host.state_directory import state_directory, sync_directory, write_whole
from schemas.command_line import plain
from schemas.reasons import Reason
from schemas.settings import Settings

log = logging.getLogger(__name__)

NOTE_MAX_BYTES: Final = 65_536
"""A longer file is no note of ours."""

WRITE_TIMEOUT_S: Final = 2.0
"""The longest wait of a gateway that ends for a disk that stalls."""


class LatchNote:
    """The file of one robot, written by a thread of its own: a disk that stalls must not hold up the loop.

    Attributes:
        path: of the file; None if no note is kept.
    """

    def __init__(self, path: Path | None) -> None:
        """Start the thread."""
        self.path = path
        self._last: dict[Reason, str] = {}
        self._waiting: SimpleQueue[dict[str, str] | None] = SimpleQueue()
        self._faults: SimpleQueue[str] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="latch-note", daemon=True)
        self._thread.start()

    @classmethod
    def of(cls, settings: Settings, environment: Mapping[str, str] = os.environ) -> Self:
        """The note of the robot that the settings name."""
        return cls(_path(settings, environment, "latched.json"))

    def read(self) -> dict[Reason, str]:
        """Return what was latched, with the details, oldest first. A note that cannot be read latches a stop."""
        if self.path is None:
            return {}
        try:
            with self.path.open("rb") as file:
                content = file.read(NOTE_MAX_BYTES)
            said = msgspec.json.decode(content, type=dict[str, str])
            self._last = {Reason(name): plain(detail) for name, detail in said.items()}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else "it is damaged"
            # So the note is written anew, and a reset removes it.
            return {Reason.REMOTE_STOP: f"the note of what was latched cannot be read: {self.path}: {why}"}
        return dict(self._last)

    def follow(self, latched: Mapping[Reason, str]) -> str:
        """Each tick: have the note written if something else is latched now, without waiting.

        Returns:
            Why the last change could not be written, once; else an empty text.
        """
        if latched != self._last:
            self._last = dict(latched)
            self._waiting.put({one.value: text for one, text in latched.items() if one is not Reason.GUARD})
        return "" if self._faults.empty() else self._faults.get()

    def close(self) -> None:
        """Wait until all is written, or until the disk has had its time."""
        self._waiting.put(None)
        self._thread.join(WRITE_TIMEOUT_S)

    def _run(self) -> None:
        while (latched := self._waiting.get()) is not None:
            if self._waiting.qsize() > 1:
                continue  # Stops under ever other names come faster than a disk writes: the last of them counts.
            try:
                self._write(latched)
            except OSError as error:
                fault = f"a restart would forget or bring back what is latched: {self.path}: {error.strerror}"
                log.warning("%s", fault)
                self._faults.put(fault)

    def _write(self, latched: dict[str, str]) -> None:
        if self.path is None:
            return
        if not latched:
            with suppress(FileNotFoundError):
                self.path.unlink()
                sync_directory(self.path.parent)
            return
        write_whole(self.path, msgspec.json.encode(latched))


class RunNote:
    """A file that is there while the gateway runs, so that the next one knows how this one ended."""

    def __init__(self, path: Path | None) -> None:
        """Nothing is written yet."""
        self.path = path

    @classmethod
    def of(cls, settings: Settings, environment: Mapping[str, str] = os.environ) -> Self:
        """The note of the robot that the settings name."""
        return cls(_path(settings, environment, "running"))

    def begin(self) -> bool:
        """Write it. Return True if it is there already: the gateway before did not end in order."""
        if self.path is None:
            return False
        is_there = self.path.exists()
        try:
            write_whole(self.path, b"")
        except OSError as error:
            log.warning("the next start will not know how this one ended: %s: %s", self.path, error.strerror)
        return is_there

    def end(self) -> None:
        """Remove it: the gateway ends in order."""
        if self.path is not None:
            with suppress(OSError):
                self.path.unlink()


def _path(settings: Settings, environment: Mapping[str, str], ending: str) -> Path | None:
    directory = state_directory(settings.gateway.state_dir, environment)
    robot = f"{settings.robot.root}/{settings.robot.name}".replace("/", ".")
    return None if directory is None else directory / f"{robot}.{ending}"
