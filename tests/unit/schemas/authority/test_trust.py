"""The fleet's authority: wider, older, revoked and foreign grants are refused."""

from collections.abc import Callable

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.authority.proof import (
    STATEMENTS_MAX,
    Grant,
    GrantRole,
    Revocations,
    Rotation,
    Signed,
    Statement,
    StatementFault,
    body_of,
    chain_text,
    read_chain,
)
from schemas.authority.trust import BY_SITE, SAME_AUTHORITY, SMALL_ORDER, HeldGrant, Objection, Trust, fits
from schemas.reasons import Reason
from schemas.subjects import TEXT_MAX_BYTES
from tests.support.authority import DAY_S, NOW_S, Fleet, Party


def reason_of(outcome: object) -> Reason:
    return outcome.reason if isinstance(outcome, Objection) else Reason.NONE


def held(outcome: HeldGrant | Objection) -> HeldGrant:
    assert isinstance(outcome, HeldGrant), outcome
    return outcome


def test_a_grant_of_the_authority_holds() -> None:
    fleet = Fleet()
    ann = fleet.operator(speed_limit_mps=0.8)
    grant = held(fleet.trust.judge(ann.chain, NOW_S))
    assert (grant.key, grant.grant.speed_limit_mps, grant.grant.name) == (ann.key, 0.8, "ann")


@pytest.mark.parametrize("depth", [1, 2])
def test_what_a_site_granted_holds_no_more(depth: int) -> None:
    fleet, ann, signer = Fleet(), Party("ann"), Fleet().authority
    signer = fleet.site(may_delegate=depth)
    if depth == 2:
        below = Party("shift")
        signer.grant(below, role=GrantRole.SITE, may_delegate=1)
        signer = below
    signer.grant(ann)
    assert fleet.trust.judge(ann.chain, NOW_S) == Objection(Reason.NOT_GRANTED, BY_SITE)
    assert reason_of(fleet.trust.judge(ann.chain[:1], NOW_S)) is Reason.GRANT_UNKNOWN
    assert not fleet.trust.has_signed(ann.chain)


STRANGE = "it is not signed by the authority that is known here"


def forged(fleet: Fleet) -> list[Signed]:
    return [msgspec.structs.replace(fleet.operator().chain[0], signature=bytes(64))]


@pytest.mark.parametrize(
    ("chain", "reason", "detail"),
    [
        (lambda _: [], Reason.GRANT_UNKNOWN, ""),
        (lambda fleet: [fleet.authority.revoke(1)], Reason.MALFORMED, "it is not a grant"),
        (lambda _: Fleet().operator().chain, Reason.GRANT_UNKNOWN, STRANGE),
        (lambda fleet: fleet.standby.grant(Party("ann")), Reason.GRANT_UNKNOWN, STRANGE),
        (forged, Reason.PROOF_WRONG, "the signature of the grant does not fit"),
        (
            lambda fleet: fleet.operator(not_after=NOW_S - 7).chain,
            Reason.GRANT_EXPIRED,
            "it ended 2026-11-18 11:06 UTC, and here it is 2026-11-18 11:06 UTC",
        ),
        (
            lambda fleet: fleet.operator(not_before=NOW_S + DAY_S).chain,
            Reason.GRANT_EXPIRED,
            "it begins 2026-11-19 11:06 UTC, and here it is 2026-11-18 11:06 UTC",
        ),
        (
            lambda fleet: fleet.operator(not_before=2**53 - 1, not_after=2**53 - 1).chain,
            Reason.GRANT_EXPIRED,
            "it begins 9999-12-31 23:59 UTC, and here it is 2026-11-18 11:06 UTC",
        ),
    ],
)
def test_a_chain_that_does_not_hold(chain: Callable[[Fleet], list[Signed]], reason: Reason, detail: str) -> None:
    fleet = Fleet()
    found = chain(fleet)
    assert fleet.trust.judge(found, NOW_S) == Objection(reason, detail)
    assert detail != STRANGE or not fleet.trust.has_signed(found)


def changed(outcome: Trust | Objection) -> Trust:
    assert isinstance(outcome, Trust), outcome
    return outcome


