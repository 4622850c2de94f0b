"""The topics of a log, and how their messages are read."""

from typing import Any

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from mcap import records

from recorder.encoding.protobuf import descriptor_set, message_class, schema_name
from recorder.reading.topics import UNREADABLE, Topic, foreign_decoder, topic_of, typed_decoder
from schemas.decisions import Decision
from schemas.messages import Gear
from tests.support.logs import GEAR_TOPIC


def topic(
    name: str = GEAR_TOPIC, encoding: str = "protobuf", schema: tuple[str, str, bytes] | None = None
) -> Topic:
    found = schema or (schema_name(Gear), "protobuf", descriptor_set(Gear))
    return topic_of(
        records.Channel(id=1, topic=name, message_encoding=encoding, metadata={}, schema_id=1),
        records.Schema(id=1, name=found[0], encoding=found[1], data=found[2]),
    )


def test_a_key_of_ours_tells_robot_and_subject() -> None:
    assert (topic().robot, topic().subject, topic().kind) == ("cruiser-1", "chassis/gear", Gear)
    assert (topic("/elsewhere").robot, topic("/elsewhere").subject) == ("", "")
    assert topic("fleet/r/can/can7/rx").subject == "can/{bus}/rx"
    beside = topic("fleet/r/chassis/gear/@raw")
    assert (beside.robot, beside.owner, beside.subject) == ("", "r", "")


@pytest.mark.parametrize("number", [-1, 1000])
def test_a_number_that_no_member_has_is_no_message(number: int) -> None:
    read: Any = message_class(Decision)
    with pytest.raises(UNREADABLE):
        typed_decoder(Decision)(read(reason=number).SerializeToString())


def test_descriptors_come_in_any_order_and_without_the_well_known_ones() -> None:
    part = FileDescriptorProto(name="part.proto", package="p", syntax="proto3")
    part.message_type.add(name="Part").field.add(name="x", number=1, label=1, type=5)
    whole = FileDescriptorProto(name="whole.proto", package="p", syntax="proto3")
    whole.dependency.extend(["part.proto", "google/protobuf/timestamp.proto"])
    fields_of = whole.message_type.add(name="Whole").field
    fields_of.add(name="part", number=1, label=1, type=11, type_name=".p.Part")
    fields_of.add(name="at", number=2, label=1, type=11, type_name=".google.protobuf.Timestamp")
    for files in ([part, whole], [whole, part]):
        decode = foreign_decoder("p.Whole", FileDescriptorSet(file=files).SerializeToString())
        assert decode is not None
        assert decode(b"\x0a\x02\x08\x05\x12\x02\x08\x07").part.x == 5
        assert decode(b"\x0a\x02\x08\x05\x12\x02\x08\x07").at.seconds == 7
    assert foreign_decoder("p.Whole", FileDescriptorSet(file=[whole]).SerializeToString()) is None
    part.dependency.append("whole.proto")
    assert foreign_decoder("p.Whole", FileDescriptorSet(file=[whole, part]).SerializeToString()) is None
