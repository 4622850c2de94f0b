"""Events as viewers list them."""

from io import BytesIO

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.reasons import Reason
from tests.support.logs import Log
from tests.support.messages import WALL_NS, sample_of


@pytest.mark.parametrize(("severity", "level"), [(Severity.INFO, 2), (Severity.WARNING, 3), (Severity.ERROR, 4)])
def test_an_event_is_a_line_of_a_log_too(severity: Severity, level: int) -> None:
    """On a topic of its own, with its time, its severity and its words, as any protobuf reader decodes it."""
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