def test_lists_and_rotations_that_are_refused() -> None:
    fleet, stranger, active = Fleet(), Party(), Party("active")
    kept = fleet.standby.rotate(1, fleet.authority, stranger)
    assert fleet.trust.rotate(kept) == Objection(Reason.MALFORMED, SAME_AUTHORITY)
    trust = changed(fleet.trust.rotate(fleet.standby.rotate(2, active, fleet.standby)))
    trust = changed(trust.revoke(active.revoke(3)))
    grant = fleet.operator().chain[0]
    malformed, wrong, replayed = Reason.MALFORMED, Reason.PROOF_WRONG, Reason.REPLAYED
    forged_list = msgspec.structs.replace(active.revoke(4), signature=bytes(64))
    for refused, reason, detail in (
        (trust.revoke(grant), malformed, "it is not a list of revocations"),
        (trust.revoke(stranger.revoke(4)), wrong, "the list is not the authority's"),
        (trust.revoke(fleet.site().revoke(4)), wrong, "the list is not the authority's"),
        (trust.revoke(forged_list), wrong, "the list is not the authority's"),
        (trust.revoke(active.revoke(3)), replayed, "list 3 after 3"),
        (trust.revoke(active.revoke(2)), replayed, "list 2 after 3"),
        (trust.rotate(grant), malformed, "it is not a rotation"),
        (trust.rotate(stranger.rotate(3, stranger, stranger)), wrong, "it is not signed by the standby key"),
        (trust.rotate(fleet.standby.rotate(2, stranger, stranger)), replayed, "rotation 2 after 2"),
    ):
        assert refused == Objection(reason, detail)


def test_an_epoch_never_falls_under_one_authority() -> None:
    fleet = Fleet()
    trust = fleet.trust
    for serial, epoch in ((1, 5), (2, 4)):
        trust = changed(trust.revoke(fleet.authority.revoke(serial, epoch=epoch)))
        assert trust.epoch == 5
    assert changed(trust.rotate(fleet.standby.rotate(2, Party(), Party(), epoch=1))).epoch == 1


@given(place=st.integers(0, 10_000), bit=st.integers(0, 7), part=st.sampled_from(["body", "signature"]))
def test_a_bit_that_is_changed_anywhere_ends_a_grant(place: int, bit: int, part: str) -> None:
    changed = bytearray(getattr(ANN.chain[0], part))
    changed[place % len(changed)] ^= 1 << bit
    chain = [msgspec.structs.replace(ANN.chain[0], **{part: bytes(changed)})]
    assert isinstance(FLEET.trust.judge(chain, NOW_S), Objection)


FLEET = Fleet()
ANN = Party("ann")
SITE_CHAIN = FLEET.site().grant(Party("bea"))
FLEET.authority.grant(ANN)


@pytest.mark.parametrize("offset_s", [-1, 0, DAY_S, DAY_S + 1])
def test_a_grant_holds_from_its_first_to_its_last_second(offset_s: int) -> None:
    fleet = Fleet()
    ann = fleet.operator(not_before=NOW_S, not_after=NOW_S + DAY_S)
    expected = Reason.NONE if 0 <= offset_s <= DAY_S else Reason.GRANT_EXPIRED
    assert reason_of(fleet.trust.judge(ann.chain, NOW_S + offset_s)) is expected


def test_a_revoked_grant_ends() -> None:
    fleet = Fleet()
    ann = fleet.operator()
    anns = held(fleet.trust.judge(ann.chain, NOW_S))
    for revoked in (
        fleet.authority.revoke(1, anns),
        fleet.standby.revoke(1, keys=(ann.key,)),
        fleet.authority.revoke(1, epoch=1),
    ):
        trust = fleet.trust.revoke(revoked)
        assert not isinstance(trust, Objection)
        assert reason_of(trust.judge(ann.chain, NOW_S)) is Reason.GRANT_REVOKED
        assert reason_of(trust.objection(anns, NOW_S)) is Reason.GRANT_REVOKED
    other = fleet.operator("bob", epoch=1)
    trust = fleet.trust.revoke(fleet.authority.revoke(1, anns, epoch=1))
    assert not isinstance(trust, Objection)
    assert reason_of(trust.judge(other.chain, NOW_S)) is Reason.NONE


