"""The row of a log in the catalog: a summary of the answers to other questions.

A robot makes it with the packages of a recorder; libraries for tables are needed only to search rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import msgspec
import zstandard

from recorder.reading.logs import Faults, look_at
from recorder.reading.rows import Progress, Selection
from recorder.review.entries import EntryKind
from recorder.review.info import LogInfo, lost, read_info
from recorder.review.report.findings import Report, RobotReport, moment_words
from recorder.review.report.gather import read_report
from schemas.decisions import Severity
from schemas.reasons import Reason

FORMAT: Final = "cruiser-catalog"
VERSION: Final = 5  # rises with each change of a row's content; a catalog of another version is rebuilt
INCIDENT: Final = "incident"  # the kind of a moment with an incident
NEVER_NS: Final = 2**63 - 1  # the latest time in a column; MCAP's times reach further
DAMAGE_MAX: Final = 3  # faults of a file with their text


class CatalogUnreadableError(Exception):
    """The catalog is damaged, or of another version; the text is for people."""


class LoggedMoment(msgspec.Struct, frozen=True):
    """An entry of ``cruiser review events``, refusals of one kind, or an incident.

    Attributes:
        time_ns, last_ns: the first and the last of ``count`` equal ones, by the robot's clock, since 1970.
        kind: as in ``events``, or ``incident``.
        operator: empty if no operator caused it.
    """

    time_ns: int
    last_ns: int
    robot: str
    kind: str
    severity: str
    reason: str
    operator: str
    holder: str
    count: int
    is_stop: bool
    text: str


class LoggedDrive(msgspec.Struct, frozen=True):
    """A period of being commanded or moving, between long rests.

    Attributes:
        missing_s: time in it without data: the distance is at least ``distance_m``.
        stops: number of stops; ``ends`` of normal ends.
        severity, text: of the worst moment.
    """

    start_ns: int
    end_ns: int
    robot: str
    distance_m: float
    missing_s: float
    stops: int
    ends: int
    severity: str
    text: str


class LoggedRobot(msgspec.Struct, frozen=True):
    """A robot with keys in the log."""

    root: str
    name: str


class LoggedDriver(msgspec.Struct, frozen=True):
    """An operator who drove a robot."""

    robot: str
    name: str
    seconds: float
    distance_m: float


class CatalogRow(msgspec.Struct, frozen=True, kw_only=True):
    """A log.

    Attributes:
        modified_ns: the file's time of change.
        start_ns, end_ns: the first and the last log time, both 0 without messages; at most NEVER_NS.
        is_whole: it was closed properly.
        faults: number of unreadable parts; ``damage`` has the first texts, or ``unreadable: ...``.
        robots: those with keys in it; ``names`` also those named only by the recorder.
        is_incident: it is the log of an incident; ``is_covered`` if other logs of the directory hold all of it.
        distance_m, moving_s, top_mps: of all robots together; the highest speed in either direction.
        events, stops, ends: numbers by kind, by cause, and of normal ends by reason.
        lost, lost_bus, lost_source: by the recorder's count; None if there is none.
        gap_s: time without data on a robot's motion.
        versions: of the recorder, and of each robot's gateway and packages.
        settings: hashes of the configurations in force.
        more_moments, more_drives: those beyond the limits.
    """

    file: str
    bytes: int
    modified_ns: int
    messages: int = 0
    start_ns: int = 0
    end_ns: int = 0
    is_whole: bool = False
    faults: int = 0
    damage: list[str] = []
    is_incident: bool = False
    is_covered: bool = False
    robots: list[LoggedRobot] = []
    names: list[str] = []
    distance_m: float = 0.0
    moving_s: float = 0.0
    top_mps: float = 0.0
    operators: list[LoggedDriver] = []
    accepted: int = 0
    refused: int = 0
    events: dict[str, int] = {}
    stops: dict[str, int] = {}
    ends: dict[str, int] = {}
    outages: int = 0
    lost: int | None = None
    lost_bus: int | None = None
    lost_source: int | None = None
    gap_s: float = 0.0
    variants: list[str] = []
    versions: dict[str, str] = {}
    settings: list[str] = []
    drives: list[LoggedDrive] = []
    more_drives: int = 0
    more_moments: int = 0
    moments: list[LoggedMoment] = []


def row_of(path: Path, file: str, modified_ns: int, progress: Progress = lambda _: None) -> CatalogRow:
    """Make the row of a log from all its messages; CommandError if it cannot be opened."""
    log, faults = look_at(path), Faults()
    info = read_info(log.path)
    report = read_report([log], Selection(), faults, progress)
    moments = sorted(_moments(info, report), key=lambda one: (one.time_ns, one.robot, one.kind, one.text))
    accounts = info.completeness.values()
    found = faults.told or info.faults
    summaries = [robot.summary for robot in report.robots]
    return CatalogRow(
        file=file,
        bytes=log.bytes,
        modified_ns=modified_ns,
        messages=info.messages,
        start_ns=_bounded(log.start_ns),
        end_ns=_bounded(log.end_ns),
        is_whole=info.whole,
        faults=max(faults.count, info.fault_count),
        damage=[one.removeprefix(f"{log.path}: ") for one in found[:DAMAGE_MAX]],
        is_incident=log.is_incident,
        is_covered=False,
        robots=[LoggedRobot(*one) for one in sorted(log.robots)],
        names=info.robots,
        distance_m=sum(one.distance_m for one in summaries),
        moving_s=sum(one.moving_s for one in summaries),
        top_mps=max((abs(one.top_mps) for one in summaries), default=0.0),
        operators=[
            LoggedDriver(one.name, driver.name, driver.seconds, driver.distance_m)
            for one in summaries
            for driver in one.drivers
        ],
        accepted=sum(one.accepted for one in summaries),
        refused=sum(one.refused for one in summaries),
        events=_added(one.events for one in summaries),
        stops=_added(one.stops for one in summaries),
        ends=_added(one.ends for one in summaries),
        outages=sum(len(one.outages) + one.more_outages for one in summaries),
        lost=lost(info),
        lost_bus=sum(one.lost_bus or 0 for one in accounts) if accounts else None,
        lost_source=sum(one.lost_source for one in accounts) if accounts else None,
        gap_s=sum(one.gap_s for one in summaries),
        variants=sorted({one.variant for summary in summaries for one in summary.in_force}),
        versions=dict(sorted(info.versions.items())),
        settings=sorted({one.configuration_sha256 for summary in summaries for one in summary.in_force}),
        drives=[drive for robot in report.robots for drive in _drives(robot)],
        more_drives=sum(robot.more_drives for robot in report.robots),
        moments=moments,
        more_moments=sum(robot.more_moments + robot.summary.other_refusals for robot in report.robots),
    )


def unreadable(file: str, size: int, modified_ns: int, why: str) -> CatalogRow:
    """Make the row of an unreadable log, which is not tried again until it changes."""
    return CatalogRow(file=file, bytes=size, modified_ns=modified_ns, faults=1, damage=[f"unreadable: {why}"])


def _bounded(time_ns: int) -> int:
    return max(0, min(time_ns, NEVER_NS))


def _added(counts: Iterable[dict[str, int]]) -> dict[str, int]:
    return dict(sorted(sum(map(Counter, counts), Counter[str]()).items()))


def _drives(robot: RobotReport) -> Iterator[LoggedDrive]:
    for one in robot.drives:
        yield LoggedDrive(
            start_ns=_bounded(one.start_ns),
            end_ns=_bounded(one.end_ns),
            robot=robot.summary.name,
            distance_m=one.distance_m,
            missing_s=one.missing_s,
            stops=one.stops,
            ends=one.ends,
            severity=one.severity.value,
            text=one.worst,
        )


def _moments(info: LogInfo, report: Report) -> Iterator[LoggedMoment]:
    for robot in report.robots:
        name = robot.summary.name
        for one in robot.moments:
            yield LoggedMoment(
                time_ns=_bounded(one.time_ns),
                last_ns=_bounded(one.last_ns),
                robot=name,
                kind=one.kind.value,
                severity=one.severity.value,
                reason=one.reason.value,
                operator=one.operator,
                holder=one.holder,
                count=one.count,
                is_stop=one.is_stop,
                text=moment_words(one),
            )
        for refusal in robot.summary.refusals:
            yield LoggedMoment(
                time_ns=_bounded(refusal.first_ns),
                last_ns=_bounded(refusal.last_ns),
                robot=name,
                kind=EntryKind.REFUSAL.value,
                severity=Severity.WARNING.value,
                reason=refusal.reason,
                operator=refusal.operator,
                holder="",
                count=refusal.count,
                is_stop=False,
                text=f"{refusal.request} refused{'' if refusal.count == 1 else f' {refusal.count} times'}",
            )
    robots = [robot.summary.name for robot in report.robots] or info.robots
    for entries in info.incidents:
        at_ns = _time(entries.get("at_ns", ""))
        if at_ns is not None:
            yield LoggedMoment(
                time_ns=at_ns,
                last_ns=at_ns,
                # In a log of several robots the incident's robot is unknown.
                robot=robots[0] if len(robots) == 1 else "",
                kind=INCIDENT,
                severity=Severity.WARNING.value,
                reason=Reason.NONE.value,
                operator="",
                holder="",
                count=1,
                is_stop=False,
                text=entries.get("because", ""),
            )


def _time(text: str) -> int | None:
    """A time in a log's metadata, which is untrusted."""
    is_number = text.isascii() and text.isdecimal() and len(text) <= len(str(NEVER_NS))
    return _bounded(int(text)) if is_number else None


