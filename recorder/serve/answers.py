"""Answers of the catalog as the page has them: plain JSON, times in ISO 8601, lists of bounded length."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from recorder.review.catalog.rows import INCIDENT, CatalogRow, LoggedDrive, LoggedDriver, LoggedMoment
from recorder.review.report.links import iso
from recorder.review.timeline.entries import EntryKind
from recorder.serve.search import FindAnswer, FoundDrive, FoundMoment

DRIVE_STOPS: Final = 20
"""Stops and incidents that are listed with a drive; the report has all."""

MOMENTS: Final = 500
"""Moments of a log that are listed; the report has all."""

BEGINS: Final = frozenset({EntryKind.ENGAGED.value, EntryKind.LEASE.value})
"""Kinds of moments whose operator is who drives."""


class NearDrives(msgspec.Struct, frozen=True):
    """The part of a log that is shown with its drives.

    Attributes:
        operators: those who drove in all of the log.
        moments: stops, incidents, and those with which somebody began.
    """

    operators: Sequence[LoggedDriver] = ()
    moments: list[LoggedMoment] = []


def answer(one: FindAnswer, near: NearDrives | None = None) -> dict[str, Any]:
    """Return an answer; of a drive also who drove, its stops and its incidents.

    Args:
        one: the answer.
        near: what its log has around it.
    """
    match one:
        case FoundMoment(file, moment):
            return {"is": "moment", "file": file, **_moment(moment)}
        case FoundDrive(file, drive):
            return {"is": "drive", "file": file, **_drive(drive, near or NearDrives())}
        case CatalogRow():
            return {"is": "log", **_log(one)}


def whole(row: CatalogRow) -> dict[str, Any]:
    """Return all that the catalog has of a log: its figures, its drives, and what happened."""
    listed = [one for one in row.moments if one.is_stop or one.kind == INCIDENT]
    others = [one for one in row.moments if not (one.is_stop or one.kind == INCIDENT)]
    kept = sorted(
        [*listed[:MOMENTS], *others[: max(0, MOMENTS - len(listed))]], key=lambda one: (one.time_ns, one.robot)
    )
    return {
        **_log(row),
        "damage": row.damage,
        "versions": row.versions,
        "variants": row.variants,
        "drivers": [msgspec.structs.asdict(one) for one in row.operators],
        "all_drives": [_drive(drive, NearDrives(row.operators, row.moments)) for drive in row.drives],
        "moments": [_moment(one) for one in kept],
        "more_moments": len(row.moments) - len(kept) + row.more_moments,
    }


def _log(row: CatalogRow) -> dict[str, Any]:
    return {
        "file": row.file,
        "robots": row.names,
        "start": iso(row.start_ns) if row.messages else "",
        "end": iso(row.end_ns) if row.messages else "",
        "bytes": row.bytes,
        "distance_m": row.distance_m,
        "moving_s": row.moving_s,
        "top_mps": row.top_mps,
        "operators": list(dict.fromkeys(one.name for one in row.operators)),
        "drives": len(row.drives) + row.more_drives,
        "stops": row.stops,
        "refused": row.refused,
        "outages": row.outages,
        "lost": row.lost,
        "faults": row.faults,
        "is_whole": row.is_whole,
        "is_incident": row.is_incident,
    }


def _drive(drive: LoggedDrive, near: NearDrives) -> dict[str, Any]:
    during = [
        one
        for one in near.moments
        if one.robot in {drive.robot, ""} and drive.start_ns <= one.time_ns <= drive.end_ns
    ]
    listed = [one for one in during if one.is_stop or one.kind == INCIDENT]
    began = dict.fromkeys(one.operator for one in during if one.kind in BEGINS and one.operator)
    alone = [one.name for one in near.operators if one.robot == drive.robot]
    return {
        "robot": drive.robot,
        "start": iso(drive.start_ns),
        "end": iso(drive.end_ns),
        "distance_m": drive.distance_m,
        "stops": drive.stops,
        "severity": drive.severity,
        "text": drive.text,
        # Who was engaged before the log began drove it, where nobody else drove in it.
        "drivers": list(began) or (alone if len(alone) == 1 else []),
        "moments": [_moment(one) for one in listed[:DRIVE_STOPS]],
        "more_moments": max(0, len(listed) - DRIVE_STOPS),
    }


def _moment(moment: LoggedMoment) -> dict[str, Any]:
    return {
        "time": iso(moment.time_ns),
        "robot": moment.robot,
        "kind": moment.kind,
        "severity": moment.severity,
        "reason": moment.reason,
        "operator": moment.operator,
        "count": moment.count,
        "is_stop": moment.is_stop,
        "text": moment.text,
    }