def test_the_standby_key_replaces_a_stolen_authority() -> None:
    fleet, active, standby = Fleet(), Party("active"), Party("standby")
    ann = fleet.operator()
    anns = held(fleet.trust.judge(ann.chain, NOW_S))
    assert reason_of(fleet.trust.rotate(fleet.authority.rotate(1, active, standby))) is Reason.PROOF_WRONG
    forged = msgspec.structs.replace(fleet.standby.rotate(1, active, standby), signature=bytes(64))
    assert reason_of(fleet.trust.rotate(forged)) is Reason.PROOF_WRONG
    rotation = fleet.standby.rotate(1, active, standby)
    trust = fleet.trust.rotate(rotation)
    assert not isinstance(trust, Objection)
    assert reason_of(trust.objection(anns, NOW_S)) is Reason.GRANT_REVOKED
    assert reason_of(trust.judge(ann.chain, NOW_S)) is Reason.GRANT_UNKNOWN
    active.grant(ann)
    assert reason_of(trust.judge(ann.chain, NOW_S)) is Reason.NONE
    assert reason_of(trust.rotate(rotation)) is Reason.REPLAYED
    # The old standby key has no rights any more.
    assert reason_of(trust.rotate(fleet.standby.rotate(2, Party(), Party()))) is Reason.PROOF_WRONG
    assert reason_of(trust.rotate(fleet.standby.rotate(2, active, Party()))) is Reason.PROOF_WRONG
    assert reason_of(trust.rotate(standby.rotate(1, active, standby))) is Reason.REPLAYED


def test_a_thief_of_the_authority_bars_nobody_from_the_next_one() -> None:
    fleet, active, standby, robot = Fleet(), Party("active"), Party("standby"), Party("cruiser-1")
    highest = 2**53 - 1
    stolen = fleet.trust.revoke(fleet.authority.revoke(highest, keys=(robot.key,), epoch=highest))
    assert not isinstance(stolen, Objection)
    trust = stolen.rotate(fleet.standby.rotate(1, active, standby))
    assert not isinstance(trust, Objection)
    active.grant(robot, role=GrantRole.ROBOT, robots=["cruiser-1"])
    assert reason_of(trust.judge(robot.chain, NOW_S)) is Reason.NONE
    revoked = trust.revoke(active.revoke(1, keys=(robot.key,)))
    assert not isinstance(revoked, Objection)
    assert reason_of(revoked.judge(robot.chain, NOW_S)) is Reason.GRANT_REVOKED
    assert reason_of(revoked.revoke(fleet.authority.revoke(highest))) is Reason.PROOF_WRONG


@given(st.binary(max_size=400))
def test_whatever_is_no_chain_is_a_fault_and_no_exception(text: bytes) -> None:
    assert isinstance(read_chain(text), StatementFault)


@given(st.integers(0, 10_000), st.binary(max_size=3))
def test_a_damaged_chain_never_raises_nor_holds(place: int, instead: bytes) -> None:
    text = chain_text(SITE_CHAIN).encode()
    at = place % len(text)
    damaged = text[:at] + instead + text[at + max(1, len(instead)) :]
    chain = read_chain(damaged)
    if chain != SITE_CHAIN and not isinstance(chain, StatementFault):
        assert isinstance(FLEET.trust.judge(chain, NOW_S), Objection)


@pytest.mark.parametrize(
    ("pattern", "robot", "is_covered"),
    [
        ("*", "cruiser-1", True),
        ("cruiser-1", "cruiser-1", True),
        ("cruiser-1", "cruiser-10", False),
        ("cruiser-*", "cruiser-10", True),
        ("cruiser-*", "truck-1", False),
        ("*-1", "cruiser-1", True),
        ("*-1", "cruiser-12", False),
        ("c*-*1", "cruiser-21", True),
        ("", "cruiser-1", False),
    ],
)
def test_a_pattern_covers_whole_names(pattern: str, robot: str, *, is_covered: bool) -> None:
    fields = {"serial": 1, "name": "a", "key": "", "role": GrantRole.OPERATOR, "not_before": 0, "not_after": 0}
    assert Grant(robots=[pattern], **fields).covers(robot) is is_covered  # type: ignore[arg-type]


