import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.client.payloads import BY_REQUEST, encode_request, read_reply
from gateway.telemetry.received import Received
from schemas.codec import PayloadFault, decode_request
from schemas.decisions import LeaseReply, Reply
from schemas.reasons import Reason
from schemas.requests import Drive, Take
from schemas.subjects import BY_VERB, COMMANDS, Command


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_each_verbs_reply_is_read_with_its_type(command: Command) -> None:
    """What the robot says comes out as it went in."""
    reply = command.reply(ok=False, reason=Reason.BUSY, detail="d", cure="c")
    received = Received("key", command.reply_encoding, msgspec.msgpack.encode(reply))
    assert read_reply(command, received) == reply
    assert type(read_reply(command, received)) is command.reply


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
