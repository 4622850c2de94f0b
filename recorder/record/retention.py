"""Retention: the logs to delete when the disk is full, and whether recording may continue. Pure.

- Each robot has a fair share: the oldest log of the robot with the largest share is deleted first. Robot names are
  untrusted: where known robots are configured, all others have one share together, and the last hours of a known
  robot are deleted last.
- Uploaded logs are deleted before others.
- Incidents are deleted like logs once they are old and uploaded. The others may fill INCIDENT_SHARE of the budget,
  and the reserve below the floor.
- If deleting everything deletable would not free enough, nothing is deleted, and recording stops until there is
  space: other data on the disk must not cost existing logs.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from itertools import chain
from typing import Final

import msgspec

from schemas.settings import INCIDENT_FLOOR_SHARE, INCIDENT_SHARE

RESUME_SHARE: Final = 0.02  # hysteresis: share of budget and floor that must be free before recording resumes
ROLL_BYTES: Final = 100_000  # open logs are ended, so that they may be deleted, from this total size on

START_FORMAT: Final = "%Y%m%dT%H%M%SZ"  # the format of the start in a log's name
OTHERS: Final = ""  # the share of all unknown robots, where some are known


class LogEntry(msgspec.Struct, frozen=True):
    """A file of a recorder in the directory.

    Attributes:
        started: the UTC start in its name, which sorts by time.
        number: of several files of one name and second, from 1.
        is_open: it is being written, or is not recovered yet.
        is_own: this recorder is writing it, and can end it.
        is_stuck: it could not be deleted.
        is_safe: an upload has verified that a store holds it.
        age_s: since its last change.
    """

    name: str
    bytes: int
    started: str
    number: int = 1
    robot: str = ""
    is_incident: bool = False
    is_open: bool = False
    is_own: bool = False
    is_stuck: bool = False
    is_safe: bool = False
    age_s: float = 0.0


class DiskLimits(msgspec.Struct, frozen=True):
    """The disk space that logs may take; 0 is no limit.

    Attributes:
        floor_bytes: that stay free on the file system.
        known: names of the known robots.
        keep_s: the last seconds of each known robot, which are deleted last.
        keep_incidents_s: age from which an uploaded incident may be deleted.
    """

    budget_bytes: int = 0
    floor_bytes: int = 0
    known: frozenset[str] = frozenset()
    keep_s: float = 0.0
    keep_incidents_s: float = 0.0

    def share_of(self, robot: str) -> str:
        """The share that a robot's log counts against."""
        return robot if not self.known or robot in self.known else OTHERS


class Judgement(msgspec.Struct, frozen=True):
    """The decision about the disk; ``roll``: end the open logs, so that they may be deleted later."""

    delete: tuple[str, ...]
    has_room: bool
    has_incident_room: bool
    roll: bool


def judge(entries: Sequence[LogEntry], free_bytes: int, limits: DiskLimits, *, is_full: bool) -> Judgement:
    """Decide which logs to delete, and what may be written."""
    used = sum(entry.bytes for entry in entries)
    wanted = _wanted(used, free_bytes, limits, is_full=is_full)
    entries = [
        msgspec.structs.replace(entry, is_incident=False) if _counts_as_log(entry, limits) else entry
        for entry in entries
    ]
    incident_bytes = sum(entry.bytes for entry in entries if entry.is_incident)
    logs = [entry for entry in entries if not entry.is_incident]
    may_go = [entry for entry in logs if not (entry.is_open or entry.is_stuck)]
    kept = _last_hours(logs, limits)
    loose = [entry for entry in may_go if entry.name not in kept]
    takes = Counter[str]()
    for entry in logs:
        takes[limits.share_of(entry.robot)] += entry.bytes
    order = _in_turn(loose, takes, limits)
    # Open logs may be deleted once they are ended: if that frees enough, recording continues.
    own = [entry for entry in logs if entry.is_own]
    roll = _is_worth(wanted, loose, [entry for entry in own if entry.name not in kept])
    if not roll:
        roll = _is_worth(wanted, may_go, own)
        order = chain(order, _in_turn((entry for entry in may_go if entry.name in kept), takes, limits))
    delete: list[str] = []
    if roll or wanted <= _bytes(may_go):
        for entry in order:
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


