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


GEAR = msgpack.unpackb(
    encode(Gear(time_ns=1, sequence=2, alive_counter=3, active=True, gear_position=GearPosition.DRIVE))
)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("alive_counter", 16),
        ("alive_counter", 1.5),
        ("sequence", -1),
        ("time_ns", 2**63),
        ("active", 1),
        ("active", None),
        ("gear_position", "flying"),
    ],
)
def test_a_value_of_a_message_out_of_bounds_is_a_fault_that_names_the_field(field: str, value: object) -> None:
    fault = decode(BY_TYPE[Gear], msgpack.packb(GEAR | {field: value}))
    assert isinstance(fault, PayloadFault)
    assert field in fault.detail


NO_WHOLE_NUMBERS = (-1, 2**53, 2**64 - 1, -(2**63), 1.5, 1e300, True, None, "1", [1])
NO_CHALLENGES = (b"", bytes(7), bytes(9), "challeng", 8, [8])


def judge(verb: str, fields: object) -> Request | PayloadFault:
    return decode_request(BY_VERB[verb], msgpack.packb(fields))


@pytest.mark.parametrize(
    ("verb", "field", "values"),
    [
        *(
            ("drive", field, (nan, inf, -inf))
            for field in ("speed_mps", "angle_deg", "curvature_1pm", "yaw_rate_radps")
        ),
        ("engage", "speed_limit_mps", (nan, inf, -inf)),
        *(("drive", field, NO_WHOLE_NUMBERS) for field in ("lease", "seq")),
        *((verb, "challenge", NO_CHALLENGES) for verb in ("drive", "engage", "reset")),
        *((command.verb, "novelty", (1,)) for command in COMMANDS),
    ],
)
def test_a_wrong_field_of_a_request_is_a_fault_that_names_it(
    verb: str, field: str, values: tuple[object, ...]
) -> None:
    """Row 'command age, by echo': a challenge is 8 bytes. Numbers are finite, and exact in every language."""
    assert isinstance(judge(verb, REQUESTS[verb]), BY_VERB[verb].request)
    for value in values:
        fault = judge(verb, REQUESTS[verb] | {field: value})
        assert isinstance(fault, PayloadFault)
        assert field in fault.detail


@pytest.mark.parametrize("verb", ["acquire", "take", "stop"])
def test_a_verb_that_needs_nothing_may_be_sent_with_nothing(verb: str) -> None:
    assert decode_request(BY_VERB[verb], b"") == BY_VERB[verb].request()
    assert decode_request(BY_VERB["acquire"], b"") == Acquire(role=Role.OPERATOR)
    assert decode_request(BY_VERB["renew"], b"") == PayloadFault("Object missing required field `lease`")
