"""ROS messages to bytes and back (OMG CDR v1, little endian), and the hash of a type (REP 2016, ``RIHS01``)."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from hashlib import sha256
from typing import Any, Final

import msgspec

from schemas.ros.types import DEFINITIONS

HEADER: Final = b"\x00\x01\x00\x00"  # little endian, no options; alignment counts behind it
ITEMS_MAX: Final = 10_000  # items of a sequence, and bytes of a text, that are read

_PRIMITIVES: Final = {
    "bool": ("?", 15),
    "byte": ("B", 16),
    "char": ("B", 3),  # the definitions' char is an unsigned byte
    "uint8": ("B", 3),
    "int32": ("i", 6),
    "uint32": ("I", 7),
    "int64": ("q", 8),
    "float32": ("f", 10),
    "float64": ("d", 11),
    "string": ("", 17),
}
"""By the name in a definition: the format of ``struct``, and the number of a type description."""

_NESTED: Final = 1
_FIXED, _BOUNDED, _UNBOUNDED = 48, 96, 144  # what a type's number grows by for an array or a sequence
_SEQUENCES: Final = (_BOUNDED, _UNBOUNDED)
_FIELD: Final = re.compile(r"^([\w/]+)(?:\[(<=)?(\d*)\])? (\w+)(?: .*)?$", re.MULTILINE)  # no constant: it has "="


class CdrError(ValueError):
    """Bytes that are no message of the type."""


class CdrField(msgspec.Struct, frozen=True):
    """A field of a type.

    Attributes:
        nested: the type's full name if it is a message, else empty.
        format: of ``struct`` for a number, else empty.
        array: 0 for a single value, else what the type's number grows by.
        length: of a fixed array, or the most items of a bounded sequence.
        count: its items, of a sequence 0: there they stand in front.
    """

    name: str
    base: str
    nested: str
    format: str
    array: int
    length: int
    count: int


@cache
def fields_of(type_name: str) -> tuple[CdrField, ...]:
    """The fields of a type, without its constants."""
    return tuple(_field(*match.groups()) for match in _FIELD.finditer(DEFINITIONS[type_name]))


def _field(base: str, bounded: str | None, length: str | None, name: str) -> CdrField:
    array = 0 if length is None else _BOUNDED if bounded else _FIXED if length else _UNBOUNDED
    nested = "" if base in _PRIMITIVES else base if base in DEFINITIONS else base.replace("/", "/msg/")
    most = int(length or 0)
    count = {0: 1, _FIXED: most}.get(array, 0)
    return CdrField(name, base, nested, "" if nested else _PRIMITIVES[base][0], array, most, count)


def encode(type_name: str, message: Mapping[str, Any]) -> bytes:
    """A message as bytes. A field that is left out is zero, empty, or its type's own zero."""
    out = bytearray(HEADER)
    _put(out, type_name, message)
    return bytes(out)


def _put(out: bytearray, type_name: str, message: Mapping[str, Any]) -> None:
    for field in fields_of(type_name):
        value = message.get(field.name)
        items: Sequence[Any] = [0] * field.count if value is None else value if field.array else [value]
        if field.array in _SEQUENCES:
            _put_numbers(out, "I", [len(items)])
        elif len(items) != field.count:
            raise ValueError(f"{field.name} has {len(items)} items, not {field.count}")
        if field.format:
            _put_numbers(out, field.format, items)
            continue
        for item in items:
            if field.nested:
                _put(out, field.nested, item or {})
            else:
                text = (item or "").encode() + b"\0"
                _put_numbers(out, "I", [len(text)])
                out += text


def _put_numbers(out: bytearray, code: str, numbers: Sequence[Any]) -> None:
    if numbers:
        out += bytes(_padding(len(out), code)) + struct.pack(f"<{len(numbers)}{code}", *numbers)


def _padding(place: int, code: str) -> int:
    return (len(HEADER) - place) % struct.calcsize(code)


def decode(type_name: str, data: bytes) -> dict[str, Any]:
    """The message in these bytes.

    Raises:
        CdrError: they are none of this type: too short or too long, big endian, or without the header.
    """
    if data[: len(HEADER)] != HEADER:
        raise CdrError(f"its header is {data[:4].hex(' ') or 'missing'}, not little-endian CDR")
    reader = _Reader(data)
    message = reader.message(type_name)
    if (left := len(data) - reader.place) >= len(HEADER):  # Up to three bytes pad a message.
        raise CdrError(f"{left} bytes follow the message")
    return message


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self.place = len(HEADER)

    def message(self, type_name: str) -> dict[str, Any]:
        return {field.name: self._value(field) for field in fields_of(type_name)}

    def _value(self, field: CdrField) -> Any:  # noqa: ANN401 - of the field's own type
        count = self._count() if field.array in _SEQUENCES else field.count
        if field.array == _BOUNDED and count > field.length:
            raise CdrError(f"{field.name} has {count} items, not {field.length}")
        if field.format:
            items = self._numbers(field.format, count)
        elif field.nested:
            items = [self.message(field.nested) for _ in range(count)]
        else:
            items = [self._text(field.name) for _ in range(count)]
        return items if field.array else items[0]

    def _text(self, name: str) -> str:
        try:
            return self._take(self._count()).removesuffix(b"\0").decode()
        except UnicodeDecodeError as error:
            raise CdrError(f"{name} is not UTF-8") from error

    def _count(self) -> int:
        (count,) = self._numbers("I", 1)
        if count > ITEMS_MAX:
            raise CdrError(f"a length of {count}")
        return int(count)

    def _numbers(self, code: str, count: int) -> list[Any]:
        if count:
            self._take(_padding(self.place, code))
        return list(struct.unpack(f"<{count}{code}", self._take(struct.calcsize(code) * count)))

    def _take(self, size: int) -> bytes:
        self.place += size
        if self.place > len(self._data):
            raise CdrError(f"it ends {self.place - len(self._data)} bytes early")
        return self._data[self.place - size : self.place]


@cache
def type_hash(type_name: str) -> str:
    """``RIHS01_`` and the SHA-256 of the type's description: fields and referenced types, without constants."""
    description = {
        "type_description": _description(type_name),
        "referenced_type_descriptions": [_description(name) for name in sorted(set(referenced(type_name)))],
    }
    return f"RIHS01_{sha256(json.dumps(description).encode()).hexdigest()}"


def referenced(type_name: str) -> Iterator[str]:
    """All types within a type, those within them too; some repeatedly."""
    for field in fields_of(type_name):
        if field.nested:
            yield field.nested
            yield from referenced(field.nested)


def _description(type_name: str) -> dict[str, Any]:
    return {
        "type_name": type_name,
        "fields": [
            {
                "name": field.name,
                "type": {
                    "type_id": (_NESTED if field.nested else _PRIMITIVES[field.base][1]) + field.array,
                    "capacity": field.length,
                    "string_capacity": 0,
                    "nested_type_name": field.nested,
                },
            }
            for field in fields_of(type_name)
        ],
    }


@cache
def definition(type_name: str) -> str:
    """The text of a type with all types within it, as MCAP's schema encoding ``ros2msg`` wants it."""
    within = dict.fromkeys(referenced(type_name))
    parts = [f"{'=' * 80}\nMSG: {name.replace('/msg/', '/')}\n{DEFINITIONS[name]}" for name in within]
    return "\n".join([DEFINITIONS[type_name], *parts]) + "\n"