def _wanted(used: int, free_bytes: int, limits: DiskLimits, *, is_full: bool) -> int:
    """Count the bytes that have to go."""
    more = 1.0 + RESUME_SHARE if is_full else 1.0
    over_budget = used * more - limits.budget_bytes if limits.budget_bytes else 0
    under_floor = limits.floor_bytes * more - free_bytes
    return int(max(0, over_budget, under_floor))


def _bytes(entries: Iterable[LogEntry]) -> int:
    return sum(entry.bytes for entry in entries)


def _is_worth(wanted: int, closed: Iterable[LogEntry], being_written: Iterable[LogEntry]) -> bool:
    """True if only deleting the open logs too would free enough, and they reach ROLL_BYTES."""
    closed_bytes, open_bytes = _bytes(closed), _bytes(being_written)
    return closed_bytes < wanted <= closed_bytes + open_bytes and open_bytes >= ROLL_BYTES


def _counts_as_log(entry: LogEntry, limits: DiskLimits) -> bool:
    """True of an incident of an unknown robot, or an old uploaded one."""
    is_stranger = bool(limits.known) and entry.robot not in limits.known
    is_old = entry.is_safe and entry.age_s >= limits.keep_incidents_s
    return entry.is_incident and not entry.is_open and (is_stranger or is_old)


def _in_turn(entries: Iterable[LogEntry], takes: Counter[str], limits: DiskLimits) -> Iterator[LogEntry]:
    """Return the deletable logs in order, uploaded ones first. ``takes`` has the bytes of each share."""
    logs = list(entries)
    for is_safe in (True, False):
        yield from _oldest_of_largest((one for one in logs if one.is_safe is is_safe), takes, limits)


def _oldest_of_largest(entries: Iterable[LogEntry], takes: Counter[str], limits: DiskLimits) -> Iterator[LogEntry]:
    """Return the oldest log of the largest share, repeatedly. ``takes`` has the bytes left of each share."""
    shares: dict[str, deque[LogEntry]] = defaultdict(deque)
    for entry in sorted(entries, key=_age):
        shares[limits.share_of(entry.robot)].append(entry)
    while shares:
        share = min(shares, key=lambda one: (-takes[one], *_age(shares[one][0])))
        entry = shares[share].popleft()
        takes[share] -= entry.bytes
        if not shares[share]:
            del shares[share]
        yield entry


def _age(entry: LogEntry) -> tuple[str, int, str]:
    return entry.started, entry.number, entry.name


def _last_hours(logs: Iterable[LogEntry], limits: DiskLimits) -> set[str]:
    """Names of the logs with the last hours of known robots, back from the start of each robot's newest log.

    A log ends where the next one begins.
    """
    kept: set[str] = set()
    robots: dict[str, list[LogEntry]] = defaultdict(list)
    for entry in logs:
        if entry.robot in limits.known:
            robots[entry.robot].append(entry)
    for own in robots.values():
        own.sort(key=_age, reverse=True)
        next_start = newest = own[0].started
        since = _before(newest, limits.keep_s)
        for entry in own:
            if entry.started != newest and next_start <= since:
                break
            kept.add(entry.name)
            next_start = entry.started
    return kept


def _before(started: str, seconds: float) -> str:
    """The start minus some seconds; unchanged if it is no time."""
    with suppress(ValueError, OverflowError):
        start = datetime.strptime(started, START_FORMAT).replace(tzinfo=UTC)
        return (start - timedelta(seconds=seconds)).strftime(START_FORMAT)
    return started
