"""The columns of a topic: what every table begins with, then the fields of the message.

A topic that nobody here can read has one column of what its messages are: ``json`` as text, else ``data`` as
bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import msgspec
import pyarrow as pa

from recorder.encoding.protobuf_schema import message_class
from recorder.reading.topic_names import place_of, table_of
from recorder.reading.topics import Topic, foreign_class
from recorder.review.columns.shape import Field, fields_of, own_fields

TIME_TYPE: Final = pa.timestamp("ns", "UTC")
TIME_MAX_NS: Final = 2**63 - 1
"""The last time that Arrow can hold."""

LOG_TIME, PUBLISH_TIME, SEQUENCE, ROBOT, TOPIC = "log_time", "publish_time", "sequence", "robot", "topic"

HEAD: Final = (
    pa.field(LOG_TIME, TIME_TYPE, nullable=False),
    pa.field(PUBLISH_TIME, TIME_TYPE, nullable=False),
    pa.field(SEQUENCE, pa.int64(), nullable=False),
)
"""The first columns of every table: time of receipt, the source's time, and the source's count."""

RESERVED: Final = frozenset({LOG_TIME, PUBLISH_TIME, SEQUENCE, ROBOT, TOPIC, "date"})
"""Names that no field may have, for a dataset's directories are columns too."""

FIELD_PREFIX: Final = "message_"
"""Before the name of a field that a column has already."""

UNIT_KEY: Final = b"unit"


class Columns(msgspec.Struct, frozen=True, eq=False):
    """The columns of a topic's table.

    Attributes:
        topic: the topic.
        table: its name in SQL: ``chassis_drive``, ``can_rx``.
        place: the topic without root and robot, if it is a key of ours: ``chassis/drive``, ``can/can0/rx``.
        robot: the robot's name; empty if it is no robot's.
        schema: of the record batches; a field with a unit has it as metadata.
        read: a message's bytes to one of the protobuf package; None if it is no protobuf.
        fields: of such a message, those that are columns.
    """

    topic: Topic
    table: str
    place: str
    robot: str
    schema: pa.Schema
    read: Callable[[bytes], Any] | None
    fields: tuple[Field, ...] | None


def columns_of(topic: Topic) -> Columns:
    """The columns of a topic."""
    place, robot = place_of(topic)
    columns = list(HEAD)
    read, fields = _protobuf(topic)
    if fields is not None:
        taken = set(RESERVED)
        columns += [_column(field, taken) for field in fields]
    elif topic.encoding == "json":
        columns.append(pa.field("json", pa.string()))
    else:
        columns.append(pa.field("data", pa.binary()))
    return Columns(topic, table_of(topic), place, robot, pa.schema(columns), read, fields)


def _column(field: Field, taken: set[str]) -> pa.Field:
    name = field.name
    # SQL does not tell upper case from lower.
    while name.lower() in taken:
        name = FIELD_PREFIX + name
    taken.add(name.lower())
    return pa.field(name, field.type, metadata={UNIT_KEY: field.unit.encode()} if field.unit else None)


def _protobuf(topic: Topic) -> tuple[Callable[[bytes], Any] | None, tuple[Field, ...] | None]:
    """Return a topic's decoder and fields; None twice if no decoder is known."""
    if topic.kind is not None:
        # The sequence of a message of ours is that of its record.
        fields = tuple(field for field in own_fields(topic.kind) if field.name != SEQUENCE)
        return message_class(topic.kind).FromString, fields
    found = foreign_class(topic.schema, topic.schema_data) if topic.encoding == "protobuf" else None
    if found is None:
        return None, None
    try:
        foreign = fields_of(found.DESCRIPTOR)
    except TypeError:
        return None, None
    return (found.FromString, foreign) if foreign else (None, None)
