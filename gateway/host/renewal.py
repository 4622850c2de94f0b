"""A robot whose keys or grant were installed anew since its gateway was started.

Keys, grants and certificates are read once, at the start. So the gateway ends once the robot stands and nobody
needs it, and its service manager starts it again with the new ones. Where none would, it stays, and says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from gateway.provisioning.key_files import directory_of
from schemas.authority.identity import AUTHORITY_FILE, GRANT_FILE
from schemas.settings import Settings

LOOK_NS: Final = 1_000_000_000
"""Period at which the files are looked at, while the robot can do without its gateway."""

ENDS: Final = "keys or certificates were installed anew: the gateway ends, and is started again with them"
WAITS: Final = "keys or certificates were installed anew: start the gateway again, nobody else does"

FileStamp = tuple[int, int]


class Renewal:
    """Looks at the files that every installation writes.

    Attributes:
        is_taken: they were replaced, and the gateway is to end.
        note: what somebody has to see to, in one line; empty if there is nothing.
    """

    def __init__(self, settings: Settings, *, is_managed: bool) -> None:
        """Take the present files as those in use.

        Args:
            settings: the gateway's.
            is_managed: a service manager starts the gateway again when it ends.
        """
        self.is_taken = False
        self.note = ""
        directory = directory_of(settings.authority)
        names = (GRANT_FILE.format(who="robot"), AUTHORITY_FILE) if settings.authority.mode == "signed" else ()
        self._files = [directory / name for name in names]
        self._is_managed = is_managed
        self._in_use = self._before = self._stamps()

    def look(self) -> bool:
        """Return True if the gateway is to end. Two looks have to find the same: an installation writes many."""
        stamps = self._stamps()
        is_new = stamps == self._before != self._in_use and None not in stamps
        self._before = stamps
        self.is_taken = is_new and self._is_managed
        self.note = WAITS if is_new and not self._is_managed else ""
        return self.is_taken

    def _stamps(self) -> list[FileStamp | None]:
        return [_stamp(file) for file in self._files]


def _stamp(file: Path) -> FileStamp | None:
    """Return numbers that change when a file is replaced; None if it is missing."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ino
