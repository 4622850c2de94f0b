"""The proof that messages are what their schema says.

Most of ours have but fields of fixed width, so all bytes but the values themselves are known beforehand: they are
compared for many messages at once. Where that leaves a doubt, and for all other messages, each is decoded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from struct import calcsize
from typing import Any, Final

import msgspec
import numpy as np
from mcap import records
from msgspec import inspect
from numpy.typing import NDArray

from recorder.encoding.foxglove_log import SCHEMA_DATA, SCHEMA_NAME
from recorder.encoding.protobuf_schema import LOGGED, descriptor_set, fields, message_class, schema_name
from recorder.encoding.transcode import packed_fields
from recorder.mcap.arrays import Bytes, Places
from recorder.reading.other_versions import means_the_same
from recorder.reading.topics import UNREADABLE, foreign_decoder

Proof = Callable[[Bytes, Places], Sequence[int]]
"""Messages of a channel to the numbers of those that are not what their schema says."""

_OURS: Final = {
    **{schema_name(kind): (kind, descriptor_set(kind)) for kind in LOGGED},
    SCHEMA_NAME: (None, SCHEMA_DATA),
}
"""Schemas that this version writes: class, if it is one of ours, and schema."""

_FIXED_WIDTH: Final = inspect.IntType | inspect.FloatType | inspect.BoolType | inspect.EnumType
_NUMBERS: Final = frozenset("IiQqd")
_VARINT_BOUND: Final = 0x80

ANY_JSON: Final = msgspec.json.Decoder(msgspec.Raw).decode


class Layout(msgspec.Struct, frozen=True):
    """Records of a class that differ in the values of fields of fixed width, and in a tail, alone.

    Attributes:
        length: of every record.
        fixed_at, fixed: place and value of each byte that all have in common.
        bounds_at, bounds: place of each flag and enumeration, and what it is below.
        row: the fields of fixed width, by name, and ``tail``, if there is one.
    """

    length: int
    fixed_at: list[int]
    fixed: NDArray[np.uint8]
    bounds_at: list[int]
    bounds: NDArray[np.uint8]
    row: np.dtype[Any]

    def rows(self, content: Bytes, places: Places) -> tuple[NDArray[np.bool_], NDArray[Any]]:
        """Which messages are surely such records, and the fields of these; others may be good too."""
        fits = places.lengths == self.length
        if not fits.any():
            return fits, np.empty(0, self.row)
        rows = np.lib.stride_tricks.sliding_window_view(content, self.length)[places.offsets[fits]]
        good = (rows[:, self.fixed_at] == self.fixed).all(axis=1)
        good &= (rows[:, self.bounds_at] < self.bounds).all(axis=1)
        fits[fits] = good
        return fits, (rows if good.all() else rows[good]).view(self.row)[:, 0]


def layout_of(kind: type[msgspec.Struct], record: bytes = b"", tail: int = 0) -> Layout | None:
    """The layout of a class's records; None if they may have any length, and no record is given.

    Args:
        kind: the class.
        record: one of those that the layout is of...
        tail: ...and how many bytes at its end may have any value.
    """
    packed = packed_fields(kind, {}, "")
    if packed.parts and not record:
        return None
    at = 0
    fixed: dict[int, int] = {}
    bounds: dict[int, int] = {}
    row: list[tuple[str, str, int]] = []
    forms = zip(packed.layout[::2], packed.layout[1::2], packed.arguments, strict=True)
    of_fixed_width = [(name, field) for name, _, field in fields(kind) if isinstance(field, _FIXED_WIDTH)]
    for (name, field), (tag_form, form, argument) in zip(of_fixed_width, forms, strict=True):
        tag, width = int(argument.partition(",")[0]), calcsize(f"<{tag_form}")
        fixed.update((at + byte, tag >> 8 * byte & 0xFF) for byte in range(width))
        at += width
        if form not in _NUMBERS:
            bounds[at] = len(field.cls) if isinstance(field, inspect.EnumType) else _VARINT_BOUND
        row.append((name, f"<{form}", at))
        at += calcsize(f"<{form}")
    end = max(at, len(record))
    fixed.update((place, record[place]) for place in range(at, end - tail))
    if tail:
        row.append(("tail", f"{tail}u1", end - tail))
    names, formats, offsets = (list(column) for column in zip(*row, strict=True))
    return Layout(
        length=end,
        fixed_at=list(fixed),
        fixed=np.array(list(fixed.values()), np.uint8),
        bounds_at=list(bounds),
        bounds=np.array(list(bounds.values()), np.uint8),
        row=np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end}),
    )


def faults_of_schema(schema: records.Schema) -> list[str]:
    """The faults of a schema: it cannot be read, or is another than this version writes under that name."""
    if schema.encoding == "protobuf" and foreign_decoder(schema.name, schema.data) is None:
        return [f"the schema {schema.name} cannot be read"]
    # MCAP allows an empty one: any JSON.
    if schema.encoding == "jsonschema" and schema.data and _undecodable([schema.data], ANY_JSON):
        return [f"the schema {schema.name} is no JSON"]
    if schema.name in _OURS:
        kind, data = _OURS[schema.name]
        is_same = schema.data == data or (kind is not None and means_the_same(kind, schema.data))
        if schema.encoding != "protobuf" or not is_same:
            return [f"the schema {schema.name} is not the one that this version writes"]
    return []


def proof_of(channel: records.Channel, schema: records.Schema | None) -> Proof | None:
    """The proof of a channel's messages; None if nobody here can read them."""
    if channel.message_encoding == "json":
        return lambda content, places: _undecodable(datas(content, places), ANY_JSON)
    if channel.message_encoding != "protobuf" or schema is None:
        return None
    kind, data = _OURS.get(schema.name, (None, b""))
    if kind is not None and data == schema.data:
        return _own_proof(kind)
    decode = foreign_decoder(schema.name, schema.data)
    return None if decode is None else lambda content, places: _undecodable(datas(content, places), decode)


def datas(content: Bytes, places: Places) -> Iterator[bytes]:
    """The data of each message."""
    for start, length in zip(places.offsets.tolist(), places.lengths.tolist(), strict=True):
        yield content[start : start + length].tobytes()


def _undecodable(messages: Iterable[bytes], decode: Callable[[bytes], Any]) -> list[int]:
    wrong = []
    for number, data in enumerate(messages):
        try:
            decode(data)
        except UNREADABLE:
            wrong.append(number)
    return wrong


@cache
def _own_proof(kind: type[msgspec.Struct]) -> Proof:
    decode: Any = message_class(kind).FromString
    layout = layout_of(kind)
    if layout is None:
        return lambda content, places: _undecodable(datas(content, places), decode)

    def proof(content: Bytes, places: Places) -> Sequence[int]:
        fits, _ = layout.rows(content, places)
        doubtful = np.flatnonzero(~fits)
        wrong = _undecodable(datas(content, places.only(doubtful)), decode)
        found: list[int] = doubtful[wrong].tolist()
        return found

    return proof
