"""Topics of a log and their decoders, also for logs of other versions.

New fields and values are added at the end, so an older log has fewer and a newer one more. If a number means
something else, messages are read by the log's own schema.

Our messages become classes of ``schemas``, other protobuf a protobuf message, JSON what ``json`` makes of it; for
any other encoding there is no decoder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from enum import Enum
from functools import cache, lru_cache
from graphlib import TopologicalSorter
from importlib import import_module
from typing import Any, Final

import msgspec
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from mcap import records
from msgspec import inspect

from recorder.encoding.protobuf import LOGGED, descriptor_set, fields, message_class, optional_part, schema_name
from recorder.mcap.summary_reader import LogSummary
from schemas import keys
from schemas.can_word import snake_case
from schemas.codec import member_of
from schemas.recording import LOG_CHUNK, OUTLINE_CHUNK, RAW_CHUNK, TRANSFORM_CHUNK

RENAMED: Final = {"REASON_TICK_UNKNOWN": "REASON_CHALLENGE_UNKNOWN"}
"""Values of enumerations with another name in older logs."""

PROTO3: Final = "proto3"
"""The syntax of our schemas. In another one a missing field may have any value."""

_KEPT: Final = 256


@lru_cache(_KEPT)
def means_the_same(kind: type[msgspec.Struct], descriptors: bytes) -> bool:
    """True if the common part of a log's schema and this version's means the same."""
    if descriptors == descriptor_set(kind):
        return True
    try:
        theirs = FileDescriptorSet.FromString(descriptors)
    except DecodeError:
        return False
    files = FileDescriptorSet.FromString(descriptor_set(kind)).file
    messages = {name: one for file in files for name, one in _by_name(file.package, file.message_type)}
    enums = {(file.package, one.name): one for file in files for one in file.enum_type}
    # All of theirs: a schema may hold a message that fits beside another one of its name.
    return (
        all(file.syntax == PROTO3 and not file.extension for file in theirs.file)
        and all(
            name not in messages or _fits(messages[name], one)
            for file in theirs.file
            for name, one in _by_name(file.package, file.message_type)
        )
        and all(
            (file.package, one.name) not in enums or _numbers_fit(enums[file.package, one.name], one)
            for file in theirs.file
            for one in file.enum_type
        )
    )


@lru_cache(_KEPT)
def newer_members(kind: type[Enum], descriptors: bytes) -> tuple[Enum, ...]:
    """Members for the additional values of an enumeration in a log's schema, in order."""
    prefix = f"{snake_case(kind.__name__).upper()}_"
    words = [
        value.name.removeprefix(prefix).lower()
        for file in FileDescriptorSet.FromString(descriptors).file
        for enum in file.enum_type
        if enum.name == kind.__name__
        for value in sorted(enum.value, key=lambda one: one.number)[len(kind) :]
    ]
    members = [member_of(kind, word) for word in words]
    return tuple(member for member in members if member is not None)


def _by_name(package: str, messages: Iterable[DescriptorProto]) -> Iterable[tuple[str, DescriptorProto]]:
    for one in messages:
        name = f"{package}.{one.name}"
        yield name, one
        yield from _by_name(name, one.nested_type)


def _fits(ours: DescriptorProto, theirs: DescriptorProto) -> bool:
    """True if common fields have equal descriptors."""
    mine = {one.number: one for one in ours.field}
    numbers = {one.name: one.number for one in ours.field}
    return theirs.options == ours.options and all(
        mine.get(one.number, one) == one and numbers.get(one.name, one.number) == one.number
        for one in theirs.field
    )


def _numbers_fit(ours: EnumDescriptorProto, theirs: EnumDescriptorProto) -> bool:
    names = {one.number: one.name for one in ours.value}
    numbers = {one.name: one.number for one in ours.value}
    counted = sorted(one.number for one in theirs.value) == list(range(len(theirs.value)))
    return counted and all(
        names.get(one.number, name) == name and numbers.get(name, one.number) == one.number
        for one in theirs.value
        for name in (RENAMED.get(one.name, one.name),)
    )


