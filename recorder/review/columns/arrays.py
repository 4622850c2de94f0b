"""Many messages of one layout to Arrow columns, by slicing their bytes: no loop goes over the messages.

The messages stand below each other as a matrix of bytes; a field is then some of its columns.
"""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recorder.review.columns.layout import Place, Span
from recorder.review.columns.shape import LENGTH, VARINT, Field, Form, Shape, form_of, message_of

Matrix = NDArray[np.uint8]
"""A message a row."""

_NULL_COUNT: Final = 0


def columns(shape: Shape, places: dict[int, Place], rows: Matrix) -> list[pa.Array]:
    """The columns of a shape, in its order and of its fields' stored types.

    Args:
        shape: what the messages are.
        places: of a layout that all rows have.
        rows: the messages.
    """
    return [_column(field, places.get(field.number), rows) for field in shape.fields]


def bare_array(kind: pa.DataType, values: NDArray[Any]) -> pa.Array:
    """A numpy array as an Arrow array of numbers, without a copy if it is contiguous."""
    return pa.Array.from_buffers(
        kind, len(values), [None, pa.py_buffer(np.ascontiguousarray(values))], _NULL_COUNT
    )


def _column(field: Field, place: Place | None, rows: Matrix) -> pa.Array:
    if field.is_repeated:
        return _lists(field, cast("list[Span]", place or []), rows)
    if place is None:
        return _absent(field, len(rows))
    if isinstance(place, dict):
        children = columns(message_of(field), place, rows)
        return pa.StructArray.from_arrays(children, fields=list(field.stored))
    return _values(field, [cast("Span", place)], rows)


def _absent(field: Field, count: int) -> pa.Array:
    if field.has_presence:
        return pa.nulls(count, field.stored)
    form = form_of(field)
    if form.wire == LENGTH:
        return _text(form.arrow, np.zeros((count, 0), np.uint8), [0])
    if field.names is not None:
        return bare_array(field.stored, field.names.places(np.zeros(count, np.int32)))
    return _numbers(field, np.zeros(count, form.raw))


def _lists(field: Field, spans: list[Span], rows: Matrix) -> pa.Array:
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * np.int32(len(spans))
    values = _values(field, spans, rows) if spans else pa.array([], field.stored.value_type)
    return pa.ListArray.from_arrays(bare_array(pa.int32(), offsets), values, type=field.stored)


def _values(field: Field, spans: list[Span], rows: Matrix) -> pa.Array:
    """The values at these spans of every row: those of the first row, then those of the second."""
    form = form_of(field)
    if form.wire == LENGTH:
        data = rows[:, spans[0][0] : sum(spans[0])] if len(spans) == 1 else rows[:, _all_bytes(spans)]
        return _text(form.arrow, data, [width for _, width in spans])
    if len(spans) == 1:
        numbers = _of_span(form, spans[0], rows)
    else:
        numbers = np.stack([_of_span(form, span, rows) for span in spans], axis=1).reshape(-1)
    if field.names is not None:
        return bare_array(pa.int32(), field.names.places(numbers))
    return _numbers(field, numbers)


def _numbers(field: Field, numbers: NDArray[Any]) -> pa.Array:
    form = form_of(field)
    if form.raw == "?":
        return pa.Array.from_buffers(
            pa.bool_(),
            len(numbers),
            [None, pa.py_buffer(np.packbits(numbers, bitorder="little"))],
            _NULL_COUNT,
        )
    if form.raw == "<u4":
        numbers = numbers.astype(np.int64)
    # What is bounded fits its signed type as it is.
    return bare_array(pa.int64() if field.is_bounded else form.arrow, numbers)


def _all_bytes(spans: list[Span]) -> NDArray[np.int64]:
    return np.concatenate([np.arange(at, at + width) for at, width in spans])


def _text(kind: pa.DataType, data: Matrix, widths: list[int]) -> pa.Array:
    """Texts or bytes that stand one after the other in each row."""
    count, total = len(data) * len(widths), sum(widths)
    ends = np.cumsum([0, *widths[:-1]], dtype=np.int64)
    if len(data) * total > np.iinfo(np.int32).max:
        raise OverflowError("a column of more than two gigabytes")
    offsets = np.empty(count + 1, np.int32)
    offsets[:-1] = (np.arange(len(data), dtype=np.int64)[:, None] * total + ends).reshape(-1)
    offsets[-1] = len(data) * total
    buffers = [None, pa.py_buffer(offsets), pa.py_buffer(np.ascontiguousarray(data))]
    return pa.Array.from_buffers(kind, count, buffers, _NULL_COUNT)


def _of_span(form: Form, span: Span, rows: Matrix) -> NDArray[Any]:
    at, width = span
    if form.wire == VARINT:
        return _varints(form, rows, at, width)
    numbers: NDArray[Any] = rows[:, at : at + width].view(np.dtype(form.raw))[:, 0]
    return numbers


def _varints(form: Form, rows: Matrix, at: int, width: int) -> NDArray[Any]:
    single = rows[:, at]
    if width == 1 and not form.is_zigzag:
        return np.asarray(single != 0) if form.raw == "?" else single.astype(form.raw)
    value = np.zeros(len(rows), np.uint64)
    for place in range(width):
        value |= (rows[:, at + place] & np.uint8(0x7F)).astype(np.uint64) << np.uint64(7 * place)
    if form.raw == "?":
        return np.asarray(value != 0)
    if form.is_zigzag:
        if form.raw == "<i4":
            value &= np.uint64(0xFFFFFFFF)
        value = (value >> np.uint64(1)) ^ (np.uint64(0) - (value & np.uint64(1)))
    # As in protobuf: of a number that is too large for its field the lower bits hold.
    return value.astype(form.raw)
