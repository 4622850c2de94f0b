"""Which entries are stops. Events, reports, catalogs and searches count by this one definition.

A stop is the end of being commanded that no client asked for: a cause of the arbiter, a takeover, a gateway that
died. What the guard or the next gateway says of it later belongs to it, and so does each further cause that
follows soon, before the robot is engaged again.
"""

from __future__ import annotations

from typing import Final

import msgspec

from recorder.review.entries import STOPS, Entry, EntryKind
from schemas.decisions import Severity
from schemas.reasons import Reason

APART_NS: Final = 10_000_000_000
"""A cause that comes so long after the last one stops a robot that was moved meanwhile: that is another stop."""


class Stops:
    """The stops of one robot, from its entries by their time."""

    def __init__(self) -> None:
        self._caused_ns: int | None = None
        """When the newest cause of the stop was; None once the robot was engaged."""
        self._has_guard_latch = False

    def mark(self, entry: Entry) -> Entry:
        """Return the entry, with ``is_stop`` if a stop begins with it."""
        if entry.kind is EntryKind.ENGAGED:
            self._caused_ns = None
        elif entry.kind is EntryKind.RESET:
            self._has_guard_latch = False
        elif self._stops(entry):
            before_ns, self._caused_ns = self._caused_ns, entry.time_ns
            is_apart = entry.kind in STOPS and before_ns is not None and entry.time_ns - before_ns > APART_NS
            if before_ns is None or is_apart:
                return msgspec.structs.replace(entry, is_stop=True)
        return entry

    def _stops(self, entry: Entry) -> bool:
        """Report whether the command has ended by this, at the latest."""
        if entry.kind is EntryKind.LATCH and entry.reason is Reason.GUARD:
            # Each gateway that finds the latch says so at its start.
            is_new, self._has_guard_latch = not self._has_guard_latch, True
            return is_new
        if entry.kind is EntryKind.GATEWAY:
            return entry.severity is Severity.ERROR
        return entry.kind in STOPS and entry.reason is not Reason.NONE and not entry.tells_of_guard
