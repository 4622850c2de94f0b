"""The named searches of catalogs, each one statement of SQL; no log is opened."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import Any, Final

import msgspec
import pyarrow as pa

from recorder.review.catalog.directory import SCHEMA
from recorder.review.catalog.log_row import NEVER_NS
from recorder.review.export import objects
from recorder.review.query import CatalogSource, answer


class Search(msgspec.Struct, frozen=True):
    """A search; ``columns`` are those that the statement or the command reads."""

    sql: str
    columns: tuple[str, ...]


class FindConditions(msgspec.Struct, frozen=True):
    """Conditions, all of which have to hold; an answer must overlap the period since 1970."""

    robots: Collection[str] | None = None
    reason: str | None = None
    operator: str | None = None
    since_ns: int = 0
    until_ns: int = NEVER_NS


_ALWAYS: Final = ("file", "is_covered", "names", "faults", "start_ns")

_MOMENTS: Final = Search(
    """
    WITH moment AS (
      SELECT file, start_ns AS log_ns, unnest(moments, max_depth := 2) FROM catalog WHERE NOT is_covered
    )
    SELECT arg_min(file, log_ns) AS file, * EXCLUDE (file, log_ns) FROM moment
    WHERE CASE $search WHEN 'stops' THEN is_stop WHEN 'incidents' THEN kind = 'incident' ELSE true END
      AND last_ns >= $since_ns AND time_ns < $until_ns
      AND ($robots IS NULL OR list_contains($robots, robot))
      AND ($reason IS NULL OR reason = $reason)
      AND ($operator IS NULL OR operator = $operator OR holder = $operator)
    GROUP BY ALL ORDER BY time_ns, robot, kind, text
    """,
    (*_ALWAYS, "moments"),
)
"""Moments; duplicates in several logs once, from the log that begins first."""

_DRIVES: Final = Search(
    """
    WITH drive AS (
      SELECT file, start_ns AS log_ns, operators, moments, unnest(drives, max_depth := 2)
      FROM catalog WHERE NOT is_covered
    )
    SELECT arg_min(file, log_ns) AS file, * EXCLUDE (file, log_ns, operators, moments) FROM drive
    WHERE end_ns >= $since_ns AND start_ns < $until_ns
      AND ($robots IS NULL OR list_contains($robots, robot))
      AND ($reason IS NULL OR EXISTS (
        SELECT 1 FROM (SELECT unnest(moments) AS one)
        WHERE one.is_stop AND one.reason = $reason AND one.robot = drive.robot
          AND one.time_ns BETWEEN drive.start_ns AND drive.end_ns))
      AND ($operator IS NULL OR EXISTS (
        SELECT 1 FROM (SELECT unnest(operators) AS one) WHERE one.name = $operator AND one.robot = drive.robot))
    GROUP BY ALL ORDER BY start_ns, robot
    """,
    (*_ALWAYS, "operators", "moments", "drives"),
)
"""Drives. An operator has driven the robot in the same log."""

_LOGS: Final = Search(
    """
    SELECT * FROM catalog
    WHERE NOT is_covered AND end_ns >= $since_ns AND start_ns < $until_ns
      AND ($robots IS NULL OR list_has_any(names, $robots))
      AND ($reason IS NULL OR list_contains(map_keys(stops), $reason))
      AND ($operator IS NULL OR EXISTS (
        SELECT 1 FROM (SELECT unnest(operators) AS one) WHERE one.name = $operator))
    ORDER BY start_ns, file
    """,
    tuple(name for name in SCHEMA.names if name != "moments"),
)
"""Logs without their moments, of which there may be thousands."""

SEARCHES: Final[Mapping[str, Search]] = {
    "stops": _MOMENTS,
    "incidents": _MOMENTS,
    "events": _MOMENTS,
    "drives": _DRIVES,
    "logs": _LOGS,
}


def find(
    rows: pa.Table,
    search: str,
    conditions: FindConditions,
    newest: int | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> list[dict[str, Any]]:
    """The answers in order of time, as JSON objects. CommandError, or KeyboardInterrupt if stopped."""
    sql = SEARCHES[search].sql
    values = {"search": search, **msgspec.structs.asdict(conditions)}
    if conditions.robots is not None:
        values["robots"] = sorted(conditions.robots)
    bound = {name: value for name, value in values.items() if f"${name}" in sql}
    found: deque[dict[str, Any]] = deque(maxlen=newest)
    with answer(CatalogSource(rows), sql, stopped, parameters=bound) as batches:
        for batch in batches or ():
            found.extend(objects(batch))
    return list(found)
