"""The columns of a topic: what every table begins with, then the fields of the message.

A topic that nobody here can read has one column of what its messages are: ``json`` as text, else ``data`` as
bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import msgspec
import pyarrow as pa
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from recorder.reading.topic_names import place_of, table_of
from recorder.reading.topics import UNREADABLE, Topic
from recorder.review.columns.shape import Field, Shape, message_of, own_shape, shape_of

TIME_TYPE: Final = pa.timestamp("ns", "UTC")
LOG_TIME, PUBLISH_TIME, SEQUENCE, ROBOT, TOPIC = "log_time", "publish_time", "sequence", "robot", "topic"

HEAD: Final = (
    pa.field(LOG_TIME, TIME_TYPE, nullable=False),
    pa.field(PUBLISH_TIME, TIME_TYPE, nullable=False),
    pa.field(SEQUENCE, pa.int64(), nullable=False),
)
"""What every table begins with: when the recorder received it, when its source says it was, the source's count."""

RESERVED: Final = frozenset({LOG_TIME, PUBLISH_TIME, SEQUENCE, ROBOT, TOPIC, "date"})
"""Names that no field may have, for a dataset's directories are columns too."""

FIELD_PREFIX: Final = "message_"
"""Before the name of a field that a column has already."""

UNIT_KEY: Final = b"unit"


class Columns(msgspec.Struct, frozen=True, eq=False):
    """The columns of a topic's table.

    Attributes:
        topic: the topic.
        table: what the table is called in SQL: ``chassis_drive``, ``can_rx``.
        place: the topic without root and robot, if it is a key of ours: ``chassis/drive``, ``can/can0/rx``.
        robot: the robot's name; empty if it is no robot's.
        schema: of the record batches; a field with a unit has it as metadata.
        read: a message's bytes to one of the protobuf package; None if it is no protobuf.
        shape: of such a message.
        kept: which of the shape's fields are columns.
    """

    topic: Topic
    table: str
    place: str
    robot: str
    schema: pa.Schema
    read: Callable[[bytes], Any] | None
    shape: Shape | None
    kept: tuple[int, ...]


def columns_of(topic: Topic) -> Columns:
    """The columns of a topic."""
    place, robot = place_of(topic)
    read, shape = _shape(topic)
    fields = list(HEAD)
    kept: tuple[int, ...] = ()
    if shape is not None:
        # The sequence of a message of ours is that of its record.
        kept = tuple(
            number
            for number, field in enumerate(shape.fields)
            if not (topic.kind is not None and field.name == SEQUENCE)
        )
        taken = set(RESERVED)
        fields += [_column(shape.fields[number], taken) for number in kept]
    elif topic.encoding == "json":
        fields.append(pa.field("json", pa.string()))
    else:
        fields.append(pa.field("data", pa.binary()))
    return Columns(topic, table_of(topic), place, robot, pa.schema(fields), read, shape, kept)


def shown(field: Field, stored: pa.Array) -> pa.Array:
    """A column of the type that it is shown in: the places of an enumeration become its names."""
    return stored if stored.type == field.shown else _shown(field, stored, field.shown)


def _shown(field: Field, stored: pa.Array, kind: pa.DataType) -> pa.Array:
    if field.is_map:
        # Only the values can be anything else than what they are.
        value = message_of(field).fields[1]
        return pa.MapArray.from_arrays(stored.offsets, stored.keys, shown(value, stored.items))
    if pa.types.is_list(stored.type):
        return pa.ListArray.from_arrays(stored.offsets, _shown(field, stored.values, kind.value_type))
    if field.names is not None:
        return field.names.named(stored) if pa.types.is_dictionary(kind) else field.names.spelled(stored)
    children = [shown(one, stored.field(place)) for place, one in enumerate(message_of(field).fields)]
    absent = stored.is_null() if stored.null_count else None
    return pa.StructArray.from_arrays(children, fields=list(kind), mask=absent)


def _column(field: Field, taken: set[str]) -> pa.Field:
    name = field.name
    # SQL does not tell upper case from lower.
    while name.lower() in taken:
        name = FIELD_PREFIX + name
    taken.add(name.lower())
    return pa.field(name, field.shown, metadata={UNIT_KEY: field.unit.encode()} if field.unit else None)


def _shape(topic: Topic) -> tuple[Callable[[bytes], Any] | None, Shape | None]:
    if topic.kind is not None:
        read, shape = own_shape(topic.kind)
        return read.FromString, shape
    if topic.encoding != "protobuf":
        return None, None
    pool = DescriptorPool()
    try:
        files = FileDescriptorSet.FromString(topic.schema_data).file
        for file in files:
            pool.Add(file)
        descriptor = pool.FindMessageTypeByName(topic.schema)
        shape = shape_of(descriptor)
        if not shape.fields:
            return None, None
        # Other dialects have defaults of their own, and groups.
        is_simple = shape.is_simple and all(file.syntax == "proto3" for file in files)
        return GetMessageClass(descriptor).FromString, msgspec.structs.replace(shape, is_simple=is_simple)
    except UNREADABLE:
        return None, None
