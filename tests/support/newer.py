"""A peer of a newer version: its encodings, fields and values that this version does not have."""

from enum import Enum
from typing import Any

import msgpack
import msgspec
from hypothesis import strategies as st
from msgspec import inspect

from schemas.messages import Message
from schemas.recording import RecorderReply
from schemas.subjects import ALL_SUBJECTS, COMMANDS, Subject
from tests.support.strategies import any_of, message_of

NEW_WORD = "of_a_newer_version"  # no enumeration of this version has it
# Every class that a reader receives from others.
READ: tuple[type[msgspec.Struct], ...] = (
    *dict.fromkeys(subject.type for subject in ALL_SUBJECTS),
    *dict.fromkeys(command.reply for command in COMMANDS),
    RecorderReply,
)


def newer(encoding: str, by: int = 1) -> str:
    name, _, version = encoding.rpartition("/")
    return f"{name}/{int(version) + by}"


def with_new_fields(message: msgspec.Struct, **fields: object) -> bytes:
    values: dict[str, Any] = msgpack.unpackb(msgspec.msgpack.encode(message))
    payload: bytes = msgpack.packb(values | (fields or {"new_field": [1, {"new": True}]}))
    return payload


def enumerations(kind: type[msgspec.Struct]) -> list[tuple[str, ...]]:
    """The paths of all fields of a class that hold values of an enumeration."""
    found: list[tuple[str, ...]] = []

    def look(info: inspect.Type, path: tuple[str, ...]) -> None:
        match info:
            case inspect.EnumType():
                found.append(path)
            case inspect.Metadata():
                look(info.type, path)
            case inspect.ListType():
                look(info.item_type, path)
            case inspect.DictType():
                look(info.value_type, path)
            case inspect.UnionType():
                for part in info.types:
                    look(part, path)
            case inspect.StructType():
                for field in info.fields:
                    look(field.type, (*path, field.name))
            case _:
                pass

    look(inspect.type_info(kind), ())
    return found


def with_new_word(message: msgspec.Struct, path: tuple[str, ...], word: str = NEW_WORD) -> bytes:
    """The payload with an unknown enumeration value at the end of a path."""
    values: Any = msgpack.unpackb(msgspec.msgpack.encode(message))
    inner = values
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = [*inner[path[-1]], word] if isinstance(inner[path[-1]], list) else word
    payload: bytes = msgpack.packb(values)
    return payload


def value_at(message: msgspec.Struct, path: tuple[str, ...]) -> Any:  # noqa: ANN401 - whatever the field holds
    value: Any = message
    for name in path:
        value = getattr(value, name)
    return value[-1] if isinstance(value, list) else value


@st.composite
def growing_fields(draw: st.DrawFn) -> tuple[msgspec.Struct, tuple[str, ...]]:
    """Any message or reply with values of enumerations, and the path of one."""
    kind = draw(st.sampled_from([kind for kind in READ if enumerations(kind)]))
    return draw(any_of(kind)), draw(st.sampled_from(enumerations(kind)))


@st.composite
def grown_messages(draw: st.DrawFn) -> tuple[Subject, Message, tuple[str, ...]]:
    """Any subject with values of enumerations, a message of it, and the path of one."""
    subject = draw(st.sampled_from([one for one in ALL_SUBJECTS if enumerations(one.type)]))
    return subject, draw(message_of(subject.type)), draw(st.sampled_from(enumerations(subject.type)))


def is_new(value: object) -> bool:
    return isinstance(value, Enum) and value.value == NEW_WORD and value not in list(type(value))
