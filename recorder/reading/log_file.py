"""A log that a question is about."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import msgspec

from recorder.disk.log_names import INCIDENT_SUFFIX, PART_SUFFIX, SUFFIX


class LogFile(msgspec.Struct, frozen=True):
    """A log.

    Attributes:
        path: of the file.
        bytes: its length when it was found.
        start_ns, end_ns: the first and the last log time; both 0 if it holds no message.
        robots: root and name of each robot, as far as they are known outside of chunks.
        is_being_written: a recorder had it open when it was found; that it has no end yet is no fault.
        namesakes: names that robots under several roots have, in this log or one that was found with it.
        url: the address in an object store of which the file is a copy; empty if it is none.
    """

    path: Path
    bytes: int
    start_ns: int
    end_ns: int
    robots: frozenset[tuple[str, str]] = frozenset()
    namesakes: frozenset[str] = frozenset()
    is_being_written: bool = False
    url: str = ""

    @property
    def name(self) -> str:
        """The path or the address, as it was asked for."""
        return self.url or str(self.path)

    def open(self) -> BinaryIO:
        """Return a stream of its bytes.

        Raises:
            OSError: it cannot be opened.
        """
        return self.path.open("rb")

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
