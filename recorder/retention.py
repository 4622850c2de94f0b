"""Which logs go when the disk is full, and whether there is room to go on. Pure.

The oldest logs go first. Incidents never do: they may fill INCIDENT_SHARE of the budget, and the reserve below the
floor is theirs. When all that may go would not be enough, nothing goes, and recording stops until somebody makes
room: what others fill a disk with must not cost the logs that there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec

from schemas.recorder_settings import INCIDENT_FLOOR_SHARE, INCIDENT_SHARE

RESUME_SHARE: Final = 0.02
"""A recording that has stopped goes on when so much of budget or floor is free beyond it, or it would flutter."""

ROLL_BYTES: Final = 100_000
"""Logs that are being written are ended, so that they may go, when they take so much together."""


class LogEntry(msgspec.Struct, frozen=True):
    """A file of a recorder in the directory.

    Attributes:
        started: the UTC start in its name, which sorts by time.
        number: of several files of one name and second; the first has none, which is 1.
        is_open: it is being written, or a recorder left it and it is not recovered yet.
        is_own: this recorder is writing it, and can end it.
        is_stuck: it could not be deleted: it takes its room, and others go in its place.
    """

    name: str
    bytes: int
    started: str
    number: int = 1
    is_incident: bool = False
    is_open: bool = False
    is_own: bool = False
    is_stuck: bool = False


class Limits(msgspec.Struct, frozen=True):
    """How much logs may take; 0 is no limit."""

    budget_bytes: int = 0
    floor_bytes: int = 0


class Judgement(msgspec.Struct, frozen=True):
    """What to do.

    Attributes:
        delete: names of files, the oldest first.
        has_room: logs may be written...
        has_incident_room: ...and incidents.
        roll: end what is being written, so that it may go later.
    """

    delete: tuple[str, ...]
    has_room: bool
    has_incident_room: bool
    roll: bool


def judge(entries: Sequence[LogEntry], free_bytes: int, limits: Limits, *, is_full: bool) -> Judgement:
    """What to do about the disk.

    Args:
        entries: the recorder's files in the directory.
        free_bytes: of the file system.
        limits: what may be taken.
        is_full: recording has stopped for want of room.
    """
    used = sum(entry.bytes for entry in entries)
    wanted = _wanted(used, free_bytes, limits, is_full=is_full)
    may_go = sorted(
        (entry for entry in entries if not (entry.is_incident or entry.is_open or entry.is_stuck)),
        key=lambda entry: (entry.started, entry.number, entry.name),
    )
    incident_bytes = sum(entry.bytes for entry in entries if entry.is_incident)
    open_bytes = sum(entry.bytes for entry in entries if entry.is_own and not entry.is_incident)
    closed_bytes = sum(entry.bytes for entry in may_go)
    # What is written now may go once it is ended; while that is worth it, recording need not stop.
    roll = closed_bytes < wanted <= closed_bytes + open_bytes and open_bytes >= ROLL_BYTES
    delete: list[str] = []
    if roll or wanted <= closed_bytes:
        for entry in may_go:
            if wanted <= 0:
                break
            delete.append(entry.name)
            wanted -= entry.bytes
    return Judgement(
        delete=tuple(delete),
        has_room=wanted <= 0 or roll,
        has_incident_room=(not limits.budget_bytes or incident_bytes < INCIDENT_SHARE * limits.budget_bytes)
        and free_bytes >= INCIDENT_FLOOR_SHARE * limits.floor_bytes,
        roll=roll,
    )


def _wanted(used: int, free_bytes: int, limits: Limits, *, is_full: bool) -> int:
    """How many bytes have to go."""
    more = 1.0 + RESUME_SHARE if is_full else 1.0
    over_budget = used * more - limits.budget_bytes if limits.budget_bytes else 0
    under_floor = limits.floor_bytes * more - free_bytes
    return int(max(0, over_budget, under_floor))
