"""Arrow columns as text and as JSON, for CSV and for programs.

Times are ISO 8601 in UTC, to the nanosecond. Bytes are hexadecimal in a cell of their own, and base64 within JSON.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator
from typing import Any, Final

import msgspec
import pyarrow as pa
from pyarrow import csv

_types: Final = pa.types


def cells(rows: pa.RecordBatch) -> pa.RecordBatch:
    """The same rows in columns that CSV can say: numbers, flags, texts and times."""
    arrays = [_cells(column) for column in rows.columns]
    return pa.RecordBatch.from_arrays(arrays, names=rows.schema.names)


def objects(rows: pa.RecordBatch) -> Iterator[dict[str, Any]]:
    """The rows as JSON objects, by column."""
    names = rows.schema.names
    for row in zip(*map(values, rows.columns), strict=True):
        yield dict(zip(names, row, strict=True))


def values(array: pa.Array) -> list[Any]:
    """The values as JSON has them."""
    kind = array.type
    if _types.is_dictionary(kind):
        return values(array.dictionary_decode())
    if _is_bytes(kind):
        return [None if one is None else b64encode(one).decode() for one in array.to_pylist()]
    if _types.is_map(kind):
        pairs = zip(values(array.keys), values(array.items), strict=True)
        return [None if one is None else dict(map(_entry, one)) for one in _cut(array, list(pairs))]
    if _types.is_list(kind) or _types.is_large_list(kind):
        return _cut(array, values(array.values))
    if _types.is_struct(kind):
        names = [kind.field(place).name for place in range(kind.num_fields)]
        columns = [values(column) for column in array.flatten()]
        rows = zip(*columns, strict=True) if columns else (() for _ in range(len(array)))
        found = [dict(zip(names, row, strict=True)) for row in rows]
        return [one if valid else None for one, valid in zip(found, array.is_valid().to_pylist(), strict=True)]
    if _types.is_boolean(kind) or _types.is_integer(kind) or _types.is_floating(kind) or _types.is_string(kind):
        return list(array.to_pylist())
    return _texts(array)


def _cells(array: pa.Array) -> pa.Array:
    kind = array.type
    if _types.is_dictionary(kind):
        return _cells(array.dictionary_decode())
    if _is_bytes(kind):
        return pa.array([None if one is None else one.hex() for one in array.to_pylist()], pa.string())
    if _types.is_nested(kind):
        texts = [None if one is None else msgspec.json.encode(one).decode() for one in values(array)]
        return pa.array(texts, pa.string())
    if _types.is_boolean(kind) or _types.is_integer(kind) or _types.is_floating(kind) or _types.is_string(kind):
        return array
    return pa.array(_texts(array), pa.string())


def _texts(array: pa.Array) -> list[str | None]:
    """Times, and whatever else an answer of SQL may hold."""
    try:
        texts = array.cast(pa.string()).to_pylist()
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        texts = [None if not one.is_valid else str(one) for one in array]
    if _types.is_timestamp(array.type):
        return [None if text is None else text.replace(" ", "T") for text in texts]
    return list(texts)


def _is_bytes(kind: pa.DataType) -> bool:
    return bool(_types.is_binary(kind) or _types.is_large_binary(kind) or _types.is_fixed_size_binary(kind))


def _cut(array: pa.Array, items: list[Any]) -> list[Any]:
    """The items of each list."""
    offsets = array.offsets.to_pylist()
    valid = array.is_valid().to_pylist()
    return [
        items[start:end] if is_there else None
        for start, end, is_there in zip(offsets[:-1], offsets[1:], valid, strict=True)
    ]


def _entry(pair: tuple[Any, Any]) -> tuple[str, Any]:
    key, value = pair
    return key if isinstance(key, str) else str(key), value


def csv_text(rows: pa.RecordBatch, *, with_header: bool) -> str:
    """Rows as lines of CSV."""
    sink = pa.BufferOutputStream()
    csv.write_csv(cells(rows), sink, csv.WriteOptions(include_header=with_header))
    return bytes(sink.getvalue()).decode()
