"""Encode and decode MessagePack; encodings that name a schema and its version.

A message may get new fields, and an enumeration new values, without a new version: older receivers ignore the
fields and treat the values as words.

``encode`` writes a map with string keys. ``decode`` checks types and bounds, and ignores unknown fields.
``understand`` is for readers: it also accepts unknown values of enumerations, and lists everything unknown.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import Enum
from functools import cache, lru_cache
from math import isfinite
from threading import Lock
from typing import Any, Final, Generic, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from schemas.messages import Message
from schemas.requests import Request
from schemas.subjects import BY_TYPE, Subject, Verb

_ENCODING: Final = re.compile(
    r"application/msgpack;(?P<schema>cruiser(\.[A-Za-z]{1,64}){1,2})/(?P<version>[0-9]{1,9})"
)

_VALUE: Final = re.compile(r"[a-z][a-z0-9_]{0,63}")

_MEMBERS_KEPT: Final = 1024  # cached members for values of other versions

_MAP_16: Final = 0xDE
_FIX_MAP: Final = 0x80

Member = TypeVar("Member", bound=Enum)


def encoding_fault(encoding: str, known: str, receiver: str, sender: str) -> str:
    """Describe the difference between an encoding and the known one, and which side to upgrade."""
    theirs, ours = _ENCODING.fullmatch(encoding), _ENCODING.fullmatch(known)
    if theirs is None or ours is None or theirs["schema"] != ours["schema"]:
        return f"{encoding[:100]!a} is not {known}"
    return (
        f"version {theirs['version']} of {ours['schema']}, and {receiver} knows {ours['version']}: "
        f"upgrade {sender if other_version(encoding, known) == 'older' else receiver}"
    )


def other_version(encoding: str, known: str) -> Literal["newer", "older", ""]:
    """Return whether an encoding is a newer or older version of the known schema; empty if neither."""
    theirs, ours = _ENCODING.fullmatch(encoding), _ENCODING.fullmatch(known)
    if theirs is None or ours is None or theirs["schema"] != ours["schema"]:
        return ""
    step = int(theirs["version"]) - int(ours["version"])
    return "newer" if step > 0 else "older" if step else ""


def names_schema(encoding: str) -> bool:
    return _ENCODING.fullmatch(encoding) is not None


def member_of(kind: type[Member], value: str) -> Member | None:
    """The member of an enumeration with this value, or one made for a value of another version.

    A made member is not listed by the enumeration and equals only itself. None if the text cannot be a value.
    """
    try:
        return kind(value)
    except ValueError:
        return _foreign_member(kind, value) if _VALUE.fullmatch(value) else None


@lru_cache(_MEMBERS_KEPT)
def _foreign_member(kind: type[Member], value: str) -> Member:
    member = object.__new__(kind)
    member._name_ = value.upper()
    member._value_ = value
    return member


def is_foreign(member: Enum) -> bool:
    return type(member).__members__.get(member.name) is not member


def count_fields(payload: bytes) -> int:
    """The number of fields of a MessagePack map by its header; 0 if the payload is not a map, or a huge one."""
    first = payload[0] if payload else 0
    if first & 0xF0 == _FIX_MAP:
        return first & 0x0F
    return int.from_bytes(payload[1:3], "big") if first == _MAP_16 else 0


def enumeration_in(annotation: Any) -> tuple[type[Enum], bool] | None:  # noqa: ANN401 - of any field
    """The enumeration of a field, and True if the field is a list of it; None for other types."""
    is_list = get_origin(annotation) is list
    kind = get_args(annotation)[0] if is_list else annotation
    return (kind, is_list) if isinstance(kind, type) and issubclass(kind, Enum) else None


class PayloadFault(msgspec.Struct, frozen=True):
    """The fault in a payload. A value, not an exception: wire input never raises."""

    detail: str


encode: Final = msgspec.msgpack.Encoder().encode  # a message's MessagePack bytes


class Sample(msgspec.Struct, frozen=True, gc=False):
    """A payload to publish under a subject."""

    subject: str
    payload: bytes


def sample_of(message: Message) -> Sample:
    return Sample(BY_TYPE[type(message)].name, encode(message))


PAYLOAD_ERRORS: Final = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
"""Exceptions that decoding any payload may raise."""


def decode(subject: Subject, payload: bytes) -> Message | PayloadFault:
    try:
        message: Message = _reader(subject.type).decode(payload)
    except PAYLOAD_ERRORS as error:
        return PayloadFault(str(error))
    return message


Kind = TypeVar("Kind", bound=msgspec.Struct)


class Understood(msgspec.Struct, Generic[Kind], frozen=True, gc=False):
    """A message of another version, as far as this version knows it.

    Attributes:
        message: with members made for unknown values of enumerations.
        unknown: each such value, and each unknown field, by the field's name.
    """

    message: Kind
    unknown: tuple[str, ...] = ()


def understand(kind: type[Kind], payload: bytes) -> Understood[Kind] | PayloadFault:
    """Decode a message or reply of a newer version as far as possible. Not for requests.

    Unknown values cost one more decoding, unknown fields another.
    """
    decoder = _reader(kind)
    try:
        message = decoder.decode(payload)
    except PAYLOAD_ERRORS as error:
        fault = PayloadFault(str(error))
    else:
        try:
            return Understood(message, _unknown_fields(kind, payload))
        except (*PAYLOAD_ERRORS, TypeError) as error:  # from the name of an unknown field
            return PayloadFault(str(error))
    try:
        values: Any = _UNTYPED.decode(payload)
        foreign = _take_foreign(kind, values)
        message = _put_back(decoder.decode(encode(values)), foreign)
    except (*PAYLOAD_ERRORS, TypeError, OverflowError):
        return fault
    return Understood(message, (*_named(foreign), *_unknown_fields(kind, payload)))


def _take_foreign(kind: type[msgspec.Struct], values: dict[str, Any]) -> dict[str, Any]:
    """Remove unknown values of enumerations from a message; return members made for them, by field."""
    foreign: dict[str, Any] = {}
    for name, (inner, is_list) in _growing_fields(kind).items():
        value = values[name] if isinstance(values, dict) and name in values else None
        if value is None:
            continue
        if issubclass(inner, msgspec.Struct):
            within = _take_foreign(inner, value)
            if within:
                foreign[name] = within
            continue
        members = [_member(inner, word) for word in (value if is_list else [value])]
        if any(map(is_foreign, members)):
            values[name] = [] if is_list else _first_value(inner)
            foreign[name] = members if is_list else members[0]
    return foreign


def _first_value(kind: type[Enum]) -> object:
    return next(iter(kind)).value


def _member(kind: type[Enum], word: object) -> Enum:
    member = member_of(kind, word) if isinstance(word, str) else None
    if member is None:
        raise TypeError(f"{word!r} is no value of an enumeration")
    return member


def _put_back(message: Kind, foreign: dict[str, Any]) -> Kind:
    changes = {
        name: _put_back(getattr(message, name), value) if isinstance(value, dict) else value
        for name, value in foreign.items()
    }
    return msgspec.structs.replace(message, **changes)


def _named(foreign: dict[str, Any]) -> Iterator[str]:
    for name, value in foreign.items():
        if isinstance(value, dict):
            yield from _named(value)
        else:
            members = value if isinstance(value, list) else [value]
            yield from (f"{name} {member.value}" for member in members if is_foreign(member))


def _unknown_fields(kind: type[msgspec.Struct], payload: bytes) -> tuple[str, ...]:
    if count_fields(payload) <= len(kind.__struct_fields__):
        return ()
    names = set(_UNTYPED.decode(payload)) - set(kind.__struct_fields__)
    return tuple(f"field {str(name)[:FIELD_NAME_MAX]!a}" for name in sorted(names, key=str)[:UNKNOWN_NAMED])


@cache
def _growing_fields(kind: type[msgspec.Struct]) -> dict[str, tuple[type[Any], bool]]:
    """The fields with an enumeration, a list of one, or a nested message; True for a list."""
    hints = get_type_hints(kind)
    found = {name: enumeration_in(hints[name]) for name in kind.__struct_fields__}
    growing: dict[str, tuple[type[Any], bool]] = {name: one for name, one in found.items() if one is not None}
    for name in kind.__struct_fields__:
        if isinstance(hints[name], type) and issubclass(hints[name], msgspec.Struct):
            growing[name] = hints[name], False
    return growing


_BUILDING: Final = Lock()  # msgspec 0.22 crashes if two threads build decoders of one new type at once


@cache
def _reader(kind: type[Kind]) -> msgspec.msgpack.Decoder[Kind]:
    with _BUILDING:
        return msgspec.msgpack.Decoder(kind)


_UNTYPED: Final = msgspec.msgpack.Decoder()

UNKNOWN_NAMED: Final = 8  # most unknown fields that are listed
FIELD_NAME_MAX: Final = 64


def decode_request(verb: Verb[Any], payload: bytes) -> Request | PayloadFault:
    """The typed request of a payload, or its fault. Every number in a request is finite."""
    try:
        # A verb without required fields may be sent with an empty payload.
        request: Request = _reader(verb.request).decode(payload or _EMPTY_MAP)
    except PAYLOAD_ERRORS as error:
        return PayloadFault(str(error))
    for name in request.__struct_fields__:
        value = getattr(request, name)
        if isinstance(value, float) and not isfinite(value):
            return PayloadFault(f"{name} is not a finite number")
    return request


_EMPTY_MAP: Final = b"\x80"
