"""The typed messages as protobuf descriptors, built at run time from the message classes.

Every message and enumeration is a file of its own, so that the descriptor set of a channel holds what that
channel needs and nothing else. Field numbers are positions in the class, from 1: a new field goes to the end.

Numbers are fixed-width: an encoder then packs all of them in one call. Enumerations keep their order, so what one
begins with is protobuf's 0: ``UNDEFINED``, ``UNKNOWN`` or ``NONE`` wherever there may be nothing to say.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from functools import cache
from typing import Final, TypeAlias

import msgspec
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message as ProtobufMessage
from google.protobuf.message_factory import GetMessageClass
from msgspec import inspect

from schemas import messages
from schemas.can_word import snake_case
from schemas.subjects import ALL_SUBJECTS, SCHEMA_PREFIX

INT32_MIN: Final = -(2**31)
INT32_MAX: Final = 2**31 - 1
UINT32_MAX: Final = 2**32 - 1

LOGGED: Final[tuple[type[msgspec.Struct], ...]] = (
    *(subject.type for subject in ALL_SUBJECTS),
    messages.CanFrame,
    messages.RawSample,
)
"""Every class that may be a record in a log."""

_Field = FieldDescriptorProto
FieldType: TypeAlias = FieldDescriptorProto.Type.ValueType


def number_type(kind: inspect.IntType) -> FieldType:
    """The narrowest fixed-width type that holds every number between the bounds."""
    low = INT32_MIN - 1 if kind.ge is None else kind.ge
    high = UINT32_MAX + 1 if kind.le is None else kind.le
    if low >= 0:
        return _Field.TYPE_FIXED32 if high <= UINT32_MAX else _Field.TYPE_FIXED64
    narrow = low >= INT32_MIN and high <= INT32_MAX
    return _Field.TYPE_SFIXED32 if narrow else _Field.TYPE_SFIXED64


def fields(kind: type[msgspec.Struct]) -> Iterator[tuple[str, int, inspect.Type]]:
    """Name, protobuf number and type of each field of a message class."""
    info = inspect.type_info(kind)
    if not isinstance(info, inspect.StructType):
        raise TypeError(f"{kind} is not a struct")
    for number, member in enumerate(info.fields, start=1):
        yield member.name, number, _plain(member.type)


def _plain(kind: inspect.Type) -> inspect.Type:
    """The type without the descriptions and units that are wrapped around it, at any depth."""
    if isinstance(kind, inspect.Metadata):
        return _plain(kind.type)
    if isinstance(kind, inspect.ListType):
        return inspect.ListType(_plain(kind.item_type))
    if isinstance(kind, inspect.DictType):
        return inspect.DictType(_plain(kind.key_type), _plain(kind.value_type))
    if isinstance(kind, inspect.UnionType):
        return inspect.UnionType(tuple(map(_plain, kind.types)))
    return kind


def optional_part(kind: inspect.Type) -> inspect.Type | None:
    """Return the ``X`` of ``X | None``; None if the type is no union. Raises TypeError for any other union."""
    if not isinstance(kind, inspect.UnionType):
        return None
    parts = [part for part in kind.types if not isinstance(part, inspect.NoneType)]
    if len(parts) != 1 or len(kind.types) != 2:
        raise TypeError(f"protobuf has no counterpart of {kind}")
    return parts[0]


def _file_name(kind: type) -> str:
    return f"{SCHEMA_PREFIX}/{kind.__name__}.proto"


def _type_name(kind: type) -> str:
    return f".{SCHEMA_PREFIX}.{kind.__name__}"


def _enum_prefix(kind: type[Enum]) -> str:
    # The names of an enumeration's values belong to the package in protobuf, so they carry the enumeration's.
    return snake_case(kind.__name__).upper()


class _Files:
    """The files of the classes seen so far, each after those that it needs."""

    def __init__(self) -> None:
        self.by_class: dict[type, FileDescriptorProto] = {}

    def add_struct(self, kind: type[msgspec.Struct]) -> None:
        if kind in self.by_class:
            return
        file = FileDescriptorProto(name=_file_name(kind), package=SCHEMA_PREFIX, syntax="proto3")
        message = file.message_type.add(name=kind.__name__)
        needed: set[type] = set()
        for name, number, field_type in fields(kind):
            self._add_field(message, name, number, field_type, needed)
        file.dependency.extend(sorted(_file_name(other) for other in needed))
        self.by_class[kind] = file

    def _add_enum(self, kind: type[Enum]) -> None:
        if kind in self.by_class:
            return
        file = FileDescriptorProto(name=_file_name(kind), package=SCHEMA_PREFIX, syntax="proto3")
        enum: EnumDescriptorProto = file.enum_type.add(name=kind.__name__)
        for number, member in enumerate(kind):
            enum.value.add(name=f"{_enum_prefix(kind)}_{member.name}", number=number)
        self.by_class[kind] = file

    def _add_field(
        self, message: DescriptorProto, name: str, number: int, kind: inspect.Type, needed: set[type]
    ) -> None:
        field = message.field.add(name=name, number=number, label=_Field.LABEL_OPTIONAL)
        inner = optional_part(kind)
        if inner is not None:
            # How proto3 says `optional`: a oneof of this field alone.
            field.proto3_optional = True
            field.oneof_index = len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{name}")
            kind = inner
        if isinstance(kind, inspect.ListType):
            field.label = _Field.LABEL_REPEATED
            kind = kind.item_type
        if isinstance(kind, inspect.DictType):
            entry = message.nested_type.add(name=f"{name.title().replace('_', '')}Entry")
            entry.options.map_entry = True
            self._add_field(entry, "key", 1, kind.key_type, needed)
            self._add_field(entry, "value", 2, kind.value_type, needed)
            field.label = _Field.LABEL_REPEATED
            field.type = _Field.TYPE_MESSAGE
            field.type_name = f".{SCHEMA_PREFIX}.{message.name}.{entry.name}"
            return
        self._set_type(field, kind, needed)

    def _set_type(self, field: FieldDescriptorProto, kind: inspect.Type, needed: set[type]) -> None:
        if isinstance(kind, inspect.EnumType):
            self._add_enum(kind.cls)
            needed.add(kind.cls)
            field.type, field.type_name = _Field.TYPE_ENUM, _type_name(kind.cls)
        elif isinstance(kind, inspect.StructType):
            self.add_struct(kind.cls)
            needed.add(kind.cls)
            field.type, field.type_name = _Field.TYPE_MESSAGE, _type_name(kind.cls)
        elif isinstance(kind, inspect.IntType):
            field.type = number_type(kind)
        elif type(kind) in _SIMPLE_TYPES:
            field.type = _SIMPLE_TYPES[type(kind)]
        else:
            raise TypeError(f"protobuf has no counterpart of {kind}")


_SIMPLE_TYPES: Final[dict[type[inspect.Type], FieldType]] = {
    inspect.FloatType: _Field.TYPE_DOUBLE,
    inspect.BoolType: _Field.TYPE_BOOL,
    inspect.StrType: _Field.TYPE_STRING,
    inspect.BytesType: _Field.TYPE_BYTES,
}


def _build_files() -> dict[type, FileDescriptorProto]:
    files = _Files()
    for kind in LOGGED:
        files.add_struct(kind)
    return files.by_class


_FILES: Final = _build_files()


def schema_name(kind: type[msgspec.Struct]) -> str:
    """The name of a logged class's schema: ``cruiser.Gear``."""
    return f"{SCHEMA_PREFIX}.{kind.__name__}"


@cache
def descriptor_set(kind: type[msgspec.Struct]) -> bytes:
    """The serialised FileDescriptorSet of a logged class: its file, after those that it needs."""
    by_name = {file.name: file for file in _FILES.values()}
    ordered: dict[str, FileDescriptorProto] = {}

    def add(file: FileDescriptorProto) -> None:
        for name in file.dependency:
            add(by_name[name])
        ordered.setdefault(file.name, file)

    add(_FILES[kind])
    return FileDescriptorSet(file=ordered.values()).SerializeToString(deterministic=True)


def message_class(kind: type[msgspec.Struct]) -> type[ProtobufMessage]:
    """The protobuf package's class of a logged class, from its descriptor set alone."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(descriptor_set(kind)).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(schema_name(kind)))
