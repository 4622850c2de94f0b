"""Hypothesis strategies for every message, request and reply, made from its own types and bounds."""

from enum import Enum
from typing import Any

import msgspec
from hypothesis import strategies as st
from msgspec import inspect

from schemas.messages import Message
from schemas.requests import Request
from schemas.subjects import COMMANDS, SUBJECTS, Command, Subject

INT64 = st.integers(-(2**63), 2**63 - 1)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)
"""Whatever MessagePack can say."""


def message_of(kind: type[Message]) -> st.SearchStrategy[Message]:
    """Any message of this class."""
    return _values(inspect.type_info(kind))


@st.composite
def subjects_and_messages(draw: st.DrawFn) -> tuple[Subject, Message]:
    """Any subject and any message of it."""
    subject = draw(st.sampled_from(SUBJECTS))
    return subject, draw(message_of(subject.type))


def any_of(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    """Anything of this class: a message, a request or a reply."""
    return _values(inspect.type_info(kind))


@st.composite
def commands_and_requests(draw: st.DrawFn) -> tuple[Command, Request]:
    """Any verb and any request of it."""
    command = draw(st.sampled_from(COMMANDS))
    request: Request = draw(any_of(command.request))
    return command, request


def _values(info: inspect.Type) -> st.SearchStrategy[Any]:
    match info:
        case inspect.Metadata():
            values = _values(info.type)
        case inspect.StructType():
            values = st.builds(info.cls, **{field.name: _values(field.type) for field in info.fields})
        case inspect.EnumType():
            values = st.sampled_from(list[Enum](info.cls))
        case inspect.IntType():
            values = st.integers(info.ge, info.le) if info.ge is not None else INT64
        case inspect.FloatType():
            values = st.floats(min_value=info.ge, max_value=info.le, allow_nan=False, allow_infinity=False)
        case inspect.ListType():
            values = st.lists(_values(info.item_type), max_size=4)
        case inspect.DictType():
            values = st.dictionaries(_values(info.key_type), _values(info.value_type), max_size=4)
        case inspect.UnionType():
            values = st.one_of([_values(part) for part in info.types])
        case inspect.StrType() | inspect.BytesType():
            values = _sized(info)
        case _:
            values = _SIMPLE[type(info)]
    return values


def _sized(info: inspect.StrType | inspect.BytesType) -> st.SearchStrategy[Any]:
    least = info.min_length or 0
    if isinstance(info, inspect.StrType):
        return TEXTS.filter(lambda text: len(text) >= least)
    return st.binary(min_size=least, max_size=info.max_length or 64)


_SIMPLE: dict[type[inspect.Type], st.SearchStrategy[Any]] = {
    inspect.BoolType: st.booleans(),
    inspect.NoneType: st.none(),
}
