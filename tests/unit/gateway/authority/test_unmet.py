"""Why a robot is not met: in words, with dates and the cure."""

from __future__ import annotations

import pytest

from gateway.authority.session import SOMEBODY_ELSE, Unmet, not_believed, not_taken
from schemas.authority.proof import GrantRole, Signed
from schemas.authority.trust import Objection, fingerprint
from schemas.reasons import Reason
from tests.support.authority import DAY_S, NOW_S, Fleet, Party

FLEET = Fleet()
LATER_S = 2**53 - 1


def robots_grant() -> list[Signed]:
    """The chain of a robot, which holds for a day before and after now."""
    return FLEET.authority.grant(Party("cruiser-1"), role=GrantRole.ROBOT, robots=["cruiser-1"])


def own_unmet(now_s: int) -> Unmet:
    """Why a robot is not believed where the clock says this."""
    objection = FLEET.trust.judge(chain := robots_grant(), now_s)
    assert isinstance(objection, Objection)
    return not_believed(objection, chain, FLEET.trust, now_s)


@pytest.mark.parametrize(
    ("now_s", "text", "cure"),
    [
        (
            NOW_S - 2 * DAY_S,
            "begins on 2026-11-17 11:06 UTC, and this computer's clock says 2026-11-16 11:06 UTC",
            "set this computer's clock: it is behind",
        ),
        (
            NOW_S + 2 * DAY_S,
            "ended on 2026-11-19 11:06 UTC, and this computer's clock says 2026-11-20 11:06 UTC",
            "set this computer's clock if it is wrong; if not, the robot needs a new grant: ",
        ),
    ],
)
def test_a_robots_grant_that_is_over_is_said_with_its_date_and_the_clock(now_s: int, text: str, cure: str) -> None:
    """Whoever reads it sees which of the two is wrong."""
    unmet = own_unmet(now_s)
    assert (unmet.reason, unmet.is_refusal) == (Reason.GRANT_EXPIRED, False)
    assert unmet.text == f"the robot's own grant {text}"
    assert unmet.cure.startswith(cure)


def test_another_authority_is_said_with_both_fingerprints() -> None:
    """Of the robot's, and of the one in the file here."""
    other = Fleet()
    objection = other.trust.judge(chain := robots_grant(), NOW_S)
    assert isinstance(objection, Objection)
    unmet = not_believed(objection, chain, other.trust, NOW_S)
    theirs, ours = fingerprint(FLEET.authority.key), fingerprint(other.authority.key)
    assert (unmet.reason, unmet.is_refusal) == (Reason.GRANT_UNKNOWN, False)
    assert f"is signed by the authority's key {theirs}, and authority.json here names the key {ours}" in unmet.text


def test_any_other_doubt_is_said_as_it_is() -> None:
    """The cure is to look: somebody may answer in the robot's place."""
    doubt = Objection(Reason.PROOF_WRONG, "the reply is not the robot's")
    unmet = not_believed(doubt, [], FLEET.trust, NOW_S)
    assert unmet == Unmet(Reason.PROOF_WRONG, "the reply is not the robot's", SOMEBODY_ELSE)


def test_a_grant_that_the_robot_refuses_is_said_with_its_dates_where_they_matter() -> None:
    """A revoked one is revoked at any time."""
    chain = FLEET.operator(not_after=NOW_S - 60).chain
    over = not_taken(Objection(Reason.GRANT_EXPIRED, "60 s ago"), "the robot's", chain, NOW_S)
    assert over.text == (
        "it refuses the grant: the grant is over, or has not begun; 60 s ago. The grant here ended on "
        "2026-11-18 11:05 UTC, and this computer's clock says 2026-11-18 11:06 UTC"
    )
    assert over.is_refusal
    assert over.cure.startswith("set the clock that is wrong, if one is; if not, get a new grant: ")
    revoked = not_taken(Objection(Reason.GRANT_REVOKED, "by list 1"), "ask them", chain, NOW_S)
    assert (revoked.text, revoked.cure) == ("it refuses the grant: the grant was revoked; by list 1", "ask them")


def test_a_grant_of_any_date_can_be_said() -> None:
    """The last one is of a year that no calendar has."""
    chain = FLEET.operator(not_after=LATER_S).chain
    said = not_taken(Objection(Reason.GRANT_EXPIRED, "by its clock"), "", chain, NOW_S).text
    assert "holds from 2026-11-17 11:06 UTC until 9999-12-31 23:59 UTC" in said
