"""The proof that messages are what their schema says.

Most of ours have but fields of fixed width, so all bytes but the values themselves are known beforehand: they are
held against many messages at once. Where that leaves a doubt, and for all other messages, each is decoded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from struct import calcsize
from typing import Any, Final

import msgspec
from mcap import records
from msgspec import inspect

from recorder.encoding.foxglove_log import SCHEMA_DATA, SCHEMA_NAME
from recorder.encoding.protobuf_schema import LOGGED, descriptor_set, fields, message_class, schema_name
from recorder.encoding.transcode import packed_fields
from recorder.reading.other_versions import means_the_same
from recorder.reading.topics import UNREADABLE, foreign_decoder

Proof = Callable[[list[bytes]], Sequence[int]]
"""Messages of a channel to the places of those that are not what their schema says."""

_OURS: Final = {
    **{schema_name(kind): (kind, descriptor_set(kind)) for kind in LOGGED},
    SCHEMA_NAME: (None, SCHEMA_DATA),
}
"""Schemas that this version writes: class, if it is one of ours, and schema."""

_NUMBERS: Final = frozenset("IiQqd")
_VARINT_BOUND: Final = 0x80

ANY_JSON: Final = msgspec.json.Decoder(msgspec.Raw).decode


def faults_of_schema(schema: records.Schema) -> list[str]:
    """The faults of a schema: it cannot be read, or is another than this version writes under that name."""
    faults = []
    if schema.encoding == "protobuf" and foreign_decoder(schema.name, schema.data) is None:
        faults.append(f"the schema {schema.name} cannot be read")
    elif schema.encoding == "jsonschema" and _is_no_json(schema.data):
        faults.append(f"the schema {schema.name} is no JSON")
    if schema.name in _OURS and not faults and not _is_of_a_version(schema):
        faults.append(f"the schema {schema.name} is not the one that this version writes")
    return faults


def _is_of_a_version(schema: records.Schema) -> bool:
    """Report whether it is what this version writes, or an older or newer one did."""
    kind, data = _OURS[schema.name]
    if schema.encoding != "protobuf":
        return False
    return schema.data == data or (kind is not None and means_the_same(kind, schema.data))


def proof_of(channel: records.Channel, schema: records.Schema | None) -> Proof | None:
    """The proof of a channel's messages; None if nobody here can read them."""
    if channel.message_encoding == "json":
        return lambda datas: _undecodable(datas, ANY_JSON)
    if channel.message_encoding != "protobuf" or schema is None:
        return None
    kind, data = _OURS.get(schema.name, (None, b""))
    if kind is not None and data == schema.data:
        return _own_proof(kind)
    decode = foreign_decoder(schema.name, schema.data)
    return None if decode is None else lambda datas: _undecodable(datas, decode)


def _is_no_json(data: bytes) -> bool:
    # MCAP allows an empty one: any JSON.
    return bool(data) and bool(_undecodable([data], ANY_JSON))


def _undecodable(datas: Iterable[bytes], decode: Callable[[bytes], Any]) -> list[int]:
    wrong = []
    for place, data in enumerate(datas):
        try:
            decode(data)
        except UNREADABLE:
            wrong.append(place)
    return wrong


@cache
def _own_proof(kind: type[msgspec.Struct]) -> Proof:
    decode: Any = message_class(kind).FromString
    layout = _layout(kind)
    if layout is None:
        return lambda datas: _undecodable(datas, decode)
    return lambda datas: () if layout.fits(datas) else _undecodable(datas, decode)


class _Layout(msgspec.Struct, frozen=True):
    """The record of a class whose fields all have a fixed width, as ``recorder.encoding.transcode`` writes it.

    Attributes:
        length: of every record.
        tags: place and value of each byte of a tag.
        bounds: place of each flag and enumeration, and what it is below.
    """

    length: int
    tags: list[tuple[int, int]]
    bounds: list[tuple[int, int]]

    def fits(self, datas: list[bytes]) -> bool:
        """Report whether all of these are such records; one may be a good record and fit all the same not."""
        length, count = self.length, len(datas)
        joined = b"".join(datas)
        return (
            len(joined) == length * count
            and set(map(len, datas)) == {length}
            and all(joined[at::length].count(tag) == count for at, tag in self.tags)
            and all(max(joined[at::length]) < bound for at, bound in self.bounds)
        )


def _layout(kind: type[msgspec.Struct]) -> _Layout | None:
    packed = packed_fields(kind, {}, "")
    if packed.parts:
        return None
    at = 0
    tags, bounds = [], []
    for place, (_, _, field) in enumerate(fields(kind)):
        tag = int(packed.arguments[place].partition(",")[0])
        tag_form, form = packed.layout[2 * place], packed.layout[2 * place + 1]
        width = calcsize(f"<{tag_form}")
        tags += [(at + byte, tag >> 8 * byte & 0xFF) for byte in range(width)]
        at += width
        if form not in _NUMBERS:
            bounds.append((at, len(field.cls) if isinstance(field, inspect.EnumType) else _VARINT_BOUND))
        at += calcsize(f"<{form}")
    return _Layout(at, tags, bounds)
