"""The number of a lease is a secret: nothing that the core gets, and so nothing that it publishes, holds it."""

from itertools import count

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.command.flow import PendingReply
from gateway.command.restart import LeaseNumbers
from gateway.command.rulings import RawRequest
from schemas.decisions import LeaseReply, Reply
from schemas.reasons import Reason
from schemas.requests import LEASE_MAX
from tests.support.requests import LEASED, REQUESTS

ID = 77
NUMBER = 0x1A_2B3C_4D5E_6F70
VERBS = [command.verb for command in LEASED]


def raw(verb: str, payload: bytes, size: int | None = None) -> RawRequest:
    """A request of first's."""
    return RawRequest(0 if verb == "drive" else 5, verb, "first", payload, len(payload) if size is None else size)


def reply(verb: str, lease: int, *, ok: bool = True) -> PendingReply:
    said = LeaseReply(ok, Reason.NONE if ok else Reason.LEASE_HELD, "", "", lease=lease, expires_s=2.0)
    return PendingReply(5, verb, msgspec.msgpack.encode(said))


def held() -> LeaseNumbers:
    """Lease 77 was given, by the number that its holder knows."""
    numbers = LeaseNumbers(iter([NUMBER]).__next__)
    told = msgspec.msgpack.decode(numbers.reply(reply("acquire", ID)).payload)
    assert (told["lease"], told["expires_s"], told["ok"]) == (NUMBER, 2.0, True)
    return numbers


def shows(request: RawRequest) -> bool:
    """The number stands in it, in one of the ways in which a number is written."""
    length = (NUMBER.bit_length() + 7) // 8
    forms = (NUMBER.to_bytes(length, "big"), NUMBER.to_bytes(length, "little"), str(NUMBER).encode())
    return any(form in part for form in forms for part in (request.payload, request.fault.encode()))


@pytest.mark.parametrize("verb", VERBS)
def test_the_core_gets_the_identifier_for_the_number(verb: str) -> None:
    """All else of the request is as it was sent."""
    sent = REQUESTS[verb] | {"lease": NUMBER}
    got = held().admit(raw(verb, msgspec.msgpack.encode(sent)))
    assert not shows(got)
    read = msgspec.msgpack.decode(got.payload)
    assert {name: read[name] for name in sent} == sent | {"lease": ID}
    assert (got.verb, got.operator, got.fault) == (verb, "first", "")


@pytest.mark.parametrize("number", [ID, 0, 1, NUMBER - 1, NUMBER + 1, LEASE_MAX])
@pytest.mark.parametrize("verb", VERBS)
def test_no_other_number_is_a_lease(verb: str, number: int) -> None:
    """Above all not its identifier, which everybody may read."""
    got = held().admit(raw(verb, msgspec.msgpack.encode(REQUESTS[verb] | {"lease": number})))
    assert msgspec.msgpack.decode(got.payload)["lease"] == 0


@given(
    verb=st.sampled_from([*VERBS, "acquire", "take", "stop", "dirve", ""]),
    lease=st.sampled_from([NUMBER, float(NUMBER), str(NUMBER), str(NUMBER).encode(), [NUMBER], {"a": NUMBER}]),
    more=st.dictionaries(st.sampled_from(["role", "x"]), st.just(NUMBER)),
    tail=st.binary(max_size=3),
)
def test_a_request_that_nobody_can_read_does_not_show_it(
    verb: str, lease: object, more: dict[str, int], tail: bytes
) -> None:
    """A holder's client with a fault in it gives nothing away: bytes behind, a wrong type, field or verb."""
    payload = msgspec.msgpack.encode(REQUESTS.get(verb, {}) | {"lease": lease, **more}) + tail
    assert not shows(held().admit(raw(verb, payload)))


def test_what_cannot_be_read_is_refused_in_the_same_words() -> None:
    """The sender learns what is wrong with it, though the core never sees it."""
    got = held().admit(raw("renew", msgspec.msgpack.encode({"lease": -1})))
    assert (got.payload, got.size) == (b"", 7 + 1)
    assert "$.lease" in got.fault


@pytest.mark.parametrize("payload", [b"", b"help", b"\x81\xa5lease", msgspec.msgpack.encode({"lease": NUMBER})])
def test_a_stop_is_one_whatever_is_in_it(payload: bytes) -> None:
    """Row '`stop` {} or any bytes': nothing in it can make it a request that cannot be read."""
    got = held().admit(raw("stop", payload))
    assert (got.verb, got.payload, got.fault) == ("stop", b"", "")


def test_what_is_too_large_stays_so() -> None:
    """Its size is told; its bytes are not even read."""
    got = held().admit(raw("renew", msgspec.msgpack.encode({"lease": NUMBER}), 5000))
    assert (got.payload, got.size, got.fault) == (b"", 5000, "")


def test_a_renewal_tells_the_same_number_and_a_refusal_none() -> None:
    """A number is drawn once for each lease."""
    numbers = held()
    assert msgspec.msgpack.decode(numbers.reply(reply("renew", ID)).payload)["lease"] == NUMBER
    refused = reply("take", 0, ok=False)
    assert numbers.reply(refused) == refused
    plain = Reply(ok=True, reason=Reason.NONE, detail="", cure="")
    engaged = PendingReply(5, "engage", msgspec.msgpack.encode(plain))
    assert numbers.reply(engaged) == engaged


def test_the_lease_in_force_and_those_before_it_are_remembered() -> None:
    """However many were given: sixteen whose end is told, and the newest. The memory is bounded."""
    drawn = count(1000)
    numbers = LeaseNumbers(lambda: next(drawn))
    for lease in range(1, 501):
        numbers.reply(reply("acquire", lease))
    renewals = [raw("renew", msgspec.msgpack.encode({"lease": number})) for number in range(1000, 1500)]
    known = [msgspec.msgpack.decode(numbers.admit(one).payload)["lease"] for one in renewals]
    assert known[-17:] == list(range(484, 501))
    assert set(known[:-32]) == {0}


@pytest.mark.parametrize("verb", VERBS)
def test_a_request_of_another_version_is_not_read(verb: str) -> None:
    """Even if this version could: its fault goes on, and its payload does not."""
    good = msgspec.msgpack.encode(REQUESTS[verb] | {"lease": NUMBER})
    other = msgspec.structs.replace(raw(verb, good), fault="version 7 of it")
    admitted = held().admit(other)
    assert (admitted.fault, admitted.payload) == ("version 7 of it", b"")
