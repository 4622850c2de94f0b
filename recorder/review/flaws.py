"""The findings of ``check``, merged by kind, so that the output does not grow with the damage."""

from __future__ import annotations

from enum import Enum
from typing import Final

import msgspec

FINDINGS_MAX: Final = 500  # different findings of a file that are listed; further ones are only counted


class About(Enum):
    """The subject of a finding."""

    FILE = "file"
    DATA = "data"
    ALLOWED = "allowed"  # unusual, but no fault by MCAP's specification


class Finding(msgspec.Struct):
    """A fault of a log.

    Attributes:
        about: the file itself (structure, checksums, schemas), missing data, or something allowed.
        count: number of times, or of samples or frames.
        topic: its channel; empty if there is none.
        offset: its first place in the file, in bytes; None if it has no place.
        time_ns: its first log time, or the frame's time; None if it has no time.
    """

    path: str
    about: About
    what: str
    count: int
    topic: str
    offset: int | None
    time_ns: int | None


class Findings:
    """Collects the findings of one file; ``untold`` counts those beyond FINDINGS_MAX."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._by_kind: dict[tuple[str, str], Finding] = {}
        self.untold = 0

    @property
    def told(self) -> list[Finding]:
        """The findings about the file by place, then those about the data, then what is allowed."""
        order = list(About)
        return sorted(
            self._by_kind.values(),
            key=lambda one: (order.index(one.about), one.offset or 0, one.topic, one.time_ns or 0),
        )

    def file(self, what: str, offset: int | None = None, *, topic: str = "", count: int = 1) -> None:
        """Add a fault of the file itself."""
        self._add(About.FILE, what, topic, count, offset, None)

    def data(self, what: str, topic: str, count: int, time_ns: int | None = None) -> None:
        """Add missing data."""
        self._add(About.DATA, what, topic, count, None, time_ns)

    def allowed(self, what: str, offset: int | None = None, *, topic: str = "", count: int = 1) -> None:
        """Add something unusual that is no fault."""
        self._add(About.ALLOWED, what, topic, count, offset, None)

    def has(self, about: About) -> bool:
        """True if there is any of this kind; unlisted findings are about the file."""
        return any(one.about is about for one in self._by_kind.values()) or (
            about is About.FILE and self.untold > 0
        )

    def _add(
        self, about: About, what: str, topic: str, count: int, offset: int | None, time_ns: int | None
    ) -> None:
        same = self._by_kind.get((what, topic))
        if same is not None:
            same.count += count
        elif about is not About.DATA and len(self._by_kind) >= FINDINGS_MAX:
            self.untold += count if about is About.FILE else 0
        else:
            self._by_kind[what, topic] = Finding(self._path, about, what, count, topic, offset, time_ns)
