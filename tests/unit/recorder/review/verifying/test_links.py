"""The bytes that were chained, out of a log: the same as the gateway published, for every subject in the chain."""

import msgspec
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st
from mcap import records

from recorder.encoding.protobuf_schema import descriptor_set, schema_name
from recorder.encoding.transcode import compile_encoder
from recorder.reading.topics import Topic, topic_of
from recorder.review.verifying.links import link_reader
from schemas import codec
from schemas.authority.chain import CHAINED
from schemas.decisions import Decision
from schemas.messages import Message
from schemas.subjects import BY_NAME
from tests.support.messages import key_of
from tests.support.rigs.recorded import RecordedRig
from tests.support.strategies import message_of


def topic(kind: type[Message], schema: bytes | None = None) -> Topic:
    """The topic of a log of ours, with its own schema or another."""
    data = descriptor_set(kind) if schema is None else schema
    channel = records.Channel(id=1, topic=key_of(kind), message_encoding="protobuf", metadata={}, schema_id=1)
    return topic_of(channel, records.Schema(id=1, name=schema_name(kind), encoding="protobuf", data=data))


@pytest.mark.parametrize("name", CHAINED)
@given(data=st.data())
def test_a_message_comes_out_of_a_log_with_the_bytes_that_were_published(name: str, data: st.DataObject) -> None:
    """MessagePack to protobuf to MessagePack: no bit is lost, whatever the message says."""
    subject = BY_NAME[name]
    published = codec.encode(data.draw(message_of(subject.type)))
    received = codec.decode(subject, published)
    logged, reader = compile_encoder(subject.type)(received), link_reader(of := topic(subject.type))
    assert reader is not None
    assert of.decode is not None
    assert reader.encode(of.decode(logged)) == published
    assert not reader.hides(logged)


def test_a_gateway_publishes_what_is_decoded_and_encoded_the_same() -> None:
    """No number goes out as an integer where the message says that it is none: a recorder would make it one."""
    rig, operator = RecordedRig.driving()
    operator.ask("stop")
    rig.rest_after(1.0)
    chained = [sample for _, sample in rig.recorded if sample.subject in CHAINED]
    assert {sample.subject for sample in chained} == set(CHAINED)
    for sample in chained:
        assert codec.encode(codec.decode(BY_NAME[sample.subject], sample.payload)) == sample.payload


def _schema(*, fields: int = 0, more: str = "") -> bytes:
    """The schema of decisions, with fewer fields or with one more."""
    files = FileDescriptorSet.FromString(descriptor_set(Decision))
    (message,) = (
        message for file in files.file for message in file.message_type if message.name == Decision.__name__
    )
    if fields:
        del message.field[fields:]
        del message.oneof_decl[sum(one.proto3_optional for one in message.field) :]
    if more:
        message.field.add(name=more, number=len(message.field) + 1, type=9, label=1)
    return files.SerializeToString()


def test_of_a_log_of_before_a_field_came_the_field_is_left_out() -> None:
    """Its gateway did not publish it."""
    reader = link_reader(topic(Decision, _schema(fields=5)))
    assert reader is not None
    decision = RecordedRig.driving()[0].recorded
    payload = next(sample.payload for _, sample in decision if sample.subject == "safety/decision")
    message = codec.decode(BY_NAME["safety/decision"], payload)
    names = list(Decision.__struct_fields__)[:5]
    assert list(msgspec.msgpack.decode(reader.encode(message))) == names


@pytest.mark.parametrize("schema", [_schema(more="news"), b"", b"\xff"])
def test_a_schema_that_is_not_known_has_no_reader(schema: bytes) -> None:
    """Whoever guessed would say that a sound log was changed."""
    assert link_reader(topic(Decision, schema)) is None


def test_a_field_that_only_some_readers_see_is_hidden() -> None:
    """One of no schema, and one that this version has, and the log's schema has not."""
    own, older = link_reader(topic(Decision)), link_reader(topic(Decision, _schema(fields=5)))
    assert own is not None
    assert older is not None
    recorded = RecordedRig.driving()[0].recorded
    payload = next(sample.payload for _, sample in recorded if sample.subject == "safety/decision")
    record = compile_encoder(Decision)(codec.decode(BY_NAME["safety/decision"], payload))
    assert not own.hides(record)
    assert own.hides(record + b"\xfa\x3e\x04evil")
    assert older.hides(record)
