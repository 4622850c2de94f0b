"""The messages of one channel to the record batch of its table."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recorder.mcap.arrays import Bytes, Numbers, Places
from recorder.review.columns import arrays, parsed
from recorder.review.columns.layout import Layout, find_layout
from recorder.review.columns.shape import INT64_MAX, Shape
from recorder.review.columns.tables import HEAD, TIME_TYPE, Columns, shown

WORTH_A_LAYOUT: Final = 12
"""So many messages at least: for fewer the protobuf package is as fast."""

LAYOUTS_MAX: Final = 8
"""Layouts that are tried of one length; what fits none goes to the protobuf package."""

_LENGTHS_MAX: Final = 1000
"""Lengths whose layouts are remembered."""

_WORD: Final = 8


class _Pattern(msgspec.Struct, frozen=True):
    """A layout, and a message of it to compare others with, padding included."""

    layout: Layout
    example: NDArray[np.uint64]
    mask: NDArray[np.uint64]


_Part = tuple[Numbers, list[pa.Array]]
"""Which messages, and their columns."""


class Decoder:
    """Turns the messages of a topic into record batches.

    Args:
        columns: the topic's columns.
        wanted: names of the columns that are to be made; None is all.

    Attributes:
        schema: of the batches.
        broken: messages so far that could not be read.
    """

    def __init__(self, columns: Columns, wanted: Collection[str] | None = None) -> None:
        self.columns = columns
        self.broken = 0
        names = columns.schema.names
        is_wanted = [wanted is None or name in wanted for name in names]
        self.schema = pa.schema([field for field, wants in zip(columns.schema, is_wanted, strict=True) if wants])
        self._wants_head = is_wanted[: len(HEAD)]
        self._wants_data = any(is_wanted[len(HEAD) :])
        self._shape: Shape | None = None
        self._read: Callable[[bytes], Any] = bytes
        if columns.shape is not None and columns.read is not None:
            self._read = columns.read
            kept = [number for number, wants in zip(columns.kept, is_wanted[len(HEAD) :], strict=True) if wants]
            self._shape = msgspec.structs.replace(
                columns.shape, fields=tuple(columns.shape.fields[number] for number in kept)
            )
        self._patterns: dict[int, list[_Pattern]] = {}

    def batch(self, content: Bytes, places: Places) -> pa.RecordBatch:
        """The messages at these places. Those that cannot be read are left out and counted.

        Args:
            content: records of messages, and padding behind.
            places: proven, in the order of the file.
        """
        if self._shape is None:
            rows, found = self._bytes(content, places)
        else:
            rows, found = self._fields(self._shape, content, places)
        if rows is not None:
            self.broken += len(places.offsets) - len(rows)
            places = places.only(rows)
        return pa.RecordBatch.from_arrays([*self._head(content, places), *found], schema=self.schema)

    def _head(self, content: Bytes, places: Places) -> list[pa.Array]:
        found = []
        if self._wants_head[0]:
            found.append(times(places.log_ns(content)))
        if self._wants_head[1]:
            found.append(times(places.publish_ns(content)))
        if self._wants_head[2]:
            found.append(arrays.bare_array(pa.int64(), places.sequences(content).astype(np.int64)))
        return found

    def _bytes(self, content: Bytes, places: Places) -> tuple[Numbers | None, list[pa.Array]]:
        """The one column of a topic that is not protobuf."""
        if not self._wants_data:
            return None, []
        values = pa.array(message_bytes(content, places), pa.binary())
        if self.schema.field(len(self.schema) - 1).type == pa.binary():
            return None, [values]
        try:
            return None, [values.cast(pa.string())]
        except pa.ArrowInvalid:
            texts = [_text_of(value) for value in values.to_pylist()]
            rows = np.array([row for row, text in enumerate(texts) if text is not None], np.int64)
            return rows, [pa.array([text for text in texts if text is not None], pa.string())]

    def _fields(self, shape: Shape, content: Bytes, places: Places) -> tuple[Numbers | None, list[pa.Array]]:
        """The columns of a shape, and which messages they are of; None is all."""
        parts = self._parts(shape, content, places)
        if len(parts) == 1 and len(parts[0][0]) == len(places.offsets):
            return None, [shown(field, one) for field, one in zip(shape.fields, parts[0][1], strict=True)]
        rows = np.concatenate([part[0] for part in parts])
        order = np.argsort(rows)
        taken = pa.array(order)
        found = []
        for number, field in enumerate(shape.fields):
            joined = pa.concat_arrays([part[1][number] for part in parts])
            found.append(shown(field, joined.take(taken)))
        return rows[order], found

    def _parts(self, shape: Shape, content: Bytes, places: Places) -> list[_Part]:
        parts: list[_Part] = []
        left: list[Numbers] = []
        for length, group in _groups(places.lengths):
            remaining = group
            if shape.is_simple and (len(group) >= WORTH_A_LAYOUT or length in self._patterns):
                found, remaining = self._alike(shape, content, places.offsets, group, length)
                parts += found
            if len(remaining):
                left.append(remaining)
        if left or not parts:
            rows = np.sort(np.concatenate(left)) if left else np.empty(0, np.int64)
            messages = message_bytes(content, places.only(rows))
            found_arrays, broken = parsed.columns(shape, self._read, messages)
            parts.append((np.delete(rows, broken), found_arrays))
        return parts

    def _alike(
        self, shape: Shape, content: Bytes, offsets: Numbers, group: Numbers, length: int
    ) -> tuple[list[_Part], Numbers]:
        """The columns of messages of one length, layout by layout, and those that fit none."""
        width = -(-length // _WORD) * _WORD
        records: NDArray[np.void] = np.ndarray((len(content) - width + 1,), f"V{width}", content, 0, (1,))
        matrix = records[offsets[group]].view(np.uint64).reshape(len(group), width // _WORD)
        if len(self._patterns) > _LENGTHS_MAX:
            self._patterns.clear()
        patterns = self._patterns.setdefault(length, [])
        parts: list[_Part] = []
        tried = 0
        while len(group) and tried < LAYOUTS_MAX:
            if tried == len(patterns):
                if tried and len(group) < WORTH_A_LAYOUT:
                    break
                pattern = _pattern(shape, matrix[0], length)
                if pattern is None:
                    break
                patterns.append(pattern)
            pattern = patterns[tried]
            tried += 1
            differs = _differences(matrix, pattern)
            if not differs.any():
                alike, matrix_alike, group_left = group, matrix, group[:0]
            else:
                same = ~differs
                alike, matrix_alike, group_left = group[same], matrix[same], group[differs]
                matrix = matrix[differs]
            if len(alike):
                rows = matrix_alike.view(np.uint8)[:, :length]
                parts.append((alike, arrays.columns(shape, pattern.layout.places, rows)))
            group = group_left
        return parts, group


def times(numbers: NDArray[np.unsignedinteger]) -> pa.Array:
    """Nanoseconds since 1970 as Arrow has them: those beyond what it can hold are the last that it can."""
    return arrays.bare_array(TIME_TYPE, np.minimum(numbers, np.uint64(INT64_MAX)))


def message_bytes(content: Bytes, places: Places) -> list[bytes]:
    """The data of each message."""
    view = memoryview(content.data)
    ends = (places.offsets + places.lengths).tolist()
    return [bytes(view[start:end]) for start, end in zip(places.offsets.tolist(), ends, strict=True)]


def _text_of(value: bytes) -> str | None:
    try:
        return value.decode()
    except UnicodeDecodeError:
        return None


def _groups(lengths: Numbers) -> Sequence[tuple[int, Numbers]]:
    """Which messages have each length."""
    if not len(lengths):
        return []
    if lengths.min() == lengths.max():
        return [(int(lengths[0]), np.arange(len(lengths)))]
    unique, which = np.unique(lengths, return_inverse=True)
    order = np.argsort(which, kind="stable")
    starts = np.searchsorted(which[order], np.arange(len(unique) + 1))
    return [
        (int(length), order[start:end]) for length, start, end in zip(unique, starts[:-1], starts[1:], strict=True)
    ]


def _pattern(shape: Shape, message: NDArray[np.uint64], length: int) -> _Pattern | None:
    data = message.tobytes()
    layout = find_layout(shape, data[:length])
    if layout is None:
        return None
    mask = layout.mask.ljust(len(data), b"\0")
    return _Pattern(layout, message.copy(), np.frombuffer(mask, np.uint64))


def _differences(matrix: NDArray[np.uint64], pattern: _Pattern) -> NDArray[np.bool_]:
    """Which messages are not of the pattern."""
    differs: Any = np.zeros(len(matrix), np.uint64)
    for place in np.flatnonzero(pattern.mask):
        differs |= (matrix[:, place] ^ pattern.example[place]) & pattern.mask[place]
    return np.asarray(differs != 0)
