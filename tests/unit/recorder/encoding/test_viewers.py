"""What viewers draw: events as lines, poses as transforms, and the robot's outline."""

from io import BytesIO
from math import pi
from typing import Any

import foxglove.messages
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recorder.encoding.viewers import SHOWN, Shown
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.messages import Odometry
from schemas.reasons import Reason
from tests.support.logs import Log
from tests.support.messages import MS, SECOND, WALL_NS, FakeSample, key_of, sample_of
from tests.support.rigs.recorder import RecorderRig, messages

KEY = key_of(Odometry)


def odometry(number: int, heading_rad: float = 0.0, step_ns: int = 20 * MS) -> Odometry:
    return Odometry(WALL_NS + number * step_ns, number, number / 10, -1.0, heading_rad, *[0.0] * 8)


def drawn(data: bytes, topic: str) -> list[tuple[Any, Any]]:
    """Records and contents of a topic."""
    reader = make_reader(BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    return [(record, content) for _, _, record, content in reader.iter_decoded_messages(topics=[topic])]


def types(data: bytes) -> dict[str, Any]:
    return {
        one.name: (
            [(field.name, field.number, field.type, field.label, field.type_name) for field in one.field],
            [(enum.name, [(value.name, value.number) for value in enum.value]) for enum in one.enum_type],
        )
        for file in FileDescriptorSet.FromString(data).file
        for one in file.message_type
    }


@pytest.mark.parametrize("shown", SHOWN, ids=lambda shown: shown.schema_name)
def test_a_schema_is_foxgloves(shown: Shown) -> None:
    published = getattr(foxglove.messages, shown.schema_name.removeprefix("foxglove.")).get_schema()
    assert (published.name, types(published.data)) == (shown.schema_name, types(shown.schema_data))


@pytest.mark.parametrize(
    ("severity", "level", "text", "message_text"),
    [
        (Severity.INFO, 2, "a remote stop", "latch: a remote stop (operator-1)"),
        (Severity.WARNING, 3, "a remote stop", "latch: a remote stop (operator-1)"),
        (Severity.ERROR, 4, "latch: a remote stop", "latch: a remote stop (operator-1)"),
    ],
)
def test_an_event_is_a_line_of_a_log_too(severity: Severity, level: int, text: str, message_text: str) -> None:
    """Its kind stands before the text, once."""
    event = SafetyEvent(
        time_ns=WALL_NS + 123,
        sequence=7,
        tick=1,
        severity=severity,
        kind=EventKind.LATCH,
        reason=Reason.REMOTE_STOP,
        operator="operator-1",
        text=text,
    )
    log = Log()
    log.receive(sample_of(event))
    ((message, line),) = drawn(log.close(), "fleet/cruiser-1/safety/event/log")
    assert line.timestamp.ToNanoseconds() == message.publish_time == event.time_ns
    assert (line.level, line.name, line.message) == (level, "cruiser-1", message_text)


def driven(*heading_rad: float, step_ns: int = 20 * MS) -> bytes:
    """A log of a robot with a tick after each odometry."""
    log = Log()
    for number, heading in enumerate(heading_rad):
        at_ns = number * step_ns
        log.receive(sample_of(odometry(number, heading, step_ns)), now_ns=at_ns, wall_ns=WALL_NS + at_ns)
        log.log.find_fast_path(KEY)
        log.tick(at_ns)
    return log.close()


def test_a_pose_is_a_transform_at_most_twenty_times_a_second() -> None:
    found = drawn(driven(0.0, 0.0, 0.0, pi / 2, 0.0, 0.0, pi), f"{KEY}/tf")
    assert [record.publish_time - WALL_NS for record, _ in found] == [0, 60 * MS, 120 * MS]
    record, turned = found[1]
    assert (record.sequence, record.log_time) == (3, WALL_NS + 60 * MS)
    assert turned.timestamp.ToNanoseconds() == record.publish_time
    assert (turned.parent_frame_id, turned.child_frame_id) == ("fleet/cruiser-1/odom", "fleet/cruiser-1/base_link")
    assert (turned.translation.x, turned.translation.y, turned.translation.z) == (0.3, -1.0, 0.0)
    assert (turned.rotation.z, turned.rotation.w) == pytest.approx((0.5**0.5, 0.5**0.5))


def test_an_outline_is_repeated_in_each_file_and_every_ten_seconds() -> None:
    assert len(drawn(driven(*[0.0] * 21, step_ns=SECOND), f"{KEY}/outline")) == 3
    ((record, scene),) = drawn(driven(0.0, 0.0), f"{KEY}/outline")
    (entity,) = scene.entities
    assert (entity.frame_id, entity.id, entity.frame_locked) == (
        "fleet/cruiser-1/base_link",
        "fleet/cruiser-1",
        True,
    )
    assert entity.timestamp.ToNanoseconds() == record.publish_time == WALL_NS
    assert (entity.lifetime.seconds, entity.lifetime.nanos) == (0, 0)
    assert sorted((one.pose.position.x, one.pose.position.y) for one in entity.cylinders) == [
        (0.0, -0.303),
        (0.0, 0.303),
        (0.66, -0.303),
        (0.66, 0.303),
    ]
    assert {(one.pose.position.z, one.size.x) for one in entity.cylinders} == {(0.21, 0.42)}
    assert len(entity.cubes) == len(entity.arrows) == 1


def test_each_file_of_a_log_has_the_outline() -> None:
    rig = RecorderRig()
    for number in range(2):
        rig.receive(sample_of(odometry(number, step_ns=SECOND)))
        rig.notice()
        rig.tick()
        rig.writer.apply(rig.recorder.roll("signal", rig.now_ns))
        rig.now_ns += 2 * SECOND
    rig.close()
    outlines = [[topic for topic, _ in messages(file)].count(f"{KEY}/outline") for file in rig.logs()["cruiser-1"]]
    assert outlines == [1, 1]


def test_a_key_that_is_the_topic_of_a_transform_is_another() -> None:
    log = Log()
    log.receive(
        FakeSample(f"{KEY}/tf", "x", b"\xff"), sample_of(odometry(0)), FakeSample(f"{KEY}/@tf", "x", b"\xff")
    )
    log.tick(0)
    data = log.close()
    assert [len(drawn(data, f"{KEY}/{chunk}")) for chunk in ("tf", "@tf", "@tf/@raw")] == [1, 1, 1]
    assert drawn(data, f"{KEY}/@tf")[0][1].child_frame_id == "fleet/cruiser-1/base_link"
