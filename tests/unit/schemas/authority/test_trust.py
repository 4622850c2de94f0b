"""Who is believed: every wider, older, revoked or foreign grant is refused."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.authority.proof import Grant, GrantRole, StatementFault, chain_text, read_chain
from schemas.authority.trust import BY_SITE, SAME_AUTHORITY, SMALL_ORDER, HeldGrant, Objection, fits
from schemas.reasons import Reason
from tests.support.authority import DAY_S, NOW_S, Fleet, Party


def reason_of(outcome: object) -> Reason:
    """Why something was refused; NONE if it was not."""
    return outcome.reason if isinstance(outcome, Objection) else Reason.NONE


def held(outcome: HeldGrant | Objection) -> HeldGrant:
    """A grant that has to hold."""
    assert isinstance(outcome, HeldGrant), outcome
    return outcome


def test_a_grant_of_the_authority_holds() -> None:
    """With the key and the limits that it names."""
    fleet = Fleet()
    ann = fleet.operator(speed_limit_mps=0.8)
    grant = held(fleet.trust.judge(ann.chain, NOW_S))
    assert (grant.key, grant.grant.speed_limit_mps, grant.grant.name) == (ann.key, 0.8, "ann")


@pytest.mark.parametrize("depth", [1, 2])
def test_what_a_site_granted_holds_no_more(depth: int) -> None:
    """As an earlier version made it, whole or cut: the authority alone grants, and the refusal says what to do."""
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


def test_what_the_authority_did_not_sign_is_not_believed() -> None:
    """Another authority; the standby key, which signs no grants."""
    fleet, ann = Fleet(), Party("ann")
    for signer in (Fleet().authority, fleet.standby):
        signer.grant(ann)
        assert reason_of(fleet.trust.judge(ann.chain, NOW_S)) is Reason.GRANT_UNKNOWN
        assert not fleet.trust.has_signed(ann.chain)
    assert reason_of(fleet.trust.judge([], NOW_S)) is Reason.GRANT_UNKNOWN


@given(place=st.integers(0, 10_000), bit=st.integers(0, 7), part=st.sampled_from(["body", "signature"]))
def test_a_bit_that_is_changed_anywhere_ends_a_grant(place: int, bit: int, part: str) -> None:
    """In its body or in its signature."""
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
    """Both included."""
    fleet = Fleet()
    ann = fleet.operator(not_before=NOW_S, not_after=NOW_S + DAY_S)
    expected = Reason.NONE if 0 <= offset_s <= DAY_S else Reason.GRANT_EXPIRED
    assert reason_of(fleet.trust.judge(ann.chain, NOW_S + offset_s)) is expected


def test_a_revoked_grant_ends() -> None:
    """By its identifier, by its holder's key, or by epoch."""
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


def test_a_list_of_revocations_is_the_authoritys_and_newer() -> None:
    """An older list, the same again and one of anybody else change nothing; an epoch never falls."""
    fleet = Fleet()
    trust = fleet.trust.revoke(fleet.authority.revoke(7, epoch=3))
    assert not isinstance(trust, Objection)
    assert trust.epoch == 3
    for serial in (6, 7):
        assert reason_of(trust.revoke(fleet.authority.revoke(serial))) is Reason.REPLAYED
    assert reason_of(trust.revoke(fleet.site().revoke(8))) is Reason.PROOF_WRONG
    forged = msgspec.structs.replace(fleet.authority.revoke(8), signature=bytes(64))
    assert reason_of(trust.revoke(forged)) is Reason.PROOF_WRONG
    newer = trust.revoke(fleet.authority.revoke(8))
    assert not isinstance(newer, Objection)
    assert newer.epoch == 3


