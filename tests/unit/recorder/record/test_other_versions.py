"""Senders of other versions: their samples are recorded as they are, counted, and announced once."""

import msgspec
import pytest
from hypothesis import given

from recorder.record.actions import Announcement
from schemas import codec
from schemas.decisions import EventKind
from schemas.messages import Message
from schemas.subjects import ALL_SUBJECTS, BY_TYPE, RECORDER_SUBJECTS, Subject
from tests.support.logs import PLAN, Log
from tests.support.logs import read_records as read
from tests.support.messages import (
    STANDBY,
    FakeSample,
    gear,
    key_of,
    safety_event,
    sample_of,
)
from tests.support.newer import NEW_WORD, grown_messages, newer, with_new_fields, with_new_word


def said(log: Log) -> list[Announcement]:
    return list(log.context.announcements)


@pytest.mark.parametrize("subject", [one for one in ALL_SUBJECTS if one not in RECORDER_SUBJECTS])
def test_another_version_of_any_subject_is_kept_whole_and_said_once(subject: Subject) -> None:
    key = f"fleet/cruiser-1/{subject.name.format(bus='can0')}"
    log = Log()
    for number in range(3):
        log.receive(FakeSample(key, newer(subject.encoding), b"whatever %d" % number))
    records = [content for topic, _, _, content in read(log.close()) if topic == f"{key}/@raw"]
    assert [content.payload for content in records] == [b"whatever 0", b"whatever 1", b"whatever 2"]
    assert all("and the recorder knows" in content.reason for content in records)
    (one,) = said(log)
    assert one.robot == "cruiser-1"
    assert one.text.startswith(f"{subject.name}: samples are kept as they are: version ")
    assert one.text.endswith("upgrade the recorder")


def test_an_older_sender_is_to_be_upgraded_itself() -> None:
    log = Log()
    state = BY_TYPE[type(STANDBY)]
    log.receive(FakeSample(key_of(type(STANDBY)), newer(state.encoding, -1), b""))
    assert said(log)[0].text.endswith("and the recorder knows 2: upgrade the sender")


@given(grown=grown_messages())
def test_a_message_with_a_new_word_is_kept_whole(grown: tuple[Subject, Message, tuple[str, ...]]) -> None:
    subject, message, path = grown
    if subject in RECORDER_SUBJECTS:
        return
    payload = with_new_word(message, path)
    log = Log()
    log.receive(FakeSample(key_of(subject.type), subject.encoding, payload))
    kept = [content for topic, _, _, content in read(log.close()) if topic.endswith("/@raw")]
    assert [content.payload for content in kept] == [payload]
    assert any(NEW_WORD in one.text for one in said(log))


def test_a_message_with_a_new_word_is_not_missed() -> None:
    """Else the samples after it would count as a loss on the link."""
    state = BY_TYPE[type(STANDBY)]
    log = Log()
    for number in range(4):
        message = msgspec.structs.replace(STANDBY, sequence=number)
        payload = with_new_word(message, ("latched",)) if number == 2 else codec.encode(message)
        log.receive(FakeSample(key_of(type(STANDBY)), state.encoding, payload))
    assert log.log.channels.counts[key_of(type(STANDBY))].lost_link == 0
    assert log.log.channels.get(key_of(type(STANDBY))).latest.message.sequence == 3  # type: ignore[union-attr]


@pytest.mark.parametrize("field", ["reason", "severity"])
def test_a_latch_with_a_new_word_is_an_incident_all_the_same(field: str) -> None:
    event = safety_event(EventKind.LATCH)
    subject = BY_TYPE[type(event)]
    log = Log(msgspec.structs.replace(PLAN, alarms=frozenset({EventKind.LATCH})))
    log.receive(FakeSample(key_of(type(event)), subject.encoding, with_new_word(event, (field,))))
    assert log.context.incidents == 1
    lines = [content for topic, _, _, content in read(log.close(), lines=True) if topic.endswith("/log")]
    assert [line.level for line in lines] == [3 if field == "reason" else 0]


def test_fields_of_a_newer_version_are_said_once_and_the_rest_is_recorded() -> None:
    subject = BY_TYPE[type(gear(0))]
    log = Log()
    for number in range(3):
        log.receive(FakeSample(key_of(subject.type), subject.encoding, with_new_fields(gear(number))))
    assert [topic for topic, _, _, _ in read(log.close())] == [key_of(subject.type)] * 3
    assert [one.text for one in said(log)] == [
        "chassis/gear: fields of a newer version are not recorded (field 'new_field'): upgrade the recorder"
    ]


def test_what_is_said_of_versions_is_bounded() -> None:
    log = Log()
    key, encoding = key_of(type(STANDBY)), BY_TYPE[type(STANDBY)].encoding
    for number in range(200):
        log.receive(FakeSample(key, encoding, with_new_word(STANDBY, ("latched",), f"new_{number}")))
    assert len(said(log)) == 32


def test_nothing_is_said_of_versions_where_all_is_of_this_one() -> None:
    log = Log()
    log.receive(sample_of(gear(0)), FakeSample(key_of(type(gear(0))), "text/plain", b"hello"))
    assert said(log) == []
