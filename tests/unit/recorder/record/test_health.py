"""A recorder's health."""

from recorder.encoding.samples import SEQUENCE_SPAN
from recorder.record.actions import Action, DiskRoom
from recorder.record.recorder import HealthReport, Recorder, Vitals
from schemas.messages import Gear
from schemas.recording import GapReason, RecorderState
from tests.support.fakes.recording import RECORDER_PLAN
from tests.support.messages import SECOND, WALL_NS, gear, key_of, sample_of

START_NS = 5 * SECOND


def report() -> HealthReport:
    return HealthReport("bench", "1.2", START_NS)


def receive(recorder: Recorder, *sequences: int) -> list[Action]:
    return [*recorder.receive([sample_of(gear(sequence), "a") for sequence in sequences], START_NS)]


def test_it_is_due_each_second_with_the_rates_of_that() -> None:
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
    recorder, health = Recorder(RECORDER_PLAN), report()

    vitals = Vitals(*range(1, 9))

    def told(after_s: int) -> tuple[RecorderState, float]:
        one = health.now(recorder, vitals, START_NS + after_s * SECOND, WALL_NS)
        assert [getattr(one, name) for name in Vitals.__struct_fields__] == [*range(1, 9)]
        return one.state, one.state_since_s

    assert told(2) == (RecorderState.RECORDING, 2.0)
    recorder.receive_notice(DiskRoom(has_room=False, has_incident_room=True), START_NS, WALL_NS)
    assert told(3) == (RecorderState.FULL, 0.0)
    assert told(5) == (RecorderState.FULL, 2.0)
    recorder.receive_notice(DiskRoom(has_room=True, has_incident_room=True), START_NS, WALL_NS)
    assert told(6) == (RecorderState.RECORDING, 0.0)
