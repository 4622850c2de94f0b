"""The days of a catalog: how much was driven on each, how often it was stopped, and the incidents."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from recorder.review.catalog.rows import INCIDENT
from recorder.serve.search import FindQuery, FindSubject, matching

DAY_NS: Final = 86_400_000_000_000

DAYS_COLUMNS: Final = ["file", "is_covered", "names", "drives", "moments"]
"""The columns of the catalog that they need."""


class LoggedDay(msgspec.Struct, frozen=True, kw_only=True):
    """A day in UTC.

    Attributes:
        day: as 2026-01-02.
        drives: those that began on it, and ``distance_m`` of all of these.
        stops: times that a command ended, on whatever robot.
        incidents: those that were kept.
    """

    day: str
    drives: int
    distance_m: float
    stops: int
    incidents: int


def days(table: pa.Table) -> list[LoggedDay]:
    """Return the days on which anything was driven, stopped or kept, in their order.

    What several logs hold counts once.

    Args:
        table: rows of a catalog, with DAYS_COLUMNS.
    """
    drives = matching(table, FindQuery(FindSubject.DRIVES))
    stops = matching(table, FindQuery(FindSubject.MOMENTS, only_stops=True))
    incidents = matching(table, FindQuery(FindSubject.MOMENTS, kinds=frozenset({INCIDENT})))
    drive_days, distances = _distinct(drives, "start_ns", ["robot", "end_ns", "distance_m"])
    meters: Counter[int] = Counter()
    for day, distance_m in zip(drive_days.tolist(), distances, strict=True):
        meters[day] += distance_m
    counts = [
        Counter(found.tolist())
        for found in (
            drive_days,
            _distinct(stops, "time_ns", ["robot", "kind", "reason"])[0],
            _distinct(incidents, "time_ns", ["robot", "text"])[0],
        )
    ]
    return [
        LoggedDay(
            day=_date(day),
            drives=counts[0][day],
            distance_m=float(meters[day]),
            stops=counts[1][day],
            incidents=counts[2][day],
        )
        for day in sorted(set().union(*counts))
    ]


def _distinct(rows: pa.Table, time: str, others: list[str]) -> tuple[Any, list[Any]]:
    """The day of each row that is another one, and the last of its other fields."""
    once = rows.group_by([time, *others]).aggregate([])
    return np.asarray(once.column(time).to_numpy()) // DAY_NS, once.column(others[-1]).to_pylist()


def _date(day: int) -> str:
    return (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(days=day)).date().isoformat()
