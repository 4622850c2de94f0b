"""Versions of schemas: samples and requests of other versions, judged where they arrive.

An encoding names a schema and its version. Without a new version a message may get fields, which older receivers
leave out, and an enumeration may get values, which they keep as the words that came.
"""

from __future__ import annotations

import re
from enum import Enum
from functools import lru_cache
from typing import Any, Final, Literal, TypeVar, get_args, get_origin

_ENCODING: Final = re.compile(
    r"application/msgpack;(?P<schema>cruiser(\.[A-Za-z]{1,64}){1,2})/(?P<version>[0-9]{1,9})"
)

_VALUE: Final = re.compile(r"[a-z][a-z0-9_]{0,63}")

_MEMBERS_KEPT: Final = 1024
"""So many values of others' versions are remembered."""

_MAP_16: Final = 0xDE
_FIX_MAP: Final = 0x80

Member = TypeVar("Member", bound=Enum)


def encoding_fault(encoding: str, known: str, receiver: str, sender: str) -> str:
    """Describe what is wrong with an encoding that is not the known one, and who is to be upgraded.

    Args:
        encoding: as it came.
        known: the one that this version knows.
        receiver: who knows it: ``the gateway``.
        sender: who sent the other.
    """
    theirs, ours = _ENCODING.fullmatch(encoding), _ENCODING.fullmatch(known)
    if theirs is None or ours is None or theirs["schema"] != ours["schema"]:
        return f"{encoding[:100]!a} is not {known}"
    return (
        f"version {theirs['version']} of {ours['schema']}, and {receiver} knows {ours['version']}: "
        f"upgrade {sender if other_version(encoding, known) == 'older' else receiver}"
    )


def other_version(encoding: str, known: str) -> Literal["newer", "older", ""]:
    """Report how another version of the known schema stands to it; empty for the same, and for another schema."""
    theirs, ours = _ENCODING.fullmatch(encoding), _ENCODING.fullmatch(known)
    if theirs is None or ours is None or theirs["schema"] != ours["schema"]:
        return ""
    step = int(theirs["version"]) - int(ours["version"])
    return "newer" if step > 0 else "older" if step else ""


def names_schema(encoding: str) -> bool:
    """Report whether an encoding names a schema of ours, of whatever version."""
    return _ENCODING.fullmatch(encoding) is not None


def member_of(kind: type[Member], value: str) -> Member | None:
    """The member of an enumeration that has this value, or one made for it if the value is of another version.

    Such a member is none of those that the enumeration lists: it equals itself alone, and its value is the word
    that came. None where that is no word such as values are.
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
    """Report whether a member is of another version than this one."""
    return type(member).__members__.get(member.name) is not member


def count_fields(payload: bytes) -> int:
    """The number of fields that a MessagePack map says it has; 0 if the payload is no map, or a huge one."""
    first = payload[0] if payload else 0
    if first & 0xF0 == _FIX_MAP:
        return first & 0x0F
    return int.from_bytes(payload[1:3], "big") if first == _MAP_16 else 0


def enumeration_in(annotation: Any) -> tuple[type[Enum], bool] | None:  # noqa: ANN401 - whatever a field is annotated with
    """The enumeration of a field, and whether the field is a list of them; None if it is of another type."""
    is_list = get_origin(annotation) is list
    kind = get_args(annotation)[0] if is_list else annotation
    return (kind, is_list) if isinstance(kind, type) and issubclass(kind, Enum) else None
