"""Every refusal of the authority says in words what is wrong: an operator reads them, and a log keeps them."""

from collections.abc import Callable

import msgspec
import pytest

from schemas.authority.proof import (
    STATEMENTS_MAX,
    TEXT_MAX_BYTES,
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
from schemas.authority.trust import HeldGrant, Objection, Trust
from schemas.reasons import Reason
from tests.support.authority import DAY_S, NOW_S, Fleet, Party

QUESTION = b"question"


def forged(fleet: Fleet) -> list[Signed]:
    """A grant with a signature of zeros."""
    return [msgspec.structs.replace(fleet.operator().chain[0], signature=bytes(64))]


@pytest.mark.parametrize(
    ("chain", "reason", "detail"),
    [
        (lambda _: [], Reason.GRANT_UNKNOWN, ""),
        (lambda fleet: [fleet.authority.revoke(1)], Reason.MALFORMED, "it is no grant"),
        (
            lambda _: Fleet().operator().chain,
            Reason.GRANT_UNKNOWN,
            "it is not signed by the authority that is known here",
        ),
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
    """What is wrong with it, in words."""
    fleet = Fleet()
    assert fleet.trust.judge(chain(fleet), NOW_S) == Objection(reason, detail)


def changed(outcome: Trust | Objection) -> Trust:
    """A trust that a statement has changed."""
    assert isinstance(outcome, Trust)
    return outcome


def test_what_held_once_and_does_not_now() -> None:
    """By a list, by an epoch, by another authority."""
    fleet = Fleet()
    held = fleet.trust.judge(fleet.operator(epoch=2).chain, NOW_S)
    assert isinstance(held, HeldGrant)
    listed = changed(fleet.trust.revoke(fleet.authority.revoke(8, held)))
    assert listed.objection(held, NOW_S) == Objection(Reason.GRANT_REVOKED, "by list 8")
    later = changed(fleet.trust.revoke(fleet.authority.revoke(8, epoch=3)))
    assert later.objection(held, NOW_S) == Objection(Reason.GRANT_REVOKED, "epoch 2 is over")
    rotated = changed(fleet.trust.rotate(fleet.standby.rotate(1, Party(), Party())))
    assert rotated.objection(held, NOW_S) == Objection(Reason.GRANT_REVOKED, "its authority was replaced")


def test_an_epoch_never_falls_under_one_authority() -> None:
    """A newer list raises it, and never lowers it.

    Another authority begins with an epoch of its own: all that the former one granted has ended with it.
    """
    fleet, active, standby = Fleet(), Party(), Party()
    trust = changed(fleet.trust.revoke(fleet.authority.revoke(1, epoch=5)))
    trust = changed(trust.revoke(fleet.authority.revoke(2, epoch=4)))
    assert trust.epoch == 5
    assert changed(trust.rotate(fleet.standby.rotate(2, active, standby, epoch=1))).epoch == 1


def test_lists_and_rotations_that_are_refused() -> None:
    """Another statement, another signer, an older one."""
    fleet, stranger = Fleet(), Party()
    active = Party("active")
    trust = changed(fleet.trust.rotate(fleet.standby.rotate(2, active, fleet.standby)))
    trust = changed(trust.revoke(active.revoke(3)))
    grant = fleet.operator().chain[0]
    malformed, wrong, replayed = Reason.MALFORMED, Reason.PROOF_WRONG, Reason.REPLAYED
    assert trust.revoke(grant) == Objection(malformed, "it is no list of revocations")
    assert trust.revoke(stranger.revoke(4)) == Objection(wrong, "the list is not the authority's")
    assert trust.revoke(active.revoke(3)) == Objection(replayed, "list 3 after 3")
    assert trust.rotate(grant) == Objection(malformed, "it is no rotation")
    by_stranger = stranger.rotate(3, stranger, stranger)
    assert trust.rotate(by_stranger) == Objection(wrong, "it is not signed by the standby key")
    again = fleet.standby.rotate(2, stranger, stranger)
    assert trust.rotate(again) == Objection(replayed, "rotation 2 after 2")


def test_texts_that_are_no_chain() -> None:
    """What is wrong with them, in words; the longest text and the longest chain that are read are read."""
    line = Fleet().operator().chain[0].text()
    assert isinstance(read_chain(line.encode() * STATEMENTS_MAX), list)
    assert isinstance(read_chain(line.encode() + b"\n" * (TEXT_MAX_BYTES - len(line))), list)
    unsigned = "it is not pairs of lines, a statement and its signature"
    for text, detail in (
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


def test_a_chain_is_told_from_its_text() -> None:
    """Comments and blank lines say nothing."""
    chain = Fleet().operator().chain
    assert read_chain(f"# ann\n\n{chain_text(chain)}".encode()) == chain
    assert isinstance(chain[0].statement, Grant)


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
    """A key or a name with one would be another than that which was limited, or revoked."""
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
