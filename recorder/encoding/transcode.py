"""A typed message to its protobuf bytes, by an encoder that is compiled once for each class.

All fields of fixed width (numbers, flags, enumerations) go out in one ``struct`` call, tags included; the others
follow, one part each. Fields may come in any order in protobuf, and a default may be written or left out, so a
reader sees exactly what the protobuf package itself would have written.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from enum import Enum
from typing import Any, Final, cast

import msgspec
from google.protobuf.descriptor_pb2 import FieldDescriptorProto
from msgspec import inspect

from recorder.encoding.protobuf_schema import FieldType, fields, number_type, optional_part

Encoder = Callable[[Any], bytes]
"""A value to its protobuf bytes."""

_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5

_NUMBER_FORMATS: Final[dict[FieldType, tuple[str, int]]] = {
    FieldDescriptorProto.TYPE_FIXED32: ("I", _FIXED32),
    FieldDescriptorProto.TYPE_SFIXED32: ("i", _FIXED32),
    FieldDescriptorProto.TYPE_FIXED64: ("Q", _FIXED64),
    FieldDescriptorProto.TYPE_SFIXED64: ("q", _FIXED64),
}

_TAG_FORMATS: Final = {1: "B", 2: "H"}

ENUM_MAX_VALUES: Final = 128
"""An enumeration's number is written as one byte, which is what its varint is below this."""


def varint(number: int) -> bytes:
    """Protobuf's variable-length form of a number that is not negative."""
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
    """As ``compile_encoder``, but of the fields' values in order: no message needs to be built for them."""
    return _compile(kind, ", ".join(name for name, _, _ in fields(kind)), "")


class Packed(msgspec.Struct, frozen=True):
    """The fields of a class as source: those of fixed width to be packed in one call, the others in parts.

    Attributes:
        layout: of the packing, one character for each argument.
        arguments: of the packing, tags included.
        parts: expressions of the fields that are not packed.
        names: the names that the source needs.
    """

    layout: str
    arguments: list[str]
    parts: list[str]
    names: dict[str, Any]

    def struct(self, before: str) -> struct.Struct:
        """The packing, with fields before it."""
        return struct.Struct(f"<{before}{self.layout}")


def packed_fields(kind: type[msgspec.Struct], at_hand: dict[str, str], prefix: str) -> Packed:
    """Takes a class apart.

    Args:
        kind: the class.
        at_hand: fields that are in a variable already, by name.
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
    """Writes the encoder's one expression and evaluates it: several times faster than a loop over the fields.

    It reads, for a class with two numbers, an enumeration and a text::

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
    """The struct character and the wire type of a field that always has the same width."""
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
    """The protobuf number of each name of an enumeration: its position."""
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
    """Tag, length, bytes; without an encoder the value is the bytes."""
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
