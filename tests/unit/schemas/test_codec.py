from math import inf, nan
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import PayloadFault, decode, decode_request, encode
from schemas.messages import Gear, GearPosition, Message
from schemas.requests import Acquire, Drive, Request, Role
from schemas.subjects import BY_TYPE, BY_VERB, COMMANDS, SUBJECTS, Command, Subject
from tests.support.requests import REQUESTS
from tests.support.strategies import ANYTHING, commands_and_requests, subjects_and_messages

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


CHALLENGE = b"challeng"
DRIVE = REQUESTS["drive"]


def judge(verb: str, fields: object) -> Request | PayloadFault:
    """What a request of these fields is taken for."""
    return decode_request(BY_VERB[verb], msgpack.packb(fields))


@given(pair=commands_and_requests())
def test_a_request_decodes_to_what_was_asked(pair: tuple[Command, Request]) -> None:
    """Encoding and decoding are inverse for every request of every verb."""
    command, request = pair
    assert decode_request(command, encode(request)) == request


@given(command=st.sampled_from(COMMANDS), payload=st.binary())
def test_no_bytes_make_decoding_a_request_raise(command: Command, payload: bytes) -> None:
    """Whatever was sent, the answer is a request or a fault that says what is wrong."""
    answer = decode_request(command, payload)
    assert isinstance(answer, command.request) or (isinstance(answer, PayloadFault) and answer.detail)


@given(command=st.sampled_from(COMMANDS), value=ANYTHING)
def test_what_is_no_map_is_no_request(command: Command, value: object) -> None:
    """Right MessagePack of the wrong shape is a fault; so is a map of fields that the verb does not have."""
    answer = decode_request(command, msgpack.packb(value))
    assert isinstance(answer, PayloadFault) or value == {}


@given(pair=commands_and_requests(), data=st.data())
def test_a_field_of_any_value_makes_no_request_raise(pair: tuple[Command, Request], data: st.DataObject) -> None:
    """Each field of each verb, with anything at all in it."""
    command, request = pair
    fields: dict[str, Any] = msgpack.unpackb(encode(request))
    if fields:
        fields[data.draw(st.sampled_from(sorted(fields)))] = data.draw(ANYTHING)
    answer = decode_request(command, msgpack.packb(fields))
    assert isinstance(answer, command.request) or (isinstance(answer, PayloadFault) and answer.detail)


@given(pair=commands_and_requests(), data=st.data())
def test_no_damage_makes_decoding_a_request_raise(pair: tuple[Command, Request], data: st.DataObject) -> None:
    """A request with a byte changed and its end cut off is a request or a fault."""
    command, request = pair
    payload = bytearray(encode(request))
    payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    answer = decode_request(command, bytes(payload[: data.draw(st.integers(0, len(payload)))]))
    assert isinstance(answer, command.request | PayloadFault)


@pytest.mark.parametrize("field", ["speed_mps", "angle_deg", "curvature_1pm", "yaw_rate_radps"])
@pytest.mark.parametrize("number", [nan, inf, -inf])
def test_a_number_that_is_none_is_a_fault_that_names_the_field(field: str, number: float) -> None:
    """No comparison with a limit holds for it, so it must not come as far as that."""
    assert judge("drive", DRIVE | {field: number}) == PayloadFault(f"{field} is not a finite number")


@pytest.mark.parametrize("number", [nan, inf, -inf])
def test_a_speed_limit_is_finite_too(number: float) -> None:
    """A limit that is no number would limit nothing."""
    assert isinstance(
        judge("engage", {"lease": 1, "challenge": CHALLENGE, "speed_limit_mps": number}), PayloadFault
    )


@pytest.mark.parametrize("number", [1.7976931348623157e308, -1.7976931348623157e308, 5e-324, 2**64 - 1, -(2**63)])
def test_a_huge_number_is_a_number(number: float) -> None:
    """It is finite, and the limits deal with it."""
    assert isinstance(judge("drive", DRIVE | {"speed_mps": number}), Drive)


@pytest.mark.parametrize("field", ["lease", "seq"])
@pytest.mark.parametrize("number", [-1, 2**53, 2**64 - 1, -(2**63), 1.5, 1e300, True, None, "1", [1]])
def test_a_whole_number_has_bounds(field: str, number: object) -> None:
    """A lease and a sequence are what every language holds exactly, and nothing else."""
    fault = judge("drive", DRIVE | {field: number})
    assert isinstance(fault, PayloadFault)
    assert field in fault.detail


@pytest.mark.parametrize("verb", ["drive", "engage", "reset"])
@pytest.mark.parametrize("challenge", [b"", bytes(7), bytes(9), "challeng", 8, [8]])
def test_a_challenge_is_eight_bytes(verb: str, challenge: object) -> None:
    """Row 'command age, by echo': nothing else is one."""
    fields = REQUESTS[verb]
    fault = judge(verb, fields | {"challenge": challenge})
    assert isinstance(fault, PayloadFault)
    assert "challenge" in fault.detail
    assert not isinstance(judge(verb, fields | {"challenge": CHALLENGE}), PayloadFault)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_a_request_with_a_field_that_is_not_known_is_refused(command: Command) -> None:
    """Who sent it meant something by it: a command is not obeyed in part."""
    fields = REQUESTS[command.verb]
    assert isinstance(judge(command.verb, fields), command.request)
    fault = judge(command.verb, fields | {"novelty": 1})
    assert isinstance(fault, PayloadFault)
    assert "novelty" in fault.detail


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
@pytest.mark.parametrize("depth", [100, 10_000, 1_000_000])
def test_no_depth_makes_decoding_a_request_raise(command: Command, depth: int) -> None:
    """Lists within lists, however deep: as the request, in a field that is known, and in one that is not."""
    bomb = b"\x91" * depth + b"\xc0"
    for payload in (bomb, b"\x81\xa5lease" + bomb, b"\x81\xa1x" + bomb):
        assert isinstance(decode_request(command, payload), PayloadFault)


@pytest.mark.parametrize("head", [b"\xdd", b"\xdf", b"\xdb", b"\xc6", b"\x81\xa5lease\xdd", b"\x81\xa4role\xdb"])
def test_a_length_that_is_a_lie_is_a_fault(head: bytes) -> None:
    """A list, map, text or bytes that claims four thousand million parts, and has none."""
    for command in COMMANDS:
        assert isinstance(decode_request(command, head + b"\xff\xff\xff\xff"), PayloadFault)


@pytest.mark.parametrize("verb", ["acquire", "take", "stop"])
def test_a_verb_that_needs_nothing_may_be_sent_with_nothing(verb: str) -> None:
    """No payload at all means the start values; a verb that needs something says what."""
    assert decode_request(BY_VERB[verb], b"") == BY_VERB[verb].request()
    assert decode_request(BY_VERB["acquire"], b"") == Acquire(role=Role.OPERATOR)
    assert decode_request(BY_VERB["renew"], b"") == PayloadFault("Object missing required field `lease`")
