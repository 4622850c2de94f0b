"""The fields of a protobuf message class, and the Arrow type of each.

Unsigned numbers of 32 bits become int64, and so do those of 64 bits whose schema bounds them: a difference of two
is then a number in SQL too. Enumerations become dictionary-encoded strings: of our own classes the values that the
typed messages have (``drive``), of others the names in their descriptors; a number that has no name is its own
digits. Within lists and messages they are plain strings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import Enum
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa
from google.protobuf.descriptor import FieldDescriptor
from msgspec import inspect
from numpy.typing import NDArray

from recorder.encoding.protobuf_schema import fields, message_class, optional_part
from schemas.messages import UNIT_KEYWORD

_F: Final = FieldDescriptor
_TYPES: Final[Mapping[int, pa.DataType]] = {
    _F.TYPE_DOUBLE: pa.float64(),
    _F.TYPE_FLOAT: pa.float32(),
    _F.TYPE_FIXED64: pa.uint64(),
    _F.TYPE_SFIXED64: pa.int64(),
    _F.TYPE_FIXED32: pa.int64(),
    _F.TYPE_SFIXED32: pa.int32(),
    _F.TYPE_INT32: pa.int32(),
    _F.TYPE_INT64: pa.int64(),
    _F.TYPE_UINT32: pa.int64(),
    _F.TYPE_UINT64: pa.uint64(),
    _F.TYPE_SINT32: pa.int32(),
    _F.TYPE_SINT64: pa.int64(),
    _F.TYPE_BOOL: pa.bool_(),
    _F.TYPE_STRING: pa.string(),
    _F.TYPE_BYTES: pa.binary(),
}
"""The Arrow type of a column, by the descriptor's type of field."""

NAMES_TYPE: Final = pa.dictionary(pa.int32(), pa.string())


class EnumNames:
    """The names of an enumeration's numbers, each with a place; one without a name gets one when it is met."""

    def __init__(self, names: Mapping[int, str]) -> None:
        self._names = list(names.values())
        self._places = {number: place for place, number in enumerate(names)}
        self._first = next(iter(names))
        # Where a number is its own place, as in all classes of ours, nothing has to be looked up.
        self._dense = len(names) if list(names) == list(range(len(names))) else 0

    def named(self, numbers: pa.Array, kind: pa.DataType) -> pa.Array:
        """The names of numbers, as a dictionary array or as one of texts."""
        places = self._places_of(numbers.fill_null(self._first).to_numpy())
        indices = pa.array(places, pa.int32(), mask=np.asarray(numbers.is_null()) if numbers.null_count else None)
        names = pa.array(self._names, pa.string())
        return pa.DictionaryArray.from_arrays(indices, names) if kind == NAMES_TYPE else names.take(indices)

    def _places_of(self, numbers: NDArray[np.int32]) -> NDArray[np.int32]:
        if not len(numbers) or (self._dense and numbers.min() >= 0 and numbers.max() < self._dense):
            return numbers
        unique, which = np.unique(numbers, return_inverse=True)
        return np.array([self._place(int(number)) for number in unique], np.int32)[which]

    def _place(self, number: int) -> int:
        place = self._places.get(number)
        if place is None:
            place = self._places[number] = len(self._names)
            self._names.append(str(number))
        return place


class Field(msgspec.Struct, frozen=True, eq=False):
    """A field.

    Attributes:
        wire_type: how it is read, a descriptor's type of field: an enumeration as a number, and a message within
            itself as bytes.
        oneof: the group of which a message holds one at most, itself alone if it may be absent in any other way;
            empty for a number or text that has its default where it is absent.
        names: of an enumeration.
        within: the fields of a message; None if it is none.
        type: the column's type.
        unit: by the schema; empty if there is none.
    """

    name: str
    number: int
    wire_type: int
    is_repeated: bool
    is_map: bool
    oneof: str
    names: EnumNames | None
    within: tuple[Field, ...] | None
    type: pa.DataType
    unit: str


class Known(msgspec.Struct, frozen=True):
    """Facts about our own classes that their descriptors lack.

    Attributes:
        values: of each enumeration the values of its members, in order.
        units: by class and field.
    """

    values: dict[str, list[str]]
    units: dict[tuple[str, str], str]