UNPACKED_MAX: Final = 64 * 1024 * 1024  # limit of an unpacked row


class RowFile(msgspec.Struct, frozen=True):
    """The content of a row's file."""

    format: str
    version: int
    row: msgspec.Raw


def write_row(path: Path, file: str, modified_ns: int) -> bytes:
    """Make the file of a log's row; CommandError if the log cannot be opened."""
    row = msgspec.json.encode(row_of(path, file, modified_ns))
    return zstandard.compress(msgspec.json.encode(RowFile(FORMAT, VERSION, msgspec.Raw(row))))


def read_row(data: bytes, log_bytes: int) -> CatalogRow:
    """Read the row of a log of this length; CatalogUnreadableError if it is damaged, or of another log."""
    try:
        if not 0 <= zstandard.frame_content_size(data) <= UNPACKED_MAX:
            raise CatalogUnreadableError("unpacks to too much")
        found = msgspec.json.decode(zstandard.decompress(data), type=RowFile)
        if (found.format, found.version) != (FORMAT, VERSION):
            raise CatalogUnreadableError("is of another version")
        row = msgspec.json.decode(found.row, type=CatalogRow)
    except (zstandard.ZstdError, msgspec.MsgspecError, ValueError, MemoryError) as error:
        raise CatalogUnreadableError("is damaged") from error
    if row.bytes != log_bytes:
        raise CatalogUnreadableError("is of another log")
    return row
