"""The incidents of a recorder: when one begins, what it holds, and how it and its log name each other."""

from io import BytesIO

import msgspec
from mcap.reader import make_reader

from recorder.record.incidents import INCIDENT_NAME
from recorder.record.recorder import Recorder
from schemas.decisions import EventKind, Severity
from schemas.messages import CanFrames, GatewayInfo
from schemas.recording import RecorderEventKind
from tests.support.messages import (
    MS,
    SECOND,
    WALL_NS,
    batch,
    feedback,
    gear,
    info,
    key_of,
    safety_event,
    sample_of,
)
from tests.support.rigs.recorder import EVENT_KEY, GEAR_KEY, PLAN, RecorderRig, metadata, times


def test_an_incident_of_no_time_holds_its_cause(bench: RecorderRig) -> None:
    """Nothing before and nothing after, but the event."""
    plan = msgspec.structs.replace(PLAN, log=msgspec.structs.replace(PLAN.log, before_ns=0, after_ns=0))
    bench.recorder = Recorder(plan)
    bench.receive(sample_of(safety_event(EventKind.STOP)))
    bench.run(10 * MS)
    assert times(bench.writer.files["cruiser-1!"][0], EVENT_KEY) == [0]


def test_the_next_incident_is_of_its_own(bench: RecorderRig) -> None:
    """It says when and why it was, and nothing of the one before; each channel is declared once."""
    bench.receive(sample_of(gear(0)))
    bench.notice()
    bench.mark(because="first")
    bench.notice()
    bench.run(3 * SECOND)
    marked = bench.mark(because="second")
    assert marked == {"cruiser-1!": ""}
    bench.notice()
    assert bench.mark() == {"cruiser-1!": "cruiser-1-1.incident.mcap"}
    bench.close()
    first, second = bench.writer.files["cruiser-1!"]
    assert [one["because"] for one in metadata(first, INCIDENT_NAME)] == ["first"]
    assert [one["because"] for one in metadata(second, INCIDENT_NAME)] == ["second"]
    (log,) = bench.logs()["cruiser-1"]
    named = metadata(log, INCIDENT_NAME)
    assert [(one["because"], one["file"], one["at_ns"]) for one in named] == [
        ("first", first.name, str(WALL_NS)),
        ("second", second.name, str(WALL_NS + 3 * SECOND)),
    ]
    words = [event for event in bench.events() if event.kind is RecorderEventKind.INCIDENT]
    assert [(event.robot, event.file) for event in words] == [
        ("cruiser-1", first.name),
        ("cruiser-1", second.name),
    ]


def test_a_new_incident_has_no_file_while_the_one_before_is_being_ended(bench: RecorderRig) -> None:
    """However late the disk is: nobody is told the name of the wrong file."""
    bench.receive(sample_of(gear(0)))
    bench.mark()
    bench.notice()
    bench.now_ns += 3 * SECOND
    bench.tick()
    assert bench.mark() == {"cruiser-1!": ""}


def test_an_incident_does_not_name_a_log_that_was_ended(bench: RecorderRig) -> None:
    """Even if the disk has not done it yet."""
    bench.receive(sample_of(gear(0)))
    bench.notice()
    bench.room(has_room=False)
    bench.mark()
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    assert [one["file"] for one in metadata(incident, INCIDENT_NAME)] == [""]


def test_incident_and_log_find_each_other_however_late_the_disk_is(bench: RecorderRig) -> None:
    """A log that had not been opened, or that goes on in another file, is named as soon as it has a name."""
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
    """Neither by an alarm nor by a mark; one that is being written ends with what was in hand, and it is told."""
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
    refused = [one for one in bench.events() if one.text.endswith("none is kept of cruiser-1: stop: as it were")]
    assert [(one.kind, one.severity) for one in refused] == [(RecorderEventKind.INCIDENT, Severity.ERROR)] * 2
    assert (cut.kind, cut.severity, cut.file) == (RecorderEventKind.INCIDENT, Severity.ERROR, incident.name)


def test_the_rings_share_their_memory(bench: RecorderRig) -> None:
    """However much comes, from however many robots."""
    bench.recorder = Recorder(msgspec.structs.replace(PLAN, ring_bytes=10_000))
    for number in range(300):
        bench.receive(sample_of(gear(number), f"r-{number % 3}"))
        bench.run(10 * MS)
        assert bench.recorder.ring_bytes <= 10_000
    assert bench.recorder.ring_bytes > 5000


def test_an_incident_declares_what_its_log_did(bench: RecorderRig) -> None:
    """With its attachments, and what is known of the robot; also what is declared while it lasts."""
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
