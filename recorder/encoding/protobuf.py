"""Messages as protobuf: descriptors built at run time from the classes, and one compiled encoder for each.

Every message and enumeration has its own file, so that the descriptor set of a channel holds only what it needs.
Field numbers are positions in the class, from 1: a new field goes to the end. Numbers are fixed-width: an encoder
packs all numbers, flags and enumerations in one ``struct`` call, tags included; the other fields follow. The first
value of an enumeration is protobuf's 0: ``UNDEFINED``, ``UNKNOWN`` or ``NONE`` where there may be no value.

Protobuf allows fields in any order, and defaults may be written: readers see the same as from the protobuf
package.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from functools import cache
from typing import Any, Final, TypeAlias, cast

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
    """The narrowest fixed-width type for the bounds."""
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
    """The type without descriptions and units, at any depth."""
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


class _Files:
    """The files of the classes added so far, each after its dependencies."""

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
        # The names of an enumeration's values belong to the package in protobuf, so they carry the enumeration's.
        for number, member in enumerate(kind):
            enum.value.add(name=f"{snake_case(kind.__name__).upper()}_{member.name}", number=number)
        self.by_class[kind] = file

    def _add_field(
        self, message: DescriptorProto, name: str, number: int, kind: inspect.Type, needed: set[type]
    ) -> None:
        field = message.field.add(name=name, number=number, label=_Field.LABEL_OPTIONAL)
        inner = optional_part(kind)
        if inner is not None:
            # In proto3 `optional` is a oneof of one field.
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
    return f"{SCHEMA_PREFIX}.{kind.__name__}"


@cache
def descriptor_set(kind: type[msgspec.Struct]) -> bytes:
    """The serialised FileDescriptorSet of a logged class: its file, after its dependencies."""
    by_name = {file.name: file for file in _FILES.values()}
    ordered: dict[str, FileDescriptorProto] = {}

    def add(file: FileDescriptorProto) -> None:
        for name in file.dependency:
            add(by_name[name])
        ordered.setdefault(file.name, file)

    add(_FILES[kind])
    return FileDescriptorSet(file=ordered.values()).SerializeToString(deterministic=True)


def message_class(kind: type[msgspec.Struct]) -> type[ProtobufMessage]:
    """The protobuf package's class of a logged class, from its descriptor set."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(descriptor_set(kind)).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(schema_name(kind)))


Encoder = Callable[[Any], bytes]  # a value to its protobuf bytes

_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5

_NUMBER_FORMATS: Final[dict[FieldType, tuple[str, int]]] = {
    FieldDescriptorProto.TYPE_FIXED32: ("I", _FIXED32),
    FieldDescriptorProto.TYPE_SFIXED32: ("i", _FIXED32),
    FieldDescriptorProto.TYPE_FIXED64: ("Q", _FIXED64),
    FieldDescriptorProto.TYPE_SFIXED64: ("q", _FIXED64),
}

_TAG_FORMATS: Final = {1: "B", 2: "H"}

ENUM_MAX_VALUES: Final = 128  # a varint below this is one byte


def varint(number: int) -> bytes:
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def compile_encoder(kind: type[msgspec.Struct]) -> Encoder:
    """The encoder of a message class: a message to its bytes."""
    return _compile(kind, "message", "message.")


def compile_row_encoder(kind: type[msgspec.Struct]) -> Callable[..., bytes]:
    """As ``compile_encoder``, but from the fields' values in order, without a message."""
    return _compile(kind, ", ".join(name for name, _, _ in fields(kind)), "")


class Packed(msgspec.Struct, frozen=True):
    """The fields of a class as source code: fixed-width ones for one packing, the others in parts.

    Attributes:
        layout: of the packing, one character for each argument.
        parts: expressions of the other fields.
    """

    layout: str
    arguments: list[str]
    parts: list[str]
    names: dict[str, Any]

    def struct(self, before: str) -> struct.Struct:
        """The packing, with fields before it."""
        return struct.Struct(f"<{before}{self.layout}")


def packed_fields(kind: type[msgspec.Struct], at_hand: dict[str, str], prefix: str) -> Packed:
    """Split a class into its packing and parts.

    Args:
        at_hand: expressions of some fields, by name.
        prefix: of all others, such as ``message.``.
    """
    names: dict[str, Any] = {}
    layout, arguments, parts = "", [], []
    for name, number, field_type in fields(kind):
        value = at_hand.get(name, f"{prefix}{name}")
        form = _fixed_format(field_type)
        if form is None:
            names[f"part_{number}"] = _part(number, field_type)
            parts.append(f"part_{number}({value})")
            continue
        tag = _tag(number, form[1])
        layout += _TAG_FORMATS[len(tag)] + form[0]
        if isinstance(field_type, inspect.EnumType):
            names[f"enum_{number}"] = enum_numbers(field_type.cls)
            # An enumeration member hashes in Python, its name in C.
            value = f"enum_{number}[{value}._name_]"
        arguments.append(f"{int.from_bytes(tag, 'little')}, {value}")
    return Packed(layout, arguments, parts, names)