UNREADABLE: Final = (DecodeError, ValueError, TypeError, KeyError, IndexError, RecursionError)
"""The exceptions of decoding bytes that are no message of the expected type."""

Decode = Callable[[bytes], Any]

DECODERS_KEPT: Final = 256

_SIDE_CHUNKS: Final = (LOG_CHUNK, TRANSFORM_CHUNK, OUTLINE_CHUNK, RAW_CHUNK)
"""The last chunks of topics beside the topic of a key."""

_BY_SCHEMA: Final = {schema_name(kind): kind for kind in LOGGED}


class Topic(msgspec.Struct, frozen=True, eq=False):
    """A channel of a log.

    Attributes:
        name: the channel's topic; in a log of ours the Zenoh key.
        schema: the schema's name; empty without a schema.
        encoding: of the messages, by MCAP's registry: ``protobuf``, ``json``, ``cdr``, ...
        kind: the class of our messages, of any version; else None.
        robot: the robot's name if the topic is a key of ours, with its root if several robots share the name; else
            empty.
        owner: the same, but also for a topic beside that of a key.
        subject: the name in the table of subjects; empty if the topic is no key.
        decode: decodes a message, or raises one of UNREADABLE; None without a decoder.
    """

    name: str
    schema: str
    encoding: str
    schema_encoding: str
    schema_data: bytes
    kind: type[msgspec.Struct] | None
    robot: str
    owner: str
    subject: str
    decode: Decode | None
    metadata: dict[str, str] = {}


def topic_of(
    channel: records.Channel, schema: records.Schema | None, namesakes: frozenset[str] = frozenset()
) -> Topic:
    name = "" if schema is None else schema.name
    is_protobuf = channel.message_encoding == "protobuf"
    kind = _BY_SCHEMA.get(name) if is_protobuf else None
    parts = keys.parse(channel.topic)
    of_key = parts or keys.parse(key_of(channel.topic)[0])
    decode: Decode | None = None
    if kind is not None and (schema is None or not means_the_same(kind, schema.data)):
        kind = None
    if kind is not None and schema is not None:
        decode = typed_decoder(kind, schema.data if schema.data != descriptor_set(kind) else b"")
    elif is_protobuf and schema is not None:
        decode = foreign_decoder(name, schema.data)
    elif channel.message_encoding == "json":
        decode = json.loads
    return Topic(
        name=channel.topic,
        schema=name,
        encoding=channel.message_encoding,
        schema_encoding="" if schema is None else schema.encoding,
        schema_data=b"" if schema is None else schema.data,
        kind=kind,
        robot="" if parts is None else robot_of(parts, namesakes),
        owner="" if of_key is None else robot_of(of_key, namesakes),
        subject="" if parts is None else parts.subject.name,
        decode=decode,
        metadata=channel.metadata,
    )


class Declared:
    """The topics of a log by channel id, as far as its records have declared them."""

    def __init__(self, namesakes: frozenset[str] = frozenset()) -> None:
        self.topics: dict[int, Topic] = {}
        self._schemas: dict[int, records.Schema] = {}
        self._namesakes = namesakes

    def take(self, record: records.Schema | records.Channel) -> list[tuple[int, Topic]]:
        """Add a record. Returns channel id and topic if they are new."""
        if isinstance(record, records.Schema):
            self._schemas.setdefault(record.id, record)
            return []
        if record.id in self.topics:
            return []
        topic = topic_of(record, self._schemas.get(record.schema_id), self._namesakes)
        self.topics[record.id] = topic
        return [(record.id, topic)]

    def take_summary(self, summary: LogSummary | None) -> list[tuple[int, Topic]]:
        """Add the records of the summary: other writers may declare channels only within chunks."""
        if summary is None:
            return []
        found: list[records.Schema | records.Channel] = [*summary.schemas.values(), *summary.channels.values()]
        return [new for one in found for new in self.take(one)]