def test_a_statement_is_the_authority_s_if_it_or_its_standby_signed_it() -> None:
    fleet, stranger = Fleet(), Fleet()
    ann = fleet.operator(not_after=NOW_S - DAY_S)
    rotation = fleet.standby.rotate(1, Party(), Party())
    for chain in ([fleet.authority.revoke(1)], [fleet.standby.revoke(1)], [rotation], ann.chain):
        assert fleet.trust.has_signed(chain)
        assert not stranger.trust.has_signed(chain)
        assert not fleet.trust.has_signed([msgspec.structs.replace(chain[0], signature=bytes(64)), *chain[1:]])


@pytest.mark.parametrize("sign", [0, 0x80])
@pytest.mark.parametrize("key", sorted(SMALL_ORDER), ids=bytes.hex)
def test_no_signature_fits_a_key_of_small_order(key: bytes, sign: int) -> None:
    """A signature of zeros fits some or all texts with such a key."""
    nobodys = b"\x01" + bytes(63)
    found = [fits(key[:31] + bytes([key[31] | sign]), nobodys, bytes([text])) for text in range(64)]
    assert not any(found)


def test_texts_that_are_no_chain() -> None:
    """An unknown field may be a restriction."""
    line = Fleet().operator().chain[0].text()
    assert isinstance(read_chain(line.encode() * STATEMENTS_MAX), list)
    assert isinstance(read_chain(line.encode() + b"\n" * (TEXT_MAX_BYTES - len(line))), list)
    unsigned = "it is not pairs of lines, a statement and its signature"
    unknown = line.encode().replace(b'"serial":1', b'"serial":1,"only_on_sundays":true')
    for text, detail in (
        (unknown, "Object contains unknown field `only_on_sundays`"),
        (b"", unsigned),
        (b"{}\n", unsigned),
        (b"{}\n{}\n", "a statement is not followed by its signature"),
        (line.encode() * (STATEMENTS_MAX + 1), f"it has more than {STATEMENTS_MAX} statements"),
        (b" " * (TEXT_MAX_BYTES + 1), f"it is longer than {TEXT_MAX_BYTES} bytes"),
    ):
        assert read_chain(text) == StatementFault(detail)
    long = line.replace('"kind":"grant"', f'"kind":"{"x" * 400}"')
    fault = read_chain(long.encode())
    assert isinstance(fault, StatementFault)
    assert len(fault.detail) == 200


STATEMENTS = [
    Grant(
        serial=1,
        name="ann",
        key="00" * 32,
        role=GrantRole.OPERATOR,
        robots=["a*"],
        verbs=["drive"],
        not_before=0,
        not_after=1,
    ),
    Revocations(serial=1, at=0, grants=["00" * 8], keys=["00" * 32]),
    Rotation(serial=1, at=0, active="00" * 32, standby="01" * 32),
]


@pytest.mark.parametrize(
    ("statement", "field"),
    [
        (one, name)
        for one in STATEMENTS
        for name in one.__struct_fields__
        if isinstance(getattr(one, name), str | list)
    ],
)
def test_no_text_in_a_statement_has_a_line_end_behind_it(statement: Statement, field: str) -> None:
    """A key with a line end would differ from the revoked one."""
    value = getattr(statement, field)
    changed = msgspec.structs.replace(
        statement, **{field: f"{value}\n" if isinstance(value, str) else [f"{value[0]}\n"]}
    )
    signed = Party().sign(statement)
    assert not isinstance(read_chain(signed.text().encode()), StatementFault)
    body = body_of(changed)
    fault = read_chain(body + signed.text().encode()[len(signed.body) :])
    assert isinstance(fault, StatementFault)
    assert "matching regex" in fault.detail
