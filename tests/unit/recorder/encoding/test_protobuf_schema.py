"""The messages as protobuf descriptors."""

import msgspec
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

from recorder.encoding import protobuf
from recorder.encoding.protobuf import LOGGED, descriptor_set, message_class, schema_name
from schemas.messages import RobotState

KINDS = pytest.mark.parametrize("kind", LOGGED, ids=schema_name)


@KINDS
def test_every_logged_class_has_a_schema_of_its_own(kind: type[msgspec.Struct]) -> None:
    """The descriptor set alone is enough to build the message, with every field in its order."""
    descriptor = message_class(kind).DESCRIPTOR
    assert descriptor.full_name == schema_name(kind)
    assert [field.name for field in descriptor.fields] == [field.name for field in msgspec.structs.fields(kind)]
    assert [field.number for field in descriptor.fields] == list(range(1, len(descriptor.fields) + 1))


@KINDS
def test_a_descriptor_set_names_each_file_once_and_after_those_it_needs(kind: type[msgspec.Struct]) -> None:
    """Readers may add the files in the order in which they come."""
    seen: list[str] = []
    for file in FileDescriptorSet.FromString(descriptor_set(kind)).file:
        assert set(file.dependency) <= set(seen)
        assert file.name not in seen
        seen.append(file.name)


@KINDS
def test_numbers_have_a_fixed_width(kind: type[msgspec.Struct]) -> None:
    """No number is a varint, in no message and no map."""
    varints = {
        getattr(FieldDescriptorProto, f"TYPE_{name}") for name in ("INT32", "INT64", "UINT32", "UINT64", "SINT32")
    }
    for file in FileDescriptorSet.FromString(descriptor_set(kind)).file:
        for message in file.message_type:
            for part in (message, *message.nested_type):
                assert not {field.type for field in part.field} & varints


def test_what_may_be_null_has_presence() -> None:
    """A speed that is not known differs from a speed of 0."""
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
    """A new message that protobuf cannot hold is found when the module is loaded, not in the field."""
    with pytest.raises(TypeError, match="no counterpart"):
        protobuf._Files().add_struct(msgspec.defstruct("Odd", [("either", int | str)]))
    with pytest.raises(TypeError, match="no counterpart"):
        protobuf._Files().add_struct(msgspec.defstruct("Odd", [("pair", tuple[int, int])]))