# Descriptors are of one class where protobuf is in Python, and of another where it is in C.
def fields_of(descriptor: Any, known: Known | None = None, outer: tuple[str, ...] = ()) -> tuple[Field, ...]:  # noqa: ANN401
    """The fields of a class, in their order; ``known`` if it is ours.

    Raises:
        TypeError: it has a field of a kind that nobody writes any more: a group.
    """
    outer = (*outer, descriptor.full_name)
    return tuple(_field(field, known, outer) for field in descriptor.fields)


def own_fields(kind: type[msgspec.Struct]) -> tuple[Field, ...]:
    """The fields of a class of ours, of their own each time: names that are met stay in them."""
    return fields_of(message_class(kind).DESCRIPTOR, _known(kind))


def _field(field: Any, known: Known | None, outer: tuple[str, ...]) -> Field:  # noqa: ANN401
    names = within = None
    wire_type = field.type
    is_map = wire_type == _F.TYPE_MESSAGE and bool(field.message_type.GetOptions().map_entry)
    kind: pa.DataType
    if wire_type == _F.TYPE_MESSAGE and field.message_type.full_name not in outer:
        within = fields_of(field.message_type, known, outer)
        kind = (
            pa.map_(*[one.type for one in within])
            if is_map
            else pa.struct([(one.name, one.type) for one in within])
        )
    elif wire_type == _F.TYPE_MESSAGE:
        wire_type, kind = _F.TYPE_BYTES, pa.binary()
    elif wire_type == _F.TYPE_ENUM:
        wire_type, names = _F.TYPE_INT32, _enum_names(field.enum_type, known)
        # Some readers, DuckDB among them, know no dictionaries within lists.
        kind = NAMES_TYPE if len(outer) == 1 and not field.is_repeated else pa.string()
    elif wire_type not in _TYPES:
        raise TypeError(f"{field.name} is a group")
    elif known is not None and wire_type == _F.TYPE_FIXED64:
        kind = pa.int64()
    else:
        kind = _TYPES[wire_type]
    oneof = ""
    if field.containing_oneof is not None:
        oneof = field.containing_oneof.name
    elif field.has_presence and within is None:
        oneof = f"{field.name} alone"
    return Field(
        name=field.name,
        number=field.number,
        wire_type=wire_type,
        is_repeated=field.is_repeated,
        is_map=is_map,
        oneof=oneof,
        names=names,
        within=within,
        type=pa.list_(kind) if field.is_repeated and not is_map else kind,
        unit="" if known is None else known.units.get((field.containing_type.name, field.name), ""),
    )


def _enum_names(enum: Any, known: Known | None) -> EnumNames:  # noqa: ANN401
    values = known.values.get(enum.name) if known is not None else None
    if values is not None:
        return EnumNames(dict(enumerate(values)))
    return EnumNames({number: value.name for number, value in enum.values_by_number.items()})


@cache
def _known(kind: type[msgspec.Struct]) -> Known:
    values = {one.__name__: [str(member.value) for member in one] for one in _enums(kind)}
    definitions = msgspec.json.schema(kind)["$defs"]
    units = {
        (name, field): unit
        for name, part in definitions.items()
        for field, described in part.get("properties", {}).items()
        if (unit := _unit(described))
    }
    return Known(values, units)


def _enums(kind: type[msgspec.Struct]) -> Iterator[type[Enum]]:
    for _, _, declared in fields(kind):
        field = optional_part(declared) or declared
        if isinstance(field, inspect.ListType):
            field = field.item_type
        if isinstance(field, inspect.EnumType):
            yield field.cls
        elif isinstance(field, inspect.StructType):
            yield from _enums(field.cls)


def _unit(described: Mapping[str, Any]) -> str:
    """The unit in the JSON Schema of a field, whatever lists and nulls are around it."""
    options = [described, described.get("items", {}), *described.get("anyOf", ())]
    return next((str(one[UNIT_KEYWORD]) for one in options if UNIT_KEYWORD in one), "")
