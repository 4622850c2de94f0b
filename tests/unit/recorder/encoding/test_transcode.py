"""Typed messages to protobuf bytes."""

from enum import Enum
from typing import Any, cast

import msgspec
import pytest
from google.protobuf.message import Message as ProtobufMessage
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.protobuf import LOGGED, compile_encoder, compile_row_encoder, message_class
from schemas.messages import CanFrame, Message, RawSample
from tests.support.strategies import message_of

CLASSES = {kind: message_class(kind) for kind in LOGGED}
ENCODERS = {kind: compile_encoder(kind) for kind in LOGGED}
MESSAGES = st.one_of([message_of(cast("type[Message]", kind)) for kind in LOGGED])


def fill(target: Any, message: msgspec.Struct) -> Any:  # noqa: ANN401 - protobuf's classes are made at run time
    """The protobuf package's own message with the same content."""
    for name in message.__struct_fields__:
        value = getattr(message, name)
        if isinstance(value, Enum):
            setattr(target, name, list(type(value)).index(value))
        elif isinstance(value, list):
            for item in value:
                if isinstance(item, msgspec.Struct):
                    fill(getattr(target, name).add(), item)
                elif isinstance(item, Enum):
                    getattr(target, name).append(list(type(item)).index(item))
                else:
                    getattr(target, name).append(item)
        elif isinstance(value, dict):
            getattr(target, name).update(value)
        elif value is not None:
            setattr(target, name, value)
    return target


@given(MESSAGES)
def test_bytes_parse_back_as_the_protobuf_packages_own(message: Message) -> None:
    """For any message of any subject, a protobuf reader sees the same as if protobuf had written it."""
    kind = CLASSES[type(message)]
    parsed: ProtobufMessage = kind.FromString(ENCODERS[type(message)](message))
    expected = fill(kind(), message)
    assert parsed == expected
    assert parsed.SerializeToString(deterministic=True) == expected.SerializeToString(deterministic=True)


@given(message_of(cast("type[Message]", CanFrame)))
def test_a_row_encodes_as_its_message(frame: Message) -> None:
    """The encoder of values writes what the encoder of messages writes."""
    values = [getattr(frame, name) for name in frame.__struct_fields__]
    assert compile_row_encoder(CanFrame)(*values) == ENCODERS[CanFrame](frame)


@pytest.mark.parametrize("length", [0, 127, 128, 16_383, 16_384, 100_000])
def test_any_length_is_told(length: int) -> None:
    """Of texts and of bytes: one byte of length, two, or three."""
    raw = RawSample(time_ns=1, key="k" * length, encoding="", payload=bytes(length), attachment=b"", reason="")
    parsed: Any = CLASSES[RawSample].FromString(ENCODERS[RawSample](raw))
    assert (parsed.key, parsed.payload) == (raw.key, raw.payload)


def test_an_enumeration_too_large_for_one_byte_is_refused() -> None:
    """The encoder's own limit is found when it is compiled."""
    large = Enum("large", [f"VALUE_{number}" for number in range(129)])  # type: ignore[misc]  # made at run time
    with pytest.raises(TypeError, match="too many"):
        compile_encoder(msgspec.defstruct("Large", [("value", large)]))
