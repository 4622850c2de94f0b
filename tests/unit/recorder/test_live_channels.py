"""Live channels for viewers: the same channels and records as in a log."""

import msgspec
import pytest

from recorder.encoding.protobuf import descriptor_set
from recorder.encoding.samples import ReceivedSample
from recorder.encoding.viewers import LINES, outline_record
from recorder.layouts.attached import RobotKeys
from recorder.mcap.writer import LogChannel
from recorder.record.actions import Query
from recorder.view import SAMPLE_MAX_BYTES, SILENT_NS, LiveChannels, ViewServer
from schemas.decisions import EventKind, SafetyEvent
from schemas.messages import GatewayInfo, Gear, Odometry, RawSample
from tests.support.logs import encoded
from tests.support.messages import (
    WALL_NS,
    FakeSample,
    batch,
    feedback,
    gear,
    info,
    key_of,
    safety_event,
    sample_of,
)
from tests.support.rigs.recorder import RecorderRig, messages

GEAR_KEY, EVENT_KEY = key_of(Gear), key_of(SafetyEvent)


class FakeViewers(ViewServer):
    """Viewers that have subscribed to some topics, or to all."""

    def __init__(self, *wanted: str) -> None:
        self.wanted = wanted
        self.channels: dict[int, LogChannel] = {}
        self.records: list[tuple[str, int, bytes]] = []

    def declare(self, channel: LogChannel) -> None:
        self.channels[channel.channel_id] = channel

    def is_wanted(self, channel_id: int) -> bool:
        return not self.wanted or self.channels[channel_id].topic in self.wanted

    def write(self, channel_id: int, log_ns: int, data: bytes) -> None:
        topic = self.channels[channel_id].topic
        if not self.wanted or topic in self.wanted:
            self.records.append((topic, log_ns, data))

    @property
    def by_topic(self) -> dict[str, LogChannel]:
        return {channel.topic: channel for channel in self.channels.values()}


def shown(*samples: ReceivedSample, wanted: tuple[str, ...] = ()) -> tuple[LiveChannels, FakeViewers]:
    viewers = FakeViewers(*wanted)
    channels = LiveChannels(viewers, "1.0")
    for sample in samples:
        channels.receive(sample, 0)
    return channels, viewers


def test_each_topic_of_a_log_is_shown_with_as_many_records() -> None:
    """The recorder is the oracle."""
    samples = [
        sample_of(gear(0)),
        sample_of(batch(0, [(WALL_NS, feedback(0)), (WALL_NS + 1, feedback(1))])),
        sample_of(safety_event(EventKind.STOP)),
        sample_of(info()),
        FakeSample(GEAR_KEY, "text/plain", b"broken"),
        FakeSample("fleet/cruiser-1/camera", "image/jpeg", b"jpeg"),
    ]
    _, viewers = shown(*samples)
    rig = RecorderRig()
    rig.receive(*samples)
    rig.close()
    (log,) = rig.logs()["cruiser-1"]
    logged = sorted(topic for topic, _ in messages(log) if "@recorder" not in topic)
    assert sorted(topic for topic, _, _ in viewers.records) == logged
    assert {f"{GEAR_KEY}/@raw", f"{EVENT_KEY}/log", "fleet/cruiser-1/camera"} < set(logged)


def test_what_nobody_looks_at_is_declared_and_not_sent() -> None:
    channels, viewers = shown(sample_of(gear(0)), wanted=("nothing",))
    assert GEAR_KEY in viewers.by_topic
    viewers.wanted = (GEAR_KEY,)
    channels.receive(sample_of(gear(1)), 0)
    assert viewers.records == [(GEAR_KEY, WALL_NS, encoded(gear(1)))]


def test_events_have_their_channels_before_the_first_one() -> None:
    _, viewers = shown(sample_of(gear(0)))
    assert viewers.by_topic[f"{EVENT_KEY}/log"].schema_data == LINES.schema_data
    assert EVENT_KEY in viewers.by_topic


@pytest.mark.parametrize("topic", [EVENT_KEY, f"{EVENT_KEY}/log", key_of(GatewayInfo)])
def test_whoever_subscribes_later_is_shown_the_newest_of_what_comes_seldom(topic: str) -> None:
    channels, viewers = shown(
        sample_of(safety_event(EventKind.STOP)), sample_of(info()), sample_of(gear(0)), wanted=("nothing",)
    )
    viewers.wanted = (topic, GEAR_KEY)
    for channel_id in viewers.channels:
        channels.show_newest(channel_id)
    assert [(one, at_ns) for one, at_ns, _ in viewers.records] == [(topic, WALL_NS)]


def test_a_pose_is_shown_to_whoever_wants_it_and_the_outline_to_latecomers_too() -> None:
    poses = [Odometry(WALL_NS + number * 20_000_000, number, *[0.0] * 11) for number in range(5)]
    key = key_of(Odometry)
    channels, viewers = shown(*map(sample_of, poses), wanted=(f"{key}/tf",))
    assert [topic for topic, _, _ in viewers.records] == [f"{key}/tf"] * 2
    viewers.wanted = (f"{key}/outline",)
    for channel_id in viewers.channels:
        channels.show_newest(channel_id)
    assert viewers.records[2:] == [(f"{key}/outline", WALL_NS, outline_record(WALL_NS, "fleet/cruiser-1"))]


def test_a_huge_sample_is_left_out_and_counted() -> None:
    huge = FakeSample(GEAR_KEY, "x", bytes(SAMPLE_MAX_BYTES + 1))
    channels, viewers = shown(huge)
    assert (channels.left_out, viewers.records, viewers.channels) == (1, [], {})
    channels.receive(msgspec.structs.replace(huge, payload=bytes(SAMPLE_MAX_BYTES)), 0)
    assert [topic for topic, _, _ in viewers.records] == [f"{GEAR_KEY}/@raw"]
    assert viewers.by_topic[f"{GEAR_KEY}/@raw"].schema_data == descriptor_set(RawSample)


def test_a_robot_that_says_nothing_any_more_is_silent() -> None:
    channels, _ = shown(sample_of(gear(0)), sample_of(gear(0), "cruiser-2"))
    assert channels.robots == {"cruiser-1", "cruiser-2"}
    channels.receive(sample_of(gear(1)), SILENT_NS)
    assert channels.silent(SILENT_NS) == set()
    assert channels.silent(SILENT_NS + 1) == {"cruiser-2"}
    channels.receive(sample_of(gear(1), "cruiser-2"), SILENT_NS + 1)
    assert channels.silent(SILENT_NS + 1) == set()


def test_a_robot_is_asked_who_it_is_and_its_bus_is_told() -> None:
    channels, _ = shown(sample_of(gear(0)), sample_of(gear(1)), sample_of(batch(0, [])))
    assert channels.queries(0) == [Query(key_of(GatewayInfo))]
    assert list(channels.changed_robots()) == [
        RobotKeys("fleet/cruiser-1"),
        RobotKeys("fleet/cruiser-1", "can0"),
    ]
    assert list(channels.changed_robots()) == []


def test_names_that_somebody_makes_up_are_bounded() -> None:
    viewers = FakeViewers("nothing")
    channels = LiveChannels(viewers, "1.0")
    for number in range(40_000):
        channels.receive(FakeSample(f"x/{number}", "x", b""), 0)
    assert len(viewers.channels) <= 35_001
