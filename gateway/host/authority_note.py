"""Statements that a robot has taken over since it was provisioned: a file that outlives a restart."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import SimpleQueue
from typing import Final, Self

import msgspec

from gateway.authority.robot_authority import Kept
from gateway.host.state_directory import state_directory, write_whole
from schemas.command_line import CommandError, check_regular
from schemas.settings import Settings

log = logging.getLogger(__name__)

CURE: Final = (
    "remove it, start the gateway again, and show the robot the newest list of revocations "
    "('cruiser provision show'), and each rotation since the robot was provisioned"
)

WRITE_TIMEOUT_S: Final = 2.0
"""The longest wait of a gateway that ends for a disk that stalls."""


class AuthorityNote:
    """The file, written by a thread of its own: a disk that stalls must not hold up the loop.

    Attributes:
        path: of the file; None if there is no directory for it.
        report: is given, on that thread, why the file could not be written; empty once it was.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.report: Callable[[str], None] = lambda _: None
        self._kept: SimpleQueue[Kept | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="authority-note", daemon=True)
        self._thread.start()

    @classmethod
    def of(cls, settings: Settings, environment: Mapping[str, str] = os.environ) -> Self:
        """The file of the robot that the settings name."""
        return cls(note_path(settings, environment))

    def read(self) -> Kept | str:
        """Return the statements as saved last, none if there is no file; or why it cannot be read, in words."""
        if self.path is None:
            return "nothing can be kept: gateway.state_dir is empty, and what is revoked must outlive a restart"
        try:
            check_regular(self.path, self.path.stat().st_mode)
            return msgspec.json.decode(self.path.read_bytes(), type=Kept)
        except FileNotFoundError:
            return Kept()
        except CommandError as error:
            return str(error)
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
            return f"{self.path} is damaged, and so is what was revoked: {error}; {CURE}"

    def save(self, kept: Kept) -> None:
        """Have this written, without waiting."""
        self._kept.put(kept)

    def close(self) -> None:
        """Wait until all is written, or until the disk has had its time."""
        self._kept.put(None)
        self._thread.join(WRITE_TIMEOUT_S)

    def _run(self) -> None:
        while (kept := self._kept.get()) is not None:
            fault = ""
            try:
                self._write(kept)
            except OSError as error:
                fault = f"{self.path} cannot be written: {error.strerror}"
                log.warning("%s", fault)
            self.report(fault)

    def _write(self, kept: Kept) -> None:
        if self.path is None:
            return
        write_whole(self.path, msgspec.json.encode(kept))


def note_path(settings: Settings, environment: Mapping[str, str]) -> Path | None:
    """Where the file of the robot that the settings name is; None if there is no directory for it."""
    directory = state_directory(settings.gateway.state_dir, environment)
    robot = f"{settings.robot.root}/{settings.robot.name}".replace("/", ".")
    return None if directory is None else directory / f"{robot}.authority.json"
