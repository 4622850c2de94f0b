"""A recorder without I/O: incidents, their rings, and gateways that die."""

from io import BytesIO

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.reader import make_reader

from recorder.encoding.samples import ReceivedSample
from recorder.mcap.writer import Chunk
from recorder.record.incidents import INCIDENT_NAME, Incidents, trim_rings
from schemas import keys
from schemas.decisions import ArbiterState, EventKind, SafetyState, Severity
from schemas.messages import CanFrames, GatewayInfo
from schemas.recording import RecorderEventKind
from schemas.settings import INCIDENT_MAX_NS
from tests.support.logs import sealed
from tests.support.messages import (
    MS,
    ROOT,
    SECOND,
    STANDBY,
    WALL_NS,
    batch,
    feedback,
    gear,
    info,
    key_of,
    safety_event,
    sample_of,
)
from tests.support.rigs.recorder import GEAR_KEY, RecorderRig, messages, metadata, times

BEFORE_NS = 10 * SECOND


def test_a_new_incident_has_no_file_while_the_one_before_is_being_ended(bench: RecorderRig) -> None:
    bench.receive(sample_of(gear(0)))
    bench.mark()
    bench.notice()
    bench.now_ns += 3 * SECOND
    bench.tick()
    assert bench.mark() == {"cruiser-1!": ""}


def test_an_incident_does_not_name_a_log_that_was_ended(bench: RecorderRig) -> None:
    bench.receive(sample_of(gear(0)))
    bench.notice()
    bench.room(has_room=False)
    bench.mark()
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    assert [one["file"] for one in metadata(incident, INCIDENT_NAME)] == [""]


def test_incident_and_log_find_each_other_however_late_the_disk_is(bench: RecorderRig) -> None:
    bench.receive(sample_of(safety_event(EventKind.STOP)))
    bench.now_ns += SECOND
    bench.notice()
    bench.writer.apply(bench.recorder.roll("split", bench.now_ns))
    bench.receive(sample_of(gear(1)))
    bench.notice()
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    logs = bench.logs()["cruiser-1"]
    assert [one["file"] for one in metadata(incident, INCIDENT_NAME)] == ["", *(log.name for log in logs)]
    about = {"at_ns": str(WALL_NS), "because": "stop: as it were", "file": incident.name}
    assert [metadata(log, INCIDENT_NAME) for log in logs] == [[about], [about]]


def test_without_room_for_incidents_there_are_none(bench: RecorderRig) -> None:
    bench.receive(sample_of(gear(0)))
    bench.mark()
    bench.notice()
    bench.receive(sample_of(gear(1)))
    bench.room(has_incident_room=False)
    (incident,) = bench.writer.files["cruiser-1!"]
    assert incident.is_ended
    bench.receive(sample_of(gear(2)), sample_of(safety_event(EventKind.STOP)))
    assert bench.mark() == {}
    bench.run(3 * SECOND)
    bench.receive(sample_of(safety_event(EventKind.STOP, sequence=1)))
    bench.tick()
    assert bench.recorder.incidents == 1
    assert len(times(incident)) == 2
    (cut,) = [one for one in bench.events() if "ended early" in one.text]
    refused = [one for one in bench.events() if one.text.endswith("is used up: stop: as it were")]
    assert [(one.kind, one.severity) for one in refused] == [(RecorderEventKind.INCIDENT, Severity.ERROR)] * 2
    assert (cut.kind, cut.severity, cut.file) == (RecorderEventKind.INCIDENT, Severity.ERROR, incident.name)


def test_an_incident_declares_what_its_log_did(bench: RecorderRig) -> None:
    bench.receive(sample_of(gear(0)), sample_of(info()))
    assert set(bench.mark("cruiser-1")) == {"cruiser-1!"}
    bench.receive(sample_of(batch(0, [(WALL_NS, feedback(0))])))
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    reader = make_reader(BytesIO(incident.disk.getvalue()))
    summary = reader.get_summary()
    assert summary is not None
    topics = [channel.topic for channel in summary.channels.values()]
    assert topics[:3] == [GEAR_KEY, key_of(GatewayInfo), key_of(CanFrames)]
    assert [one.name for one in reader.iter_metadata()] == ["cruiser", "foxglove", INCIDENT_NAME]
    attached = {one.name for one in reader.iter_attachments()}
    assert {"cruiser-1/configuration.toml", "cruiser-1/cruiser-coarse.dbc"} < attached


def chunk(number: int, size: int = 10) -> Chunk:
    return sealed([(1, number, number, number, bytes(size))])


