"""Where in a message's bytes each field stands. Pure.

A recorder writes the numbers of a class packed, in one order, tags included: two messages of one length are alike
in all bytes but the values. The layout of the first one says which bytes those are, and whether another message is
alike is then one comparison under a mask.
"""

from __future__ import annotations

from typing import Final, cast

import msgspec

from recorder.review.columns.shape import FIXED32, FIXED64, LENGTH, VARINT, Field, Shape, form_of

_TAG_BYTES_MAX: Final = 5
_VARINT_BYTES_MAX: Final = 9
"""One of ten bytes is a negative number in protobuf's least compact form; it is left to the protobuf package."""

_FIXED_BYTES: Final = {FIXED64: 8, FIXED32: 4}

_IS_MORE: Final = 0x80
"""The bit of a varint's byte that says that another one follows."""

_SAME: Final = 0xFF

Span = tuple[int, int]
"""Where a value begins in the message, and how many bytes it has, without tag and length."""

Place = Span | list[Span] | dict[int, "Place"]
"""Of a field: a span; of a repeated one several; of a message the places of its fields, by number."""


class Layout(msgspec.Struct, frozen=True):
    """A layout.

    Attributes:
        mask: of each byte the bits that are the same in all messages of this layout.
        places: by the number of the field; those that are absent are missing.
    """

    mask: bytes
    places: dict[int, Place]


class _NoLayoutError(Exception):
    """It is no message of this shape, or one that is better left to the protobuf package."""


def find_layout(shape: Shape, data: bytes) -> Layout | None:
    """The layout of a message; None if it has none."""
    if not shape.is_simple:
        return None
    found = _Finding(data)
    try:
        places = found.message(shape, 0, len(data))
    except (_NoLayoutError, RecursionError):
        return None
    return Layout(bytes(found.mask), places)


class _Finding:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self.mask = bytearray([_SAME]) * len(data)

    def message(self, shape: Shape, at: int, end: int) -> dict[int, Place]:
        """The places of the fields between two offsets."""
        places: dict[int, Place] = {}
        oneofs: set[str] = set()
        while at < end:
            tag, at = self._varint(at, end, _TAG_BYTES_MAX)
            number, wire = tag >> 3, tag & 7
            at, behind = self._value(wire, at, end)
            field = shape.by_number.get(number)
            is_packed = field is not None and field.is_repeated and wire == LENGTH
            if number == 0:
                raise _NoLayoutError
            if field is None or (wire != _wire(field) and not is_packed):
                self._free(wire, at, behind)
            elif field.is_repeated:
                spans = cast("list[Span]", places.setdefault(number, []))
                spans += self._repeated(field, wire, at, behind)
            elif number in places or (field.oneof and field.oneof in oneofs):
                raise _NoLayoutError  # Of two the last one holds, and messages are merged.
            else:
                oneofs.add(field.oneof)
                places[number] = self._single(field, at, behind)
            at = behind
        return places

    def _repeated(self, field: Field, wire: int, at: int, behind: int) -> list[Span]:
        form = form_of(field)
        if wire != LENGTH or form.wire == LENGTH:
            return [self._number_or_text(field, at, behind)]
        spans = []
        while at < behind:
            size = _FIXED_BYTES.get(form.wire)
            end = at + size if size else self._varint_end(at, behind, _VARINT_BYTES_MAX)
            if end > behind:
                raise _NoLayoutError
            spans.append(self._number_or_text(field, at, end))
            at = end
        return spans

    def _single(self, field: Field, at: int, behind: int) -> Place:
        if field.within is not None:
            return self.message(field.within, at, behind)
        return self._number_or_text(field, at, behind)

    def _number_or_text(self, field: Field, at: int, behind: int) -> Span:
        form = form_of(field)
        if form.wire != LENGTH:
            self._free(form.wire, at, behind)
            if field.is_bounded:
                self._fix_high_bits(behind - 1, behind)
        else:
            self._free(LENGTH, at, behind)
            if form.is_text:
                # What is not ASCII may be no UTF-8 either.
                self._fix_high_bits(at, behind)
        return at, behind - at

    def _fix_high_bits(self, at: int, behind: int) -> None:
        """Bytes whose highest bit is not set, in none of the messages."""
        if not self._data[at:behind].isascii():
            raise _NoLayoutError
        self.mask[at:behind] = b"\x80" * (behind - at)

    def _free(self, wire: int, at: int, behind: int) -> None:
        """Bytes that may be others in another message; of a varint not its length."""
        self.mask[at:behind] = bytes([_IS_MORE if wire == VARINT else 0]) * (behind - at)

    def _value(self, wire: int, at: int, end: int) -> Span:
        """Where the value behind a tag begins and ends."""
        if wire == VARINT:
            behind = self._varint_end(at, end, _VARINT_BYTES_MAX)
        elif wire in _FIXED_BYTES:
            behind = at + _FIXED_BYTES[wire]
        elif wire == LENGTH:
            length, at = self._varint(at, end, _TAG_BYTES_MAX)
            behind = at + length
        else:
            raise _NoLayoutError
        if behind > end:
            raise _NoLayoutError
        return at, behind

    def _varint_end(self, at: int, end: int, bytes_max: int) -> int:
        for place in range(at, min(end, at + bytes_max)):
            if not self._data[place] & _IS_MORE:
                return place + 1
        raise _NoLayoutError

    def _varint(self, at: int, end: int, bytes_max: int) -> Span:
        """A number, and what is behind it."""
        behind = self._varint_end(at, end, bytes_max)
        number = sum((self._data[place] & 0x7F) << 7 * (place - at) for place in range(at, behind))
        if number >= 1 << 31 and bytes_max == _TAG_BYTES_MAX:
            raise _NoLayoutError
        return number, behind


def _wire(field: Field) -> int:
    return LENGTH if field.form is None else field.form.wire
