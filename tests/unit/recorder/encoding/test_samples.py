"""The counters of a key, and event lines."""

from io import BytesIO

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recorder.encoding.samples import SOURCES_MAX, KeyCounters
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.reasons import Reason
from schemas.recording import GapReason
from tests.support.logs import Log
from tests.support.messages import WALL_NS, sample_of


def test_a_step_back_is_a_new_beginning() -> None:
    counters = KeyCounters()
    assert counters.count_sequence(500)
    assert not counters.count_sequence(0)
    assert counters.count_sequence(1)
    assert counters.missed == 0


def test_what_was_dropped_unread_is_not_missed() -> None:
    counters = KeyCounters()
    counters.lose(GapReason.QUEUE, 5)
    counters.count_sequence(10)
    counters.count_sequence(13)
    assert counters.missed == 2
    counters.lose(GapReason.QUEUE, 2)
    counters.lose(GapReason.SIZE, 1)
    counters.lose(GapReason.DISK, 50)
    counters.count_sequence(20)
    assert counters.missed == 5
    counters.lose(GapReason.SIZE, 1)
    counters.count_sequence(21)
    counters.count_sequence(23)
    assert counters.missed == 6
    assert counters.unread == 9
    assert counters.lost == {GapReason.QUEUE: 7, GapReason.SIZE: 2, GapReason.DISK: 50}


def test_what_has_come_after_all_is_missed_no_more() -> None:
    counters = KeyCounters()
    counters.count_sequence(0)
    counters.count_sequence(2)
    counters.find()
    counters.find()
    assert counters.missed == 0


def test_each_source_of_a_key_has_a_sequence_of_its_own() -> None:
    """The number of followed sources is bounded."""
    counters = KeyCounters()
    for source, sequence in (("a", 5), ("a", 7), ("b", 900), ("b", 902), ("a", 8), ("b", 906)):
        counters.count_source(source, sequence)
    assert counters.missed == 1 + 1 + 3
    for number in range(10 * SOURCES_MAX):
        counters.count_source(str(number), 7)
    assert (counters.missed, len(counters._sources)) == (5, SOURCES_MAX)


@pytest.mark.parametrize(("severity", "level"), [(Severity.INFO, 2), (Severity.WARNING, 3), (Severity.ERROR, 4)])
def test_an_event_is_a_line_of_a_log_too(severity: Severity, level: int) -> None:
    event = SafetyEvent(
        time_ns=WALL_NS + 123,
        sequence=7,
        tick=1,
        severity=severity,
        kind=EventKind.LATCH,
        reason=Reason.REMOTE_STOP,
        operator="operator-1",
        text="a remote stop was received",
    )
    log = Log()
    log.receive(sample_of(event))
    reader = make_reader(BytesIO(log.close()), validate_crcs=True, decoder_factories=[DecoderFactory()])
    found = list(reader.iter_decoded_messages(topics=["fleet/cruiser-1/safety/event/log"]))
    ((schema, _, message, line),) = found
    assert schema is not None
    assert (schema.name, schema.encoding) == ("foxglove.Log", "protobuf")
    assert line.timestamp.ToNanoseconds() == message.publish_time == event.time_ns
    assert (line.level, line.name) == (level, "cruiser-1")
    assert line.message == "latch: a remote stop was received (operator-1)"
