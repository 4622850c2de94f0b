"""What a class of protobuf messages holds: its fields, and the Arrow type of each.

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

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
"""Protobuf's wire types."""

INT64_MAX: Final = 2**63 - 1


class Form(msgspec.Struct, frozen=True):
    """How a kind of number stands in a message.

    Attributes:
        wire: the wire type.
        raw: the numpy type of its bytes, if they are of fixed width; of a varint that of its value.
        arrow: the type of its column.
        is_zigzag: the sign of a varint is its lowest bit.
    """

    wire: int
    raw: str
    arrow: pa.DataType
    is_zigzag: bool = False

    @property
    def is_text(self) -> bool:
        """It is text, and not bytes."""
        return bool(self.arrow == pa.string())


_F: Final = FieldDescriptor
FORMS: Final[Mapping[int, Form]] = {
    _F.TYPE_DOUBLE: Form(FIXED64, "<f8", pa.float64()),
    _F.TYPE_FLOAT: Form(FIXED32, "<f4", pa.float32()),
    _F.TYPE_FIXED64: Form(FIXED64, "<u8", pa.uint64()),
    _F.TYPE_SFIXED64: Form(FIXED64, "<i8", pa.int64()),
    _F.TYPE_FIXED32: Form(FIXED32, "<u4", pa.int64()),
    _F.TYPE_SFIXED32: Form(FIXED32, "<i4", pa.int32()),
    _F.TYPE_INT32: Form(VARINT, "<i4", pa.int32()),
    _F.TYPE_INT64: Form(VARINT, "<i8", pa.int64()),
    _F.TYPE_UINT32: Form(VARINT, "<u4", pa.int64()),
    _F.TYPE_UINT64: Form(VARINT, "<u8", pa.uint64()),
    _F.TYPE_SINT32: Form(VARINT, "<i4", pa.int32(), is_zigzag=True),
    _F.TYPE_SINT64: Form(VARINT, "<i8", pa.int64(), is_zigzag=True),
    _F.TYPE_BOOL: Form(VARINT, "?", pa.bool_()),
    _F.TYPE_ENUM: Form(VARINT, "<i4", pa.int32()),
    _F.TYPE_STRING: Form(LENGTH, "", pa.string()),
    _F.TYPE_BYTES: Form(LENGTH, "", pa.binary()),
}
"""By the descriptor's type of field."""

NAMES_TYPE: Final = pa.dictionary(pa.int32(), pa.string())


class EnumNames:
    """The names of an enumeration's numbers, each with a place; one without a name gets one when it is met."""

    def __init__(self, names: Mapping[int, str]) -> None:
        self._names = list(names.values())
        self._places = {number: place for place, number in enumerate(names)}
        # Where a number is its own place, as in all classes of ours, nothing has to be looked up.
        self._dense = len(names) if list(names) == list(range(len(names))) else 0

    def place(self, number: int) -> int:
        """The place of a number's name."""
        place = self._places.get(number)
        if place is None:
            place = self._places[number] = len(self._names)
            self._names.append(str(number))
        return place

    def places(self, numbers: NDArray[np.int32]) -> NDArray[np.int32]:
        """The same of many."""
        if not len(numbers) or (self._dense and numbers.min() >= 0 and numbers.max() < self._dense):
            return numbers
        unique, which = np.unique(numbers, return_inverse=True)
        return np.array([self.place(int(number)) for number in unique], np.int32)[which]

    def named(self, places: pa.Array) -> pa.Array:
        """An array of places as one of names, which has each name once."""
        return pa.DictionaryArray.from_arrays(places, pa.array(self._names, pa.string()))

    def spelled(self, places: pa.Array) -> pa.Array:
        """An array of places as one of texts."""
        return pa.array(self._names, pa.string()).take(places)


class Field(msgspec.Struct, frozen=True, eq=False):
    """A field.

    Attributes:
        form: None for a message.
        is_bounded: a number that is unsigned in protobuf and never beyond int64.
        has_presence: it is null where it is absent, else it has its default.
        oneof: the name of the group of which a message holds one at most; empty if there is none.
        names: of an enumeration.
        within: the fields of a message; None if it is none, or one within itself, which is kept as bytes.
        stored: the column's type while it is put together: an enumeration is its places.
        shown: the column's type.
        unit: by the schema; empty if there is none.
    """

    name: str
    number: int
    form: Form | None
    is_repeated: bool
    is_map: bool
    is_bounded: bool
    has_presence: bool
    oneof: str
    names: EnumNames | None
    within: Shape | None
    stored: pa.DataType
    shown: pa.DataType
    unit: str