@given(st.lists(st.integers(0, 360 * SECOND), max_size=20))
@example([299 * SECOND] * 7)
def test_whatever_happens_meanwhile_makes_it_longer_up_to_a_bound(waits_ns: list[int]) -> None:
    after_ns = 300 * SECOND
    incidents = Incidents("a", 0, after_ns)
    now_ns = begun_ns = 0
    incidents.begin(now_ns, WALL_NS, "first", "")
    last_ns = now_ns
    for wait_ns in waits_ns:
        now_ns += wait_ns
        is_over = now_ns >= min(last_ns + after_ns, begun_ns + INCIDENT_MAX_NS)
        assert incidents.is_over(now_ns) == is_over
        if is_over:
            incidents.close()
            begun_ns = now_ns
        assert bool(incidents.begin(now_ns, WALL_NS, "again", "")) == is_over
        last_ns = now_ns


@given(
    steps=st.lists(st.tuples(st.integers(1, SECOND), st.integers(0, 3), st.integers(1, 500))),
    wait_ns=st.integers(0, 40 * SECOND),
    limit_bytes=st.integers(0, 3000),
)
def test_all_rings_together_hold_the_newest(
    steps: list[tuple[int, int, int]], wait_ns: int, limit_bytes: int
) -> None:
    rings = [Incidents(str(number), BEFORE_NS, 0) for number in range(4)]
    now_ns = 0
    came: list[tuple[int, int]] = []
    for number, (step_ns, ring, size) in enumerate(steps):
        now_ns += step_ns
        one = chunk(number, size)
        rings[ring].add(one, now_ns)
        came.append((now_ns, len(one.records)))
    now_ns += wait_ns
    trim_rings(rings, now_ns, limit_bytes)
    young = [size for at_ns, size in came if now_ns - at_ns <= BEFORE_NS]
    while sum(young) > limit_bytes:
        young.pop(0)
    assert sum(ring.ring_bytes for ring in rings) == sum(young)


TOKEN = keys.liveliness(ROOT, "cruiser-1")


def arbiter(bench: RecorderRig, sequence: int, engaged: ArbiterState, *, run: int = 1) -> ReceivedSample:
    tick = run * 10**10 + sequence
    said = msgspec.structs.replace(STANDBY, sequence=sequence, tick=tick, state=engaged, output_speed_mps=0.6)
    return sample_of(msgspec.structs.replace(said, time_ns=bench.wall_ns))


def drive(
    bench: RecorderRig, engaged: ArbiterState = ArbiterState.ENGAGED, *, first: int = 0, run: int = 1
) -> None:
    for sequence in range(first, first + 10):
        bench.receive(arbiter(bench, sequence, engaged, run=run))
        bench.run(50 * MS)


@pytest.mark.parametrize("restart_ns", [None, 100 * MS, 2 * SECOND])
def test_a_gateway_that_dies_at_work_is_an_incident(bench: RecorderRig, restart_ns: int | None) -> None:
    drive(bench)
    dead_ns = bench.wall_ns
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    if restart_ns is not None:
        bench.run(restart_ns)
        drive(bench, ArbiterState.STANDBY, run=2)
    bench.run(SECOND)
    assert bench.recorder.incidents == 1
    (gone,) = [one for one in bench.events() if one.kind is RecorderEventKind.GATEWAY]
    assert (gone.robot, gone.severity, gone.time_ns) == ("cruiser-1", Severity.ERROR, dead_ns)
    assert "last state engaged at 0.60 m/s" in gone.text
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    held = [log_ns for topic, log_ns in messages(incident) if topic == key_of(SafetyState)]
    assert min(held) < dead_ns, "what came before is kept"


def test_a_gateway_that_stands_by_is_told_and_makes_no_incident(bench: RecorderRig) -> None:
    drive(bench, ArbiterState.STANDBY)
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    bench.run(SECOND)
    assert bench.recorder.incidents == 0
    (gone,) = [one for one in bench.events() if one.kind is RecorderEventKind.GATEWAY]
    assert gone.severity is Severity.WARNING


def test_a_gateway_that_was_told_to_end_has_not_died(bench: RecorderRig) -> None:
    for sequence, (engaged, incidents) in enumerate([(ArbiterState.STANDBY, 0), (ArbiterState.STOPPING, 1)]):
        drive(bench, engaged, first=10 * sequence)
        ends = msgspec.structs.replace(safety_event(EventKind.GATEWAY, Severity.INFO, sequence), tick=10**10)
        bench.receive(sample_of(ends))
        bench.recorder.lose_token(TOKEN, bench.now_ns)
        bench.run(SECOND)
        assert bench.recorder.incidents == incidents


def test_a_token_that_goes_while_the_states_go_on_tells_nothing(bench: RecorderRig) -> None:
    drive(bench)
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    bench.recorder.lose_token(keys.liveliness(ROOT, "stranger"), bench.now_ns)
    bench.recorder.lose_token("odd", bench.now_ns)
    for first in range(10, 310, 10):
        drive(bench, first=first)
    bench.run(SECOND)
    assert bench.recorder.incidents == 0
    assert bench.events() == []


def test_states_that_wait_for_a_busy_recorder_hide_no_death(bench: RecorderRig) -> None:
    drive(bench)
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    drive(bench, first=10)
    drive(bench, first=20)
    bench.run(SECOND)
    assert bench.recorder.incidents == 1
