"""Tables, and what they are called. Our own subjects have their names, whether a log holds them or not."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache
from typing import Final

import msgspec
import pyarrow as pa
from mcap import records

from recorder.encoding.protobuf_schema import descriptor_set, schema_name
from recorder.encoding.routes import Route
from recorder.reading.topics import topic_of
from recorder.review.columns.tables import ROBOT, TOPIC, Columns, columns_of
from recorder.review.export.manifest import Column
from schemas import keys
from schemas.messages import RawSample
from schemas.subjects import RECORDER_SUBJECTS, SUBJECTS

WHOSE: Final = (pa.field(ROBOT, pa.string()), pa.field(TOPIC, pa.string()))
"""The first columns of each table."""


class TableInfo(msgspec.Struct, frozen=True):
    """A table.

    Attributes:
        topics: those whose messages it holds.
    """

    name: str
    topics: list[str]
    columns: list[Column]


@cache
def own_columns() -> dict[str, Columns]:
    """The columns of our own subjects, by the names of their tables."""
    kinds: list[tuple[str, type[msgspec.Struct]]] = [("x", RawSample)]
    for subject in SUBJECTS:
        bus = "can0" if "{bus}" in subject.name else ""
        kinds.append((keys.build("x", "x", subject, bus), Route(0, subject, "").kind))
    kinds += [(keys.of_recorder("x", "x", one.name), Route(0, one, "").kind) for one in RECORDER_SUBJECTS]
    found = {}
    for topic, kind in kinds:
        channel = records.Channel(0, topic, "protobuf", {}, 1)
        schema = records.Schema(1, descriptor_set(kind), "protobuf", schema_name(kind))
        columns = columns_of(topic_of(channel, schema))
        found[columns.table] = columns
    return found


def free_name(name: str, taken: Collection[str]) -> str:
    """The name, or the first of ``name_2``, ``name_3``, ... that is free."""
    free, number = name, 1
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


def shown(columns: Sequence[Column]) -> list[Column]:
    """Columns as people see them: an enumeration is a text all the same."""
    return [
        msgspec.structs.replace(one, type="string") if one.type.startswith("dictionary<") else one
        for one in columns
    ]
