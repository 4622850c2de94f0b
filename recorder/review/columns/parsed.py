"""Messages to Arrow columns by the protobuf package, one by one: whatever has no common layout."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any

import pyarrow as pa
from google.protobuf.message import DecodeError

from recorder.review.columns.shape import Field, Shape, message_of

_DOES_NOT_FIT = (pa.ArrowException, OverflowError, ValueError, TypeError, AttributeError)
"""What Arrow raises on a number beyond the type of its column, and what a field called as a method leads to."""


def columns(
    shape: Shape, read: Callable[[bytes], Any], messages: Sequence[bytes]
) -> tuple[list[pa.Array], list[int]]:
    """The columns of a shape, in its order and of its fields' stored types, and which messages cannot be read.

    Args:
        shape: what the messages are.
        read: a message's bytes to the protobuf package's message.
        messages: as they stand in the log.
    """
    found, broken = [], []
    for number, data in enumerate(messages):
        try:
            found.append(read(data))
        except (DecodeError, RecursionError):
            broken.append(number)
    try:
        return message_columns(shape, found), broken
    except _DOES_NOT_FIT:
        return _one_by_one(shape, read, messages)


def message_columns(shape: Shape, messages: Sequence[Any]) -> list[pa.Array]:
    """The columns of messages of the protobuf package."""
    values = _values(shape, messages)
    return [pa.array(column, field.stored) for field, column in zip(shape.fields, values, strict=True)]


def _one_by_one(
    shape: Shape, read: Callable[[bytes], Any], messages: Sequence[bytes]
) -> tuple[list[pa.Array], list[int]]:
    """As ``columns``, where one message at least holds a number that its column does not."""
    found, broken = [], []
    for number, data in enumerate(messages):
        try:
            one = read(data)
            message_columns(shape, [one])
            found.append(one)
        except (DecodeError, RecursionError, *_DOES_NOT_FIT):
            broken.append(number)
    return message_columns(shape, found), broken


def _values(shape: Shape, messages: Sequence[Any]) -> list[list[Any]]:
    """Of each field the values of all messages."""
    if not shape.fields:
        return []
    get = attrgetter(*[field.name for field in shape.fields])
    if len(shape.fields) == 1:
        rows = [[get(message) for message in messages]]
    else:
        rows = [list(column) for column in zip(*map(get, messages), strict=True)] or [[] for _ in shape.fields]
    return [_field_values(field, column, messages) for field, column in zip(shape.fields, rows, strict=True)]


def _field_values(field: Field, values: list[Any], messages: Sequence[Any]) -> list[Any]:
    if field.is_map:
        _, value = message_of(field).fields
        return [list(zip(one, _converted(value, list(one.values())), strict=True)) for one in values]
    if field.is_repeated:
        return [_converted(field, list(one)) for one in values]
    converted = _converted(field, values)
    if field.has_presence:
        name = field.name
        return [one if message.HasField(name) else None for one, message in zip(converted, messages, strict=True)]
    return converted


def _converted(field: Field, values: list[Any]) -> list[Any]:
    """Values as Arrow takes them: of an enumeration the places of their names, of a message a dict."""
    if field.names is not None:
        return list(map(field.names.place, values))
    if field.form is not None:
        return values
    if field.within is None:
        return [one.SerializeToString() for one in values]
    names = [one.name for one in field.within.fields]
    return [dict(zip(names, row, strict=True)) for row in zip(*_values(field.within, values), strict=True)] or [
        {} for _ in values
    ]
