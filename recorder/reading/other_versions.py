"""Schemas of logs that another version wrote: whether its messages mean the same here, and the words it has more.

Numbers of fields are places in a class, and those of values places in an enumeration: what is added goes to the
end. So an older log lacks what came later, and a newer one has more. Where a number means something else, the
messages are read by the log's own schema alone, as anybody else's.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from functools import lru_cache
from typing import Final

import msgspec
from google.protobuf.descriptor_pb2 import DescriptorProto, EnumDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError

from recorder.encoding.protobuf_schema import descriptor_set
from schemas.can_word import snake_case
from schemas.codec import member_of

RENAMED: Final = {"REASON_TICK_UNKNOWN": "REASON_CHALLENGE_UNKNOWN"}
"""Values of enumerations that older logs call otherwise."""

PROTO3: Final = "proto3"
"""The syntax of our schemas. In another one a field that is not in a record may have any value."""

_KEPT: Final = 256


@lru_cache(_KEPT)
def means_the_same(kind: type[msgspec.Struct], descriptors: bytes) -> bool:
    """Report whether what a log's schema and the one of this version have in common means the same."""
    if descriptors == descriptor_set(kind):
        return True
    try:
        theirs = FileDescriptorSet.FromString(descriptors)
    except DecodeError:
        return False
    files = FileDescriptorSet.FromString(descriptor_set(kind)).file
    messages = {name: one for file in files for name, one in _by_name(file.package, file.message_type)}
    enums = {(file.package, one.name): one for file in files for one in file.enum_type}
    # All of theirs: one that fits, of the same name, may stand beside one by which others read.
    return (
        all(file.syntax == PROTO3 and not file.extension for file in theirs.file)
        and all(
            name not in messages or _fits(messages[name], one)
            for file in theirs.file
            for name, one in _by_name(file.package, file.message_type)
        )
        and all(
            (file.package, one.name) not in enums or _numbers_fit(enums[file.package, one.name], one)
            for file in theirs.file
            for one in file.enum_type
        )
    )


@lru_cache(_KEPT)
def newer_members(kind: type[Enum], descriptors: bytes) -> tuple[Enum, ...]:
    """Members made for the values that an enumeration has more in a log's schema, in their order."""
    prefix = f"{snake_case(kind.__name__).upper()}_"
    words = [
        value.name.removeprefix(prefix).lower()
        for file in FileDescriptorSet.FromString(descriptors).file
        for enum in file.enum_type
        if enum.name == kind.__name__
        for value in sorted(enum.value, key=lambda one: one.number)[len(kind) :]
    ]
    members = [member_of(kind, word) for word in words]
    return tuple(member for member in members if member is not None)


def _by_name(package: str, messages: Iterable[DescriptorProto]) -> Iterable[tuple[str, DescriptorProto]]:
    for one in messages:
        name = f"{package}.{one.name}"
        yield name, one
        yield from _by_name(name, one.nested_type)


def _fits(ours: DescriptorProto, theirs: DescriptorProto) -> bool:
    """A field of both is the same in all that its descriptor says."""
    mine = {one.number: one for one in ours.field}
    numbers = {one.name: one.number for one in ours.field}
    return theirs.options == ours.options and all(
        mine.get(one.number, one) == one and numbers.get(one.name, one.number) == one.number
        for one in theirs.field
    )


def _numbers_fit(ours: EnumDescriptorProto, theirs: EnumDescriptorProto) -> bool:
    names = {one.number: one.name for one in ours.value}
    numbers = {one.name: one.number for one in ours.value}
    counted = sorted(one.number for one in theirs.value) == list(range(len(theirs.value)))
    return counted and all(
        names.get(one.number, name) == name and numbers.get(name, one.number) == one.number
        for one in theirs.value
        for name in (RENAMED.get(one.name, one.name),)
    )
