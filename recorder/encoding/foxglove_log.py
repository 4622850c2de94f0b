"""Events as ``foxglove.Log``, which viewers list as a log: beside their typed form, on ``{key}/log``. Pure.

The schema is Foxglove's in protobuf (https://docs.foxglove.dev/docs/visualization/message-schemas/log): fields and
numbers as published there.
"""

from __future__ import annotations

from typing import Any, Final

from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from schemas.command_line import short
from schemas.decisions import SafetyEvent, Severity
from schemas.recording import RecorderEvent

SCHEMA_NAME: Final = "foxglove.Log"

LOG_CHUNK: Final = "log"
"""The last chunk of the topic."""

LEVELS: Final = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")

_LEVEL_OF: Final = {
    Severity.INFO: LEVELS.index("INFO"),
    Severity.WARNING: LEVELS.index("WARNING"),
    Severity.ERROR: LEVELS.index("ERROR"),
}

_TIMESTAMP: Final = FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)


def _file() -> FileDescriptorProto:
    file = FileDescriptorProto(
        name="foxglove/Log.proto", package="foxglove", syntax="proto3", dependency=[_TIMESTAMP.name]
    )
    message = file.message_type.add(name="Log")
    level = message.enum_type.add(name="Level")
    for number, name in enumerate(LEVELS):
        level.value.add(name=name, number=number)
    kind = FieldDescriptorProto
    for number, (name, field_type, type_name) in enumerate(
        (
            ("timestamp", kind.TYPE_MESSAGE, ".google.protobuf.Timestamp"),
            ("level", kind.TYPE_ENUM, ".foxglove.Log.Level"),
            ("message", kind.TYPE_STRING, ""),
            ("name", kind.TYPE_STRING, ""),
            ("file", kind.TYPE_STRING, ""),
            ("line", kind.TYPE_FIXED32, ""),
        ),
        start=1,
    ):
        field = message.field.add(name=name, number=number, label=kind.LABEL_OPTIONAL, type=field_type)
        if type_name:
            field.type_name = type_name
    return file


_FILES: Final = (_TIMESTAMP, _file())

SCHEMA_DATA: Final = FileDescriptorSet(file=_FILES).SerializeToString(deterministic=True)
"""The serialised descriptor set."""


def _message_class() -> Any:  # noqa: ANN401 - protobuf makes the class at run time
    pool = DescriptorPool()
    for file in _FILES:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(SCHEMA_NAME))


_Log: Final = _message_class()


def log_record(event: SafetyEvent | RecorderEvent, name: str) -> bytes:
    """An event as a line of a log, cut to what a line holds; ``name`` is who says it."""
    operator = f" ({short(event.operator)})" if event.operator else ""
    text = f"{event.kind.value}: {short(event.text)}{operator}"
    line = _Log(level=_LEVEL_OF.get(event.severity, LEVELS.index("UNKNOWN")), message=text, name=name)
    line.timestamp.seconds, line.timestamp.nanos = divmod(event.time_ns, 1_000_000_000)
    data: bytes = line.SerializeToString()
    return data
