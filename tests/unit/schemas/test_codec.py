from math import inf, nan
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import PayloadFault, decode, decode_request, encode
from schemas.messages import Gear, GearPosition, Message
from schemas.requests import Acquire, Request, Role
from schemas.subjects import BY_TYPE, BY_VERB, COMMANDS, SUBJECTS, Command, Subject
from tests.support.requests import REQUESTS
from tests.support.strategies import ANYTHING, commands_and_requests, subjects_and_messages

Kind = Subject | Command
KINDS = st.sampled_from([*SUBJECTS, *COMMANDS])
PAIRS = subjects_and_messages() | commands_and_requests()


def read(kind: Kind, payload: bytes) -> object:
    return decode(kind, payload) if isinstance(kind, Subject) else decode_request(kind, payload)


def is_message_or_fault(kind: Kind, answer: object) -> bool:
    own = kind.type if isinstance(kind, Subject) else kind.request
    return isinstance(answer, own) or (isinstance(answer, PayloadFault) and bool(answer.detail))


@given(pair=PAIRS)
def test_what_is_encoded_decodes_to_the_same(pair: tuple[Kind, Message | Request]) -> None:
    kind, message = pair
    assert read(kind, encode(message)) == message
    fields: dict[str, Any] = msgpack.unpackb(encode(message))
    assert not isinstance(kind, Subject) or list(fields) == list(kind.type.__struct_fields__)


@given(kind=KINDS, payload=st.binary(), value=ANYTHING)
def test_nothing_makes_decoding_raise(kind: Kind, payload: bytes, value: object) -> None:
    assert is_message_or_fault(kind, read(kind, payload))
    is_whole_request = value == {} and not isinstance(kind, Subject)
    assert is_whole_request or isinstance(read(kind, msgpack.packb(value)), PayloadFault)


@given(pair=PAIRS, data=st.data())
def test_no_damage_makes_decoding_raise(pair: tuple[Kind, Message | Request], data: st.DataObject) -> None:
    kind, message = pair
    payload = bytearray(encode(message))
    payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    answer = read(kind, bytes(payload[: data.draw(st.integers(0, len(payload)))]))
    assert is_message_or_fault(kind, answer)


LIES = [b"\xdd", b"\xdf", b"\xdb", b"\xc6", b"\x81\xa5lease\xdd", b"\x81\xa4role\xdb"]
"""Lists, maps, texts or bytes that claim four thousand million parts, and have none."""
BOMBS = [b"\x91" * depth + b"\xc0" for depth in (100, 10_000, 1_000_000)]
"""Lists within lists."""


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_neither_depth_nor_a_false_length_makes_decoding_a_request_raise(command: Command) -> None:
    for payload in (
        *(head + b"\xff\xff\xff\xff" for head in LIES),
        *(head + bomb for bomb in BOMBS for head in (b"", b"\x81\xa5lease", b"\x81\xa1x")),
    ):
        assert isinstance(decode_request(command, payload), PayloadFault)


GEAR = Gear(time_ns=1, sequence=2, alive_counter=3, active=True, gear_position=GearPosition.DRIVE)


def gear_payload(**fields: object) -> bytes:
    good: dict[str, object] = msgpack.unpackb(encode(GEAR))
    payload: bytes = msgpack.packb(good | fields)
    return payload


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
    fault = decode(BY_TYPE[Gear], gear_payload(**fields))
    assert isinstance(fault, PayloadFault)
    assert next(iter(fields)) in fault.detail


CHALLENGE = b"challeng"
DRIVE = REQUESTS["drive"]


def judge(verb: str, fields: object) -> Request | PayloadFault:
    return decode_request(BY_VERB[verb], msgpack.packb(fields))


@pytest.mark.parametrize(
    ("verb", "field"),
    [
        *(("drive", field) for field in ("speed_mps", "angle_deg", "curvature_1pm", "yaw_rate_radps")),
        ("engage", "speed_limit_mps"),
    ],
)
@pytest.mark.parametrize("number", [nan, inf, -inf])
def test_a_number_that_is_none_is_a_fault_that_names_the_field(verb: str, field: str, number: float) -> None:
    assert judge(verb, REQUESTS[verb] | {field: number}) == PayloadFault(f"{field} is not a finite number")


@pytest.mark.parametrize("field", ["lease", "seq"])
@pytest.mark.parametrize("number", [-1, 2**53, 2**64 - 1, -(2**63), 1.5, 1e300, True, None, "1", [1]])
def test_a_whole_number_has_bounds(field: str, number: object) -> None:
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
    fields = REQUESTS[command.verb]
    assert isinstance(judge(command.verb, fields), command.request)
    fault = judge(command.verb, fields | {"novelty": 1})
    assert isinstance(fault, PayloadFault)
    assert "novelty" in fault.detail


@pytest.mark.parametrize("verb", ["acquire", "take", "stop"])
def test_a_verb_that_needs_nothing_may_be_sent_with_nothing(verb: str) -> None:
    assert decode_request(BY_VERB[verb], b"") == BY_VERB[verb].request()
    assert decode_request(BY_VERB["acquire"], b"") == Acquire(role=Role.OPERATOR)
    assert decode_request(BY_VERB["renew"], b"") == PayloadFault("Object missing required field `lease`")
