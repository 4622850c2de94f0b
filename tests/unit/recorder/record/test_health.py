"""A recorder's health."""

import msgspec

from recorder.encoding.samples import SEQUENCE_SPAN
from recorder.record.actions import Action, DiskRoom, Lost
from recorder.record.recorder import HealthReport, Recorder, Vitals
from schemas import codec
from schemas.messages import Gear
from schemas.recording import GapReason, RecorderHealth, RecorderState
from schemas.subjects import BY_TYPE
from tests.support.fakes.recording import RECORDER_PLAN, MemoryWriter
from tests.support.messages import SECOND, WALL_NS, FakeSample, batch, feedback, gear, key_of, sample_of

START_NS = 5 * SECOND
VITALS = Vitals(
    files=1,
    files_ended=2,
    ended_bytes=3,
    queue_bytes=4,
    disk_queue_bytes=5,
    disk_free_bytes=6,
    disk_used_bytes=7,
    incident_bytes=8,
)


def report() -> HealthReport:
    return HealthReport("bench", "1.2", START_NS)


def receive(recorder: Recorder, *sequences: int, robot: str = "a") -> list[Action]:
    return [
        action
        for sequence in sequences
        for action in recorder.receive([sample_of(gear(sequence), robot)], START_NS)
    ]


def test_it_counts_everything_that_became_of_the_samples() -> None:
    """Samples and messages, of all robots together; what was dropped unread was received, and is not missed."""
    recorder = Recorder(msgspec.structs.replace(RECORDER_PLAN, sample_max_bytes=500))
    writer = MemoryWriter()
    writer.apply(receive(recorder, 0, 1, 5))
    frames = batch(0, [(WALL_NS, feedback(number)) for number in range(7)])
    recorder.receive([sample_of(frames, "b")], START_NS)
    for _ in range(10):
        recorder.drop(key_of(Gear, "b"), GapReason.QUEUE, START_NS, WALL_NS)
    recorder.receive([FakeSample("x", "x", bytes(501))], START_NS)
    recorder.receive_notice(Lost("a", {1: 2}, WALL_NS, WALL_NS), START_NS, WALL_NS)
    writer.apply(recorder.mark("a", "", START_NS, WALL_NS)[1])
    found = report().now(recorder, VITALS, START_NS + 3 * SECOND, WALL_NS)
    assert found == RecorderHealth(
        time_ns=WALL_NS,
        sequence=0,
        recorder="bench",
        recorder_version="1.2",
        uptime_s=3.0,
        state=RecorderState.RECORDING,
        state_since_s=3.0,
        files=1,
        files_ended=2,
        ended_bytes=3,
        robots=2,
        keys=4,
        received=3 + 1 + 10 + 1,
        received_per_s=0.0,
        written=3 + 7 - 2,
        missed=3,
        dropped={"disk": 2, "queue": 10, "size": 1},
        queue_bytes=4,
        disk_queue_bytes=5,
        ring_bytes=0,
        incidents=1,
        disk_free_bytes=6,
        disk_used_bytes=7,
        incident_bytes=8,
        cpu_percent=0.0,
    )
    assert codec.decode(BY_TYPE[RecorderHealth], codec.encode(found)) == found


def test_it_is_due_each_second_with_the_rates_of_that() -> None:
    """Also of what was not recorded. Who asks between gets the same, and takes no number: a gap is a loss."""
    recorder, health = Recorder(RECORDER_PLAN), report()
    receive(recorder, *range(30))
    for _ in range(10):
        recorder.drop(key_of(Gear, "a"), GapReason.QUEUE, START_NS, WALL_NS)
    cpu_ns = SECOND // 4
    assert [health.is_due(START_NS + after_ns) for after_ns in (SECOND - 1, SECOND)] == [False, True]
    first = health.next(recorder, Vitals(), cpu_ns, START_NS + 2 * SECOND, WALL_NS)
    assert (first.received_per_s, first.cpu_percent, first.sequence) == (20.0, 12.5, 1)
    assert [health.is_due(START_NS + after_ns) for after_ns in (3 * SECOND - 1, 3 * SECOND)] == [False, True]
    receive(recorder, 40, 41)
    between = health.now(recorder, Vitals(), START_NS + 3 * SECOND - 1, WALL_NS)
    assert (between.received, between.received_per_s, between.cpu_percent, between.sequence) == (42, 20.0, 12.5, 1)
    health._sequence = SEQUENCE_SPAN - 1
    second = health.next(recorder, Vitals(), cpu_ns, START_NS + 3 * SECOND, WALL_NS)
    assert (second.received_per_s, second.cpu_percent, second.sequence) == (2.0, 0.0, 0)


def test_it_says_since_when_it_does_what_it_does() -> None:
    """At first since the start."""
    recorder, health = Recorder(RECORDER_PLAN), report()

    def told(after_s: int) -> tuple[RecorderState, float]:
        one = health.now(recorder, VITALS, START_NS + after_s * SECOND, WALL_NS)
        return one.state, one.state_since_s

    assert told(2) == (RecorderState.RECORDING, 2.0)
    recorder.receive_notice(DiskRoom(has_room=False, has_incident_room=True), START_NS, WALL_NS)
    assert told(3) == (RecorderState.FULL, 0.0)
    assert told(5) == (RecorderState.FULL, 2.0)
    recorder.receive_notice(DiskRoom(has_room=True, has_incident_room=True), START_NS, WALL_NS)
    assert told(6) == (RecorderState.RECORDING, 0.0)