def test_the_standby_key_replaces_a_stolen_authority() -> None:
    """All that the old key signed ends; nobody but the standby key can do it."""
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
    # The old standby is nobody now.
    assert reason_of(trust.rotate(fleet.standby.rotate(2, Party(), Party()))) is Reason.PROOF_WRONG
    assert reason_of(trust.rotate(fleet.standby.rotate(2, active, Party()))) is Reason.PROOF_WRONG
    assert reason_of(trust.rotate(standby.rotate(1, active, standby))) is Reason.REPLAYED


def test_a_thief_of_the_authority_bars_nobody_from_the_next_one() -> None:
    """Its list revokes the robot under the highest serial and epoch; after the rotation none of it counts."""
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


def test_the_standby_is_replaced_with_the_authority_alone() -> None:
    """A rotation that keeps the authority's key changes nothing, and says what to do."""
    fleet = Fleet()
    rotation = fleet.standby.rotate(1, fleet.authority, Party("standby"))
    assert fleet.trust.rotate(rotation) == Objection(Reason.MALFORMED, SAME_AUTHORITY)


def test_statements_of_another_kind_do_nothing() -> None:
    """A grant revokes nothing, a list grants nothing."""
    fleet, ann = Fleet(), Fleet().operator()
    trust = fleet.trust
    assert reason_of(trust.revoke(ann.chain[0])) is Reason.MALFORMED
    assert reason_of(trust.rotate(ann.chain[0])) is Reason.MALFORMED
    assert reason_of(trust.judge([fleet.authority.revoke(1)], NOW_S)) is Reason.MALFORMED


def test_a_chain_is_read_as_it_was_written() -> None:
    """Comments and blank lines say nothing."""
    assert read_chain(chain_text(SITE_CHAIN).encode()) == SITE_CHAIN
    assert read_chain(b"# of Ann\n\n" + chain_text(SITE_CHAIN).encode()) == SITE_CHAIN


@given(st.binary(max_size=400))
def test_whatever_is_no_chain_is_a_fault_and_no_exception(text: bytes) -> None:
    """It comes from anyone."""
    assert isinstance(read_chain(text), StatementFault)


@given(st.integers(0, 10_000), st.binary(max_size=3))
def test_a_damaged_chain_never_raises_nor_holds(place: int, instead: bytes) -> None:
    """Wherever it is damaged."""
    text = chain_text(SITE_CHAIN).encode()
    at = place % len(text)
    damaged = text[:at] + instead + text[at + max(1, len(instead)) :]
    chain = read_chain(damaged)
    if chain != SITE_CHAIN and not isinstance(chain, StatementFault):
        assert isinstance(FLEET.trust.judge(chain, NOW_S), Objection)


@pytest.mark.parametrize(
    ("text", "detail"),
    [
        (chain_text(SITE_CHAIN) * 2, "more than 3"),
        ("x" * 20_000, "longer than"),
        ('{"kind":"grant"}\n', "pairs"),
        ('{"kind":"grant"}\ned25519 00 00\n', "not followed by its signature"),
        (chain_text(SITE_CHAIN).replace('"serial":1', '"serial":1,"only_on_sundays":true'), "only_on_sundays"),
    ],
)
def test_what_is_wrong_with_a_text_is_said(text: str, detail: str) -> None:
    """A field that is not known is an error: it may restrict."""
    fault = read_chain(text.encode())
    assert isinstance(fault, StatementFault)
    assert detail in fault.detail


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
    """The star stands for any letters, nothing else for any other."""
    fields = {"serial": 1, "name": "a", "key": "", "role": GrantRole.OPERATOR, "not_before": 0, "not_after": 0}
    assert Grant(robots=[pattern], **fields).covers(robot) is is_covered  # type: ignore[arg-type]


def test_a_statement_is_the_authority_s_if_it_or_its_standby_signed_it() -> None:
    """Also one that is over; that of a stranger, or one that was changed, is not."""
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
    """One of zeros fits a part of all texts, or all of them, although nobody made it."""
    nobodys = b"\x01" + bytes(63)
    found = [fits(key[:31] + bytes([key[31] | sign]), nobodys, bytes([text])) for text in range(64)]
    assert not any(found)
