from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import PayloadFault, decode, encode
from schemas.messages import Gear, GearPosition, Message
from schemas.subjects import BY_TYPE, SUBJECTS, Subject
from tests.schemas.random_messages import subjects_and_messages

ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)
GEAR = Gear(time_ns=1, sequence=2, alive_counter=3, active=True, gear_position=GearPosition.DRIVE)


def gear_payload(**fields: object) -> bytes:
    """The payload of a gear message with some fields other than they should be."""
    good: dict[str, object] = msgpack.unpackb(encode(GEAR))
    payload: bytes = msgpack.packb(good | fields)
    return payload


@given(pair=subjects_and_messages())
def test_what_is_encoded_decodes_to_the_same_message(pair: tuple[Subject, Message]) -> None:
    """Encoding and decoding are inverse for every message of every subject."""
    subject, message = pair
    assert decode(subject, encode(message)) == message


@given(pair=subjects_and_messages())
def test_any_msgpack_library_reads_every_payload(pair: tuple[Subject, Message]) -> None:
    """The msgpack package reads each payload as a map with the field names as its keys, in their order."""
    subject, message = pair
    fields: dict[str, Any] = msgpack.unpackb(encode(message))
    assert list(fields) == list(subject.type.__struct_fields__)


@given(subject=st.sampled_from(SUBJECTS), payload=st.binary())
def test_no_bytes_make_decoding_raise(subject: Subject, payload: bytes) -> None:
    """Whatever the payload holds, the answer is a message or a fault that says what is wrong."""
    answer = decode(subject, payload)
    assert isinstance(answer, subject.type) or (isinstance(answer, PayloadFault) and answer.detail)


@given(subject=st.sampled_from(SUBJECTS), value=ANYTHING)
def test_no_value_makes_decoding_raise(subject: Subject, value: object) -> None:
    """Right MessagePack of the wrong shape is a fault too."""
    answer = decode(subject, msgpack.packb(value))
    assert isinstance(answer, PayloadFault)


@given(pair=subjects_and_messages(), data=st.data())
def test_no_damage_makes_decoding_raise(pair: tuple[Subject, Message], data: st.DataObject) -> None:
    """A payload with a byte changed and its end cut off is a message or a fault."""
    subject, message = pair
    payload = bytearray(encode(message))
    payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    answer = decode(subject, bytes(payload[: data.draw(st.integers(0, len(payload)))]))
    assert isinstance(answer, subject.type | PayloadFault)


@pytest.mark.parametrize("depth", [100, 10_000, 1_000_000])
def test_no_depth_makes_decoding_raise(depth: int) -> None:
    """Lists within lists, however deep, in a field that nobody knows, are a message or a fault."""
    payload = encode(GEAR)
    # The map has one more entry than it had: its key, then lists of one.
    deeper = bytes([payload[0] + 1]) + payload[1:] + b"\xa1x" + b"\x91" * depth + b"\xc0"
    assert isinstance(decode(BY_TYPE[Gear], deeper), Gear | PayloadFault)


def test_a_field_that_is_not_known_is_ignored() -> None:
    """A newer sender may add fields."""
    assert decode(BY_TYPE[Gear], gear_payload(novelty=[1, {"a": None}])) == GEAR


@pytest.mark.parametrize(
    "fields",
    [
        {"alive_counter": 16},
        {"alive_counter": 1.5},
        {"sequence": -1},
        {"time_ns": 2**63},
        {"active": 1},
        {"active": None},
        {"gear_position": "flying"},
    ],
)
def test_a_value_out_of_bounds_is_a_fault_that_names_the_field(fields: dict[str, object]) -> None:
    """Types, bounds and enumerations are checked, and the fault says where."""
    fault = decode(BY_TYPE[Gear], gear_payload(**fields))
    assert isinstance(fault, PayloadFault)
    assert next(iter(fields)) in fault.detail


def test_a_missing_field_is_a_fault_that_names_it() -> None:
    """No field has a start value: what is missing is never made up."""
    fault = decode(BY_TYPE[Gear], msgpack.packb({"time_ns": 1, "sequence": 2, "alive_counter": 3, "active": True}))
    assert fault == PayloadFault("Object missing required field `gear_position`")
