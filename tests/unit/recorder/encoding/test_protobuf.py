"""Typed messages as protobuf: descriptors and bytes."""

from enum import Enum
from typing import Any, cast

import msgspec
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from google.protobuf.message import Message as ProtobufMessage
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding import protobuf
from recorder.encoding.protobuf import (
    LOGGED,
    compile_encoder,
    compile_row_encoder,
    descriptor_set,
    message_class,
    schema_name,
)
from schemas.messages import CanFrame, Message, RawSample, RobotState
from tests.support.strategies import message_of

KINDS = pytest.mark.parametrize("kind", LOGGED, ids=schema_name)


@KINDS
def test_a_descriptor_set_names_each_file_once_and_after_those_it_needs(kind: type[msgspec.Struct]) -> None:
    seen: list[str] = []
    for file in FileDescriptorSet.FromString(descriptor_set(kind)).file:
        assert set(file.dependency) <= set(seen)
        assert file.name not in seen
        seen.append(file.name)


@KINDS
def test_numbers_have_a_fixed_width(kind: type[msgspec.Struct]) -> None:
    varints = {
        getattr(FieldDescriptorProto, f"TYPE_{name}") for name in ("INT32", "INT64", "UINT32", "UINT64", "SINT32")
    }
    for file in FileDescriptorSet.FromString(descriptor_set(kind)).file:
        for message in file.message_type:
            for part in (message, *message.nested_type):
                assert not {field.type for field in part.field} & varints


def test_what_may_be_null_has_presence() -> None:
    fields = message_class(RobotState).DESCRIPTOR.fields_by_name
    assert fields["speed_mps"].has_presence
    assert not fields["bus_up"].has_presence
    (proto,) = [
        message
        for file in FileDescriptorSet.FromString(descriptor_set(RobotState)).file
        for message in file.message_type
    ]
    optional = {field.name for field in proto.field if field.proto3_optional}
    assert optional == {field.name for field in proto.field if field.HasField("oneof_index")}
    assert "speed_mps" in optional


def test_a_type_without_a_counterpart_is_our_own_mistake() -> None:
    with pytest.raises(TypeError, match="no counterpart"):
        protobuf._Files().add_struct(msgspec.defstruct("Odd", [("either", int | str)]))
    with pytest.raises(TypeError, match="no counterpart"):
        protobuf._Files().add_struct(msgspec.defstruct("Odd", [("pair", tuple[int, int])]))


CLASSES = {kind: message_class(kind) for kind in LOGGED}
ENCODERS = {kind: compile_encoder(kind) for kind in LOGGED}
MESSAGES = st.one_of([message_of(cast("type[Message]", kind)) for kind in LOGGED])


def fill(target: Any, message: msgspec.Struct) -> Any:  # noqa: ANN401 - protobuf's classes are made at run time
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
    """For any message of any subject."""
    kind = CLASSES[type(message)]
    parsed: ProtobufMessage = kind.FromString(ENCODERS[type(message)](message))
    expected = fill(kind(), message)
    assert parsed == expected
    assert parsed.SerializeToString(deterministic=True) == expected.SerializeToString(deterministic=True)


@given(message_of(cast("type[Message]", CanFrame)))
def test_a_row_encodes_as_its_message(frame: Message) -> None:
    values = [getattr(frame, name) for name in frame.__struct_fields__]
    assert compile_row_encoder(CanFrame)(*values) == ENCODERS[CanFrame](frame)


@pytest.mark.parametrize("length", [0, 127, 128, 16_383, 16_384, 100_000])
def test_any_length_is_told(length: int) -> None:
    raw = RawSample(time_ns=1, key="k" * length, encoding="", payload=bytes(length), attachment=b"", reason="")
    parsed: Any = CLASSES[RawSample].FromString(ENCODERS[RawSample](raw))
    assert (parsed.key, parsed.payload) == (raw.key, raw.payload)


def test_an_enumeration_too_large_for_one_byte_is_refused() -> None:
    large = Enum("large", [f"VALUE_{number}" for number in range(129)])  # type: ignore[misc]  # made at run time
    with pytest.raises(TypeError, match="too many"):
        compile_encoder(msgspec.defstruct("Large", [("value", large)]))
