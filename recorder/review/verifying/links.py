"""The MessagePack bytes of a sample, out of its record in a log: what the gateway published, and what was chained.

A log holds protobuf. The same message, encoded again, gives the same bytes: of the fields that the log's schema
has, in their order, for a class gets new fields at its end alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import msgspec
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError, Message

from recorder.encoding.protobuf_schema import descriptor_set, message_class
from recorder.reading.topics import Topic, foreign_class
from schemas import codec


class LinkReader(msgspec.Struct, frozen=True):
    """Reads the records of a topic as links of a chain.

    Attributes:
        encode: a message to the bytes that were published.
        hides: whether a record holds fields that the log's schema or this version does not have. What a viewer
            shows by the schema would be other than what is verified, or the reverse.
    """

    encode: Callable[[Any], bytes]
    hides: Callable[[bytes], bool]


def link_reader(topic: Topic) -> LinkReader | None:
    """The reader of a topic; None if its schema cannot be read, or has fields that are not known here."""
    if topic.kind is None:
        return None
    known = topic.kind.__struct_fields__
    if topic.schema_data == descriptor_set(topic.kind):
        return LinkReader(codec.encode, _hides(message_class(topic.kind)))
    logged = _fields_of(topic)
    viewed = foreign_class(topic.schema, topic.schema_data)
    if viewed is None or not logged or logged != known[: len(logged)]:
        return None
    return LinkReader(
        lambda message: _ENCODER.encode({name: getattr(message, name) for name in logged}),
        _hides(message_class(topic.kind), viewed),
    )


def _hides(*kinds: type[Any]) -> Callable[[bytes], bool]:
    return lambda data: any(_has_unknown(kind.FromString(data)) for kind in kinds)


def _has_unknown(message: Message) -> bool:
    length = message.ByteSize()
    message.DiscardUnknownFields()
    return message.ByteSize() != length


def _fields_of(topic: Topic) -> tuple[str, ...]:
    """The names of a topic's fields, by the schema in the log; empty if that cannot be read."""
    try:
        files = FileDescriptorSet.FromString(topic.schema_data).file
    except DecodeError:
        return ()
    for file in files:
        for message in file.message_type:
            if f"{file.package}.{message.name}" == topic.schema:
                return tuple(field.name for field in sorted(message.field, key=lambda one: one.number))
    return ()


_ENCODER: Final = msgspec.msgpack.Encoder()
