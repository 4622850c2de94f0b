"""Paths of a topic's rows in a dataset: ``topic=.../robot=.../date=YYYY-MM-DD``, as Hive names directories.

Of a key of ours the topic is what follows the robot, so that all robots' rows of one kind are below one directory.
Whatever may not stand in a directory's name is escaped as in a URL, and comes back when it is read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Final
from urllib.parse import quote

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from recorder.review.columns.tables import LOG_TIME, Columns

NOBODY: Final = "__HIVE_DEFAULT_PARTITION__"
"""Hive's name for no value."""

_NAME_MAX: Final = 200
"""A name may have 255 bytes on most file systems."""


def directory_of(columns: Columns, date: str) -> str:
    """The directory of a topic's rows of a day, within the dataset."""
    return f"topic={escaped(columns.place)}/robot={escaped(columns.robot)}/date={date}"


def escaped(text: str) -> str:
    """A text as a part of a directory's name. One that is too long is cut, and ends in a hash of all of it."""
    if not text:
        return NOBODY
    name = quote(text, safe="@ ", errors="replace")
    if len(name) <= _NAME_MAX:
        return name
    digest = hashlib.sha256(text.encode(errors="replace")).hexdigest()[:16]
    return f"{name[:_NAME_MAX].rpartition('%')[0] or name[:_NAME_MAX]}~{digest}"


def by_date(rows: pa.RecordBatch) -> Iterator[tuple[str, pa.RecordBatch]]:
    """The rows of each day, by their log times."""
    days = np.asarray(rows.column(LOG_TIME).cast(pa.int64())).astype("M8[ns]").astype("M8[D]")
    if days.min() == days.max():
        yield str(days[0]), rows
        return
    for day in np.unique(days):
        yield str(day), rows.filter(pa.array(days == day))


def bounds_ns(rows: pa.RecordBatch) -> tuple[int, int]:
    """The earliest and the latest log time."""
    found = pc.min_max(rows.column(LOG_TIME).cast(pa.int64()))
    return found["min"].as_py(), found["max"].as_py()
