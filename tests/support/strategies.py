"""Hypothesis strategies: frames and payloads of the chassis; every message, request and reply by its bounds."""

from enum import Enum
from typing import Any

import msgspec
from hypothesis import strategies as st
from msgspec import inspect

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import REMOTE, Frame
from gateway.chassis.layout import MessageLayout, to_raw
from schemas.messages import Message, Variant
from schemas.requests import Request
from schemas.subjects import COMMANDS, SUBJECTS, Command, Subject

VARIANTS = (Variant.COARSE, Variant.FINE)
LAYOUTS = [message for variant in VARIANTS for message in load(variant).messages.values()]
FEEDBACK = [message for message in LAYOUTS if message.is_feedback]
KNOWN_IDS = sorted({message.can_id for message in LAYOUTS})

payloads = st.binary(min_size=8, max_size=8)

can_ids = st.one_of(
    st.sampled_from(KNOWN_IDS),
    st.sampled_from(KNOWN_IDS).map(lambda can_id: can_id ^ 0x8000_0000),
    st.sampled_from(KNOWN_IDS).map(lambda can_id: can_id | 0x4000_0000),
    st.sampled_from(KNOWN_IDS).map(lambda can_id: can_id | 0x2000_0000),
    st.integers(0, 2**32 - 1),
)


@st.composite
def _frames(draw: st.DrawFn) -> Frame:
    can_id = draw(can_ids)
    return Frame(
        can_id,
        draw(st.one_of(payloads, st.binary(max_size=64))),
        draw(st.integers(0, 2**62)),
        draw(st.sampled_from([0, 0, 0, 4, 5, 7])),
        draw(st.integers(0, 8)) if can_id & REMOTE else 0,
    )


frames = _frames()


# Signals that cannot have every value; physical or of the value table.
PLAUSIBLE_VALUES = {
    "Angle": st.floats(-24.9, 24.9),
    "Speed": st.floats(0, 3),
    "RearLeftSpeed": st.floats(-3, 3),
    "RearRightSpeed": st.floats(-3, 3),
    "GearPosition": st.integers(1, 4),
    "Mode": st.integers(0, 2),
}


@st.composite
def plausible_payloads(draw: st.DrawFn, layout: MessageLayout) -> bytes:
    """Any data of a frame with values that this chassis can have."""
    word = int.from_bytes(draw(payloads), "little")
    for signal in layout.signals:
        if signal.name in PLAUSIBLE_VALUES:
            mask = (1 << signal.length) - 1
            raw = to_raw(signal, draw(PLAUSIBLE_VALUES[signal.name]))
            word = word & ~(mask << signal.start_bit) | raw << signal.start_bit
            if signal.name == "Mode":
                word |= 1  # Valid: mode auto needs it
    return word.to_bytes(8, "little")


def with_checksum(data: bytes) -> bytes:
    checksum = 0
    for byte in data[:7]:
        checksum ^= byte
    return data[:7] + bytes([checksum])


def identify(layout: MessageLayout) -> str:
    wheel = "fine" if layout in load(Variant.FINE).messages.values() else "coarse"
    return f"{wheel}-{layout.name}"


INT64 = st.integers(-(2**63), 2**63 - 1)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
# Any MessagePack value.
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


def message_of(kind: type[Message]) -> st.SearchStrategy[Message]:
    return _values(inspect.type_info(kind))


@st.composite
def subjects_and_messages(draw: st.DrawFn) -> tuple[Subject, Message]:
    subject = draw(st.sampled_from(SUBJECTS))
    return subject, draw(message_of(subject.type))


def any_of(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    return _values(inspect.type_info(kind))


@st.composite
def commands_and_requests(draw: st.DrawFn) -> tuple[Command, Request]:
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