def key_of(topic: str) -> tuple[str, str]:
    """The key of a topic, and its suffix: empty, ``/log``, ``/@raw``, ..."""
    key, _, last = topic.rpartition("/")
    return (key, f"/{last}") if last in _SIDE_CHUNKS else (topic, "")


def robot_of(parts: keys.KeyParts, namesakes: frozenset[str]) -> str:
    """The name of a key's robot, with its root if robots of other roots share the name."""
    return f"{parts.root}/{parts.robot}" if parts.robot in namesakes else parts.robot


@lru_cache(DECODERS_KEPT)
def typed_decoder(kind: type[msgspec.Struct], descriptors: bytes = b"") -> Decode:
    """The decoder of protobuf bytes into a class; missing fields have protobuf's defaults.

    ``descriptors``: the schema of another version, whose enumerations may have more values.
    """
    read: Any = message_class(kind).FromString
    build = _builder(kind, descriptors)
    return lambda data: build(read(data))


def _builder(kind: type[msgspec.Struct], descriptors: bytes) -> Callable[[Any], Any]:
    names: dict[str, Any] = {"Kind": kind}
    parts = [_expression(name, field, names, descriptors) for name, _, field in fields(kind)]
    source = f"lambda m: Kind({', '.join(parts)})"
    return eval(source, names)  # type: ignore[no-any-return]  # noqa: S307 - the source is made here, of our own classes


def _expression(name: str, field: inspect.Type, names: dict[str, Any], descriptors: bytes) -> str:
    inner = optional_part(field)
    if inner is not None:
        return f"{_converted(f'm.{name}', name, inner, names, descriptors)} if m.HasField({name!r}) else None"
    if isinstance(field, inspect.ListType):
        one = _converted("one", name, field.item_type, names, descriptors)
        return f"list(m.{name})" if one == "one" else f"[{one} for one in m.{name}]"
    if isinstance(field, inspect.DictType):
        return f"dict(m.{name})"
    return _converted(f"m.{name}", name, field, names, descriptors)


def _converted(value: str, name: str, field: inspect.Type, names: dict[str, Any], descriptors: bytes) -> str:
    if isinstance(field, inspect.EnumType):
        # A dictionary: in a list a negative number would find another member.
        names[f"of_{name}"] = dict(enumerate([*field.cls, *newer_members(field.cls, descriptors)]))
        return f"of_{name}[{value}]"
    if isinstance(field, inspect.StructType):
        names[f"of_{name}"] = _builder(field.cls, descriptors)
        return f"of_{name}({value})"
    return value


@cache
def _well_known() -> dict[str, FileDescriptorProto]:
    """The files of protobuf's well-known types by name."""
    kinds = ("any", "duration", "empty", "field_mask", "struct", "timestamp", "wrappers")
    modules = (import_module(f"google.protobuf.{kind}_pb2") for kind in kinds)
    files = (FileDescriptorProto.FromString(module.DESCRIPTOR.serialized_pb) for module in modules)
    return {file.name: file for file in files}


def foreign_decoder(name: str, descriptors: bytes) -> Decode | None:
    """The decoder by the log's descriptor set; None if that is unusable."""
    found = foreign_class(name, descriptors)
    return None if found is None else found.FromString


def foreign_class(name: str, descriptors: bytes) -> Any:  # noqa: ANN401 - protobuf makes the class at run time
    """The protobuf class by the log's descriptor set; None if that is unusable."""
    pool = DescriptorPool()
    try:
        files = {file.name: file for file in FileDescriptorSet.FromString(descriptors).file}
        # Other writers use any order, and leave the well-known files out.
        if any(needed not in files for file in files.values() for needed in file.dependency):
            files = _well_known() | files
        for file_name in TopologicalSorter({file.name: file.dependency for file in files.values()}).static_order():
            pool.Add(files[file_name])
        return GetMessageClass(pool.FindMessageTypeByName(name))
    except UNREADABLE:
        return None
