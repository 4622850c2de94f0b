"""``review export --format ros2``: a bag, as two foreign readers read it."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from msgspec.structs import replace
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Selection
from recorder.review.messages import read_log
from recorder.review.rosbag import Bag, export_bag
from schemas.command_line import CommandError
from schemas.messages import Odometry
from schemas.ros.cdr import type_hash
from tests.support.drives import write_messages
from tests.support.golden_logs import unpack
from tests.support.logs import saved, small_log
from tests.support.messages import PERIOD_NS, WALL_NS, arbiter, state


def odometry(number: int) -> Odometry:
    time_ns = WALL_NS + number * PERIOD_NS
    return Odometry(time_ns, number, number / 8, -number / 4, 0.5, 1.0, 0.1, 3.0, 0.01, 0.02, 0.03, 0.04, 0.05)


def exported(logs: list[Path], out: Path) -> Bag | None:
    faults = Faults()
    return export_bag(find_logs(logs, faults), out, Selection(), faults)


def made(name: str, tmp_path: Path) -> tuple[list[Path], Path]:
    """A golden log, and its bag."""
    (place := tmp_path / "logs").mkdir()
    logs = [place / one for one in unpack(name, place)]
    out = tmp_path / "bag"
    assert exported(logs, out) is not None
    return logs, out


def said(log: Path, topic: str, kind: type[Any]) -> list[Any]:
    return [one for one in read_log(log, topics=[topic]) if isinstance(one.message, kind)]


def test_two_foreign_readers_find_every_message(tmp_path: Path) -> None:
    """Message by message against the log: of two robots, with the times of receipt and of the source."""
    messages = [one for number in range(9) for one in (state(number), odometry(number), arbiter(number))]
    log, out = write_messages(tmp_path / "a.mcap", messages, ("cruiser-1", "cruiser-2")), tmp_path / "bag"
    bag = exported([log], out)
    assert bag is not None
    with AnyReader([out], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        read: list[tuple[str, int, Any]] = [
            (one.topic, log_ns, reader.deserialize(raw, one.msgtype)) for one, log_ns, raw in reader.messages()
        ]
    assert bag.topics == Counter(topic for topic, _, _ in read)
    for robot in ("cruiser-1", "cruiser-2"):
        logged = said(log, f"*/{robot}/chassis/odometry", Odometry)
        theirs = [one[1:] for one in read if one[0] == f"/{robot.replace('-', '_')}/odom"]
        assert len(logged) == len(theirs) == 9
        for one, (log_ns, message) in zip(logged, theirs, strict=True):
            assert log_ns == one.log_time_ns
            stamp = message.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == one.message.time_ns == one.publish_time_ns
            position, speed = message.pose.pose.position, message.twist.twist.linear.x
            assert (position.x, position.y, speed) == (one.message.x_m, one.message.y_m, one.message.speed_mps)
    counted: Counter[str] = Counter()
    with next(out.glob("*.mcap")).open("rb") as stream:
        for _, channel, _, _ in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            counted[channel.topic] += 1
    assert counted == bag.topics


def test_a_log_without_odometry_gets_it_from_its_states(tmp_path: Path) -> None:
    """As the report has it: 1 m/s, straight on."""
    log = write_messages(tmp_path / "a.mcap", [state(number) for number in range(11)])
    out = tmp_path / "bag"
    assert exported([log], out) is not None
    with AnyReader([out], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        poses: list[Any] = [
            reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages() if one.topic.endswith("odom")
        ]
    assert poses[-1].pose.pose.position.x == pytest.approx(10 * PERIOD_NS / 1e9)


def test_a_bag_says_what_rosbag2_wants_to_know(tmp_path: Path) -> None:
    """Profile, encodings, QoS and hashes; chunks have message indexes."""
    _, out = made("guard-stop", tmp_path)
    about = json.loads((out / "metadata.yaml").read_bytes())["rosbag2_bagfile_information"]
    assert (about["version"], about["storage_identifier"]) == (9, "mcap")
    (name,) = about["relative_file_paths"]
    with (out / name).open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
    assert all(one.message_index_offsets for one in summary.chunk_indexes)
    assert summary.statistics is not None
    assert summary.statistics.message_count == about["message_count"]
    topics = {one["topic_metadata"]["name"]: one for one in about["topics_with_message_count"]}
    for channel in summary.channels.values():
        schema, row = summary.schemas[channel.schema_id], topics.pop(channel.topic)
        assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
        assert row["topic_metadata"]["type"] == schema.name
        assert row["topic_metadata"]["type_description_hash"] == type_hash(schema.name)
        assert channel.metadata["topic_type_hash"] == type_hash(schema.name)
        (qos,) = json.loads(channel.metadata["offered_qos_profiles"])
        assert [qos] == row["topic_metadata"]["offered_qos_profiles"]
        assert (qos["durability"] == "transient_local") == channel.topic.endswith("/remote_stop")
        assert row["message_count"] == summary.statistics.channel_message_counts[channel.id]
    assert not topics


def test_nothing_is_overwritten_and_nothing_is_left_of_an_empty_bag(tmp_path: Path) -> None:
    logs, out = made("guard-stop", tmp_path)
    before = sorted((path.name, path.stat().st_mtime_ns) for path in out.iterdir())
    with pytest.raises(CommandError, match="exists, and is not overwritten"):
        exported(logs, out)
    assert sorted((path.name, path.stat().st_mtime_ns) for path in out.iterdir()) == before
    assert exported([saved(tmp_path / "gears.mcap", small_log())], tmp_path / "empty") is None
    assert not list((tmp_path / "empty").iterdir())


def test_values_that_no_ros_message_holds_are_said(tmp_path: Path) -> None:
    """The rest of the log is in the bag."""
    huge = [
        replace(state(0), speed_mps=1e308, angle_deg=1e308),
        replace(state(1), speed_mps=-1e308, angle_deg=1e308),
    ]
    commanded = replace(arbiter(2), output_speed_mps=1e308)
    log = write_messages(tmp_path / "a.mcap", [*huge, commanded, state(3)])
    faults = Faults()
    bag = export_bag(find_logs([log], faults), tmp_path / "bag", Selection(), faults)
    assert bag is not None
    assert bag.topics["/cruiser_1/joint_states"] >= 1
    assert "cruiser-1: a value that no ROS message holds" in faults.told[0]


def test_two_robots_of_one_namespace_are_no_bag(tmp_path: Path) -> None:
    log = write_messages(tmp_path / "a.mcap", [odometry(0)], ("cruiser-1", "cruiser--1"))
    with pytest.raises(CommandError, match="cruiser--1 and cruiser-1 are both /cruiser_1"):
        exported([log], tmp_path / "bag")