def _compile(kind: type[msgspec.Struct], parameters: str, prefix: str) -> Callable[..., bytes]:
    """Compile the encoder into one expression: several times faster than a loop over the fields.

    For a class with two numbers, an enumeration and a text::

        lambda message: pack(9, message.a, 17, message.b, 24, enum_3[message.c._name_]) + part_4(message.d)
    """
    packed = packed_fields(kind, {}, prefix)
    names, parts = dict(packed.names), list(packed.parts)
    if packed.arguments:
        names["pack"] = packed.struct("").pack
        parts.insert(0, f"pack({', '.join(packed.arguments)})")
    source = f"lambda {parameters}: {' + '.join(parts)}"
    # As in dataclasses and namedtuple: the source holds our own field names and nothing from outside.
    return cast("Callable[..., bytes]", eval(source, names))  # noqa: S307


def _tag(number: int, wire_type: int) -> bytes:
    return varint(number << 3 | wire_type)


def _fixed_format(kind: inspect.Type) -> tuple[str, int] | None:
    """The struct character and the wire type of a fixed-width field; None for others."""
    if isinstance(kind, inspect.IntType):
        return _NUMBER_FORMATS[number_type(kind)]
    if isinstance(kind, inspect.FloatType):
        return "d", _FIXED64
    if isinstance(kind, inspect.BoolType):
        return "?", _VARINT
    if isinstance(kind, inspect.EnumType):
        if len(kind.cls) > ENUM_MAX_VALUES:
            raise TypeError(f"{kind.cls} has too many values")
        return "B", _VARINT
    return None


def enum_numbers(kind: type[Enum]) -> dict[str, int]:
    return {member.name: number for number, member in enumerate(kind)}


def _part(number: int, kind: inspect.Type) -> Encoder:
    """The encoder of one field's value, tag included."""
    inner = optional_part(kind)
    if inner is not None:
        present = _part(number, inner)
        return lambda value: b"" if value is None else present(value)
    if isinstance(kind, inspect.ListType):
        return _list_part(number, kind.item_type)
    if isinstance(kind, inspect.DictType):
        entry = _entry_encoder(_part(1, kind.key_type), _part(2, kind.value_type))
        return _repeated(_delimited(number, entry), dict.items)
    if isinstance(kind, inspect.StructType):
        return _delimited(number, compile_encoder(kind.cls))
    if isinstance(kind, inspect.StrType | inspect.BytesType):
        return _delimited(number, str.encode if isinstance(kind, inspect.StrType) else None)
    return _number_part(number, kind)


def _number_part(number: int, kind: inspect.Type) -> Encoder:
    form = _fixed_format(kind)
    if form is None:
        raise TypeError(f"protobuf has no counterpart of {kind}")
    tag = _tag(number, form[1])
    pack = struct.Struct(f"<{len(tag)}s{form[0]}").pack
    if isinstance(kind, inspect.EnumType):
        numbers = enum_numbers(kind.cls)
        return lambda value: pack(tag, numbers[value.name])
    return lambda value: pack(tag, value)


def _list_part(number: int, kind: inspect.Type) -> Encoder:
    form = _fixed_format(kind)
    if form is None:
        return _repeated(_part(number, kind), iter)
    if isinstance(kind, inspect.EnumType):
        numbers = enum_numbers(kind.cls)
        packed = _delimited(number, lambda values: bytes([numbers[value.name] for value in values]))
    else:
        packed = _delimited(number, lambda values: struct.pack(f"<{len(values)}{form[0]}", *values))
    return lambda values: packed(values) if values else b""


def _delimited(number: int, encoder: Encoder | None) -> Encoder:
    tag = _tag(number, _LENGTH)
    # Nearly every length is below 128 and a varint of one byte.
    short = [tag + varint(length) for length in range(128)]

    def delimit(data: bytes) -> bytes:
        length = len(data)
        return (short[length] if length < 128 else tag + varint(length)) + data

    return delimit if encoder is None else lambda value: delimit(encoder(value))


def _repeated(encoder: Encoder, items: Callable[[Any], Iterable[Any]]) -> Encoder:
    return lambda value: b"".join([encoder(item) for item in items(value)])


def _entry_encoder(key: Encoder, value: Encoder) -> Encoder:
    return lambda item: key(item[0]) + value(item[1])
