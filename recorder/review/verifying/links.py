"""The MessagePack bytes of a sample, out of its record in a log: what the gateway published, and what was chained.

A log holds protobuf. The same message, encoded again, gives the same bytes: of the fields that the log's schema
has, in their order, for a class gets new fields at its end alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import msgspec
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError

from recorder.reading.topics import Topic
from schemas import codec

LinkEncoder = Callable[[Any], bytes]
"""A message of a log to the bytes that were published."""


def link_encoder(topic: Topic) -> LinkEncoder | None:
    """The encoder of a topic; None if its messages have fields that are not known here."""
    if topic.kind is None:
        return None
    known = topic.kind.__struct_fields__
    logged = _fields_of(topic)
    if logged == known:
        return codec.encode
    if not logged or logged != known[: len(logged)]:
        return None
    return lambda message: _ENCODER.encode({name: getattr(message, name) for name in logged})


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
