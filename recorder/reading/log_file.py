"""A log that a question is about."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Protocol

import msgspec

from recorder.disk.log_directory import INCIDENT_SUFFIX, PART_SUFFIX, SUFFIX


class StoredLog(Protocol):
    """The content of a log that lies in an object store. Reading it raises OSError, with a line for people."""

    @property
    def url(self) -> str:
        """The address of the log."""

    @property
    def size(self) -> int:
        """Its length in bytes."""

    def open(self) -> BinaryIO:
        """Return a stream of it."""

    def fetch(self, start: int, end: int) -> None:
        """Have the bytes of a place ready: they will be read."""


class LogFile(msgspec.Struct, frozen=True):
    """A log.

    Attributes:
        path: of the file; of a stored log its name alone.
        bytes: its length when it was found.
        start_ns, end_ns: the first and the last log time; both 0 if it holds no message.
        robots: root and name of each robot, as far as they are known outside of chunks.
        is_being_written: a recorder had it open when it was found; that it has no end yet is no fault.
        namesakes: names that robots under several roots have, in this log or one that was found with it.
        stored: the log's content, where it is no file of this machine: then only what is needed of it is read.
    """

    path: Path
    bytes: int
    start_ns: int
    end_ns: int
    robots: frozenset[tuple[str, str]] = frozenset()
    namesakes: frozenset[str] = frozenset()
    is_being_written: bool = False
    stored: StoredLog | None = None

    @property
    def name(self) -> str:
        """The path or the address, as it was asked for."""
        return str(self.path) if self.stored is None else self.stored.url

    def open(self) -> BinaryIO:
        """Return a stream of its bytes.

        Raises:
            OSError: it cannot be opened.
        """
        return self.path.open("rb") if self.stored is None else self.stored.open()

    @property
    def is_incident(self) -> bool:
        """It repeats what happened around an incident, and most of it is in a log too."""
        return self.path.name.removesuffix(PART_SUFFIX).removesuffix(SUFFIX).endswith(INCIDENT_SUFFIX)


def logs_of(robot: str, logs: Sequence[LogFile]) -> list[LogFile]:
    """Those that hold a robot, which may be called by its root too; all that hold anything where none says so."""
    filled = [log for log in logs if log.end_ns]
    its = [log for log in filled if any(robot in {name, f"{root}/{name}"} for root, name in log.robots)]
    # A file that is not whole may not tell whose it is.
    return [log for log in filled if log in its or not log.robots] or filled
