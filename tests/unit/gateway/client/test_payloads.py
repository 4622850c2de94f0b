import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.client.fleet import BY_REQUEST, NewerWords, encode_request, read_reply, read_sample
from gateway.client.refusal import refused
from gateway.telemetry.samples import Received
from schemas.codec import PayloadFault, decode_request
from schemas.decisions import LeaseReply, Reply
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.requests import Drive, Take
from schemas.subjects import BY_VERB, COMMANDS, RECORDER_SUBJECTS, Command, Subject
from tests.support.newer import NEW_WORD, grown_messages, newer, with_new_word


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_each_verbs_reply_is_read_with_its_type(command: Command) -> None:
    """What the robot says comes out as it went in."""
    reply = command.reply(ok=False, reason=Reason.BUSY, detail="d", cure="c")
    received = Received("key", command.reply_encoding, msgspec.msgpack.encode(reply))
    assert read_reply(command, received) == reply
    assert type(read_reply(command, received)) is command.reply


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_a_reply_of_a_newer_robot_is_read_as_far_as_it_is_known(command: Command) -> None:
    """A refusal for a reason that is new is a refusal; another version says who is to be upgraded."""
    reply = command.reply(ok=False, reason=Reason.BUSY, detail="d", cure="c")
    read = read_reply(command, Received("key", command.reply_encoding, with_new_word(reply, ("reason",))))
    assert isinstance(read, Reply)
    assert (read.ok, read.reason.value, read.detail) == (False, NEW_WORD, "d")
    assert NEW_WORD in str(refused("cruiser-1", command.verb, read, "ann"))
    other = read_reply(command, Received("key", newer(command.reply_encoding), b""))
    assert isinstance(other, PayloadFault)
    assert other.detail.endswith("and this program knows 1: upgrade this program")


@given(grown=grown_messages())
def test_what_a_newer_sender_says_is_read_and_counted(grown: tuple[Subject, Message, tuple[str, ...]]) -> None:
    """Each new word once, with all samples that had it."""
    subject, message, path = grown
    key = f"fleet/{'@recorder/' if subject in RECORDER_SUBJECTS else ''}a/{subject.name.format(bus='can0')}"
    words = NewerWords()
    for word in (NEW_WORD, NEW_WORD, "another"):
        sample = read_sample(Received(key, subject.encoding, with_new_word(message, path, word)))
        assert sample is not None
        assert isinstance(sample.message, subject.type)
        words.note(sample.unknown)
    assert sorted(words.counts.values()) == [1, 2]
    assert NEW_WORD in words.text
    assert "upgrade this program" in words.text
    older = read_sample(Received(key, newer(subject.encoding, -1), b""))
    assert older is not None
    assert isinstance(older.message, PayloadFault)
    assert older.message.detail.endswith(
        "upgrade the recorder" if subject in RECORDER_SUBJECTS else "upgrade the robot's gateway"
    )


def test_new_words_are_counted_up_to_a_bound() -> None:
    """They are the sender's, and could be any number."""
    words = NewerWords()
    for number in range(1000):
        words.note((f"reason {number}",))
    assert (len(words.counts), len(words.text) < 300) == (64, True)
    assert words.note(("reason 0", "reason 2000")) == []


@given(encoding=st.text() | st.just(BY_VERB["acquire"].reply_encoding), payload=st.binary())
def test_no_reply_makes_reading_raise(encoding: str, payload: bytes) -> None:
    """Another encoding, another version, any bytes: a fault with words, or a reply."""
    reply = read_reply(BY_VERB["acquire"], Received("key", encoding, payload))
    assert isinstance(reply, LeaseReply) or (isinstance(reply, PayloadFault) and reply.detail)


def test_a_reply_of_another_schema_is_a_fault() -> None:
    """A plain reply to acquire names no lease, and is not taken for one that does."""
    payload = msgspec.msgpack.encode(Reply(ok=True, reason=Reason.NONE, detail="", cure=""))
    received = Received("key", BY_VERB["stop"].reply_encoding, payload)
    assert isinstance(read_reply(BY_VERB["acquire"], received), PayloadFault)


@pytest.mark.parametrize(
    "request_",
    [Take(override=True), Drive(lease=1, seq=2, challenge=b"challeng", tick=3, speed_mps=-1.5, angle_deg=2)],
)
def test_a_request_arrives_as_it_was_meant(request_: Take | Drive) -> None:
    """The robot's decoder reads what is sent."""
    assert decode_request(BY_REQUEST[type(request_)], encode_request(request_)) == request_