class Shape(msgspec.Struct, frozen=True, eq=False):
    """The fields of a class, in their order.

    Attributes:
        is_simple: nothing in it is repeated but numbers and text, so that a layout can say where it is.
    """

    fields: tuple[Field, ...]
    by_number: dict[int, Field]
    is_simple: bool


class Known(msgspec.Struct, frozen=True):
    """What our own classes tell beyond their descriptors.

    Attributes:
        values: of each enumeration the values of its members, in order.
        units: by class and field.
    """

    values: dict[str, list[str]]
    units: dict[tuple[str, str], str]


# Descriptors are of one class where protobuf is in Python, and of another where it is in C.
def shape_of(descriptor: Any, known: Known | None = None, outer: tuple[str, ...] = ()) -> Shape:  # noqa: ANN401
    """The shape of a class; ``known`` if it is ours."""
    outer = (*outer, descriptor.full_name)
    found = tuple(_field(field, known, outer) for field in descriptor.fields)
    is_simple = all(
        not field.is_map
        and not (field.form is None and (field.is_repeated or field.within is None or not field.within.is_simple))
        for field in found
    )
    return Shape(found, {field.number: field for field in found}, is_simple)


def own_shape(kind: type[msgspec.Struct]) -> tuple[Any, Shape]:
    """The protobuf package's class of a class of ours, and a shape of its own: names that are met stay in it."""
    read, known = _own(kind)
    return read, shape_of(read.DESCRIPTOR, known)


@cache
def _own(kind: type[msgspec.Struct]) -> tuple[Any, Known]:
    return message_class(kind), _known(kind)


def _field(field: Any, known: Known | None, outer: tuple[str, ...]) -> Field:  # noqa: ANN401
    names = within = None
    form = FORMS.get(field.type)
    is_map = _is_map(field)
    is_bounded = known is not None and field.type == _F.TYPE_FIXED64
    stored: pa.DataType
    if form is None:
        if field.message_type.full_name not in outer:
            within = shape_of(field.message_type, known, outer)
            stored = _message_type(within, is_map=is_map, is_shown=False)
            shown = _message_type(within, is_map=is_map, is_shown=True)
        else:
            stored = shown = pa.binary()
    else:
        stored = shown = pa.int64() if is_bounded else form.arrow
        if field.type == _F.TYPE_ENUM:
            names = _enum_names(field.enum_type, known)
            is_top = len(outer) == 1 and not field.is_repeated
            # Some readers, DuckDB among them, know no dictionaries within lists.
            shown = NAMES_TYPE if is_top else pa.string()
    if field.is_repeated and not is_map:
        stored, shown = pa.list_(stored), pa.list_(shown)
    return Field(
        name=field.name,
        number=field.number,
        form=form,
        is_repeated=field.is_repeated,
        is_map=is_map,
        is_bounded=is_bounded,
        has_presence=field.has_presence,
        oneof="" if field.containing_oneof is None else field.containing_oneof.name,
        names=names,
        within=within,
        stored=stored,
        shown=shown,
        unit="" if known is None else known.units.get((field.containing_type.name, field.name), ""),
    )


def form_of(field: Field) -> Form:
    """How a field's numbers or text stand in a message.

    Raises:
        TypeError: it is a message.
    """
    if field.form is None:
        raise TypeError(f"{field.name} is a message")
    return field.form


def message_of(field: Field) -> Shape:
    """The shape of a field that is a message.

    Raises:
        TypeError: it is none.
    """
    if field.within is None:
        raise TypeError(f"{field.name} is no message")
    return field.within


def _is_map(field: Any) -> bool:  # noqa: ANN401
    """Report whether it is a map, which in protobuf is a repeated message of key and value."""
    return bool(field.type == _F.TYPE_MESSAGE and field.message_type.GetOptions().map_entry)


def _message_type(within: Shape, *, is_map: bool, is_shown: bool) -> pa.DataType:
    if is_map:
        key, value = (one.shown if is_shown else one.stored for one in within.fields)
        return pa.map_(key, value)
    return pa.struct([(one.name, one.shown if is_shown else one.stored) for one in within.fields])


def _enum_names(enum: Any, known: Known | None) -> EnumNames:  # noqa: ANN401
    values = known.values.get(enum.name) if known is not None else None
    if values is not None:
        return EnumNames(dict(enumerate(values)))
    return EnumNames({number: value.name for number, value in enum.values_by_number.items()})


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
