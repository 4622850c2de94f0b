"""Why a robot is not believed, or does not take somebody's grant: in words, with the cure. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final

import msgspec

from schemas.authority.proof import Grant, Signed
from schemas.authority.trust import Objection, Trust, fingerprint
from schemas.reasons import TEXTS, Reason

LATEST_S: Final = 253_402_300_799
"""The last second of the year 9999: what dates can say."""

SOMEBODY_ELSE: Final = "look at the robot: somebody may answer in its place"


class Unmet(msgspec.Struct, frozen=True):
    """The reason why a robot is not met.

    Attributes:
        reason: an enumeration.
        text: the reason in words, with dates.
        cure: the way to make it succeed.
        is_refusal: the robot is believed, and refuses the grant that it was shown.
    """

    reason: Reason
    text: str
    cure: str
    is_refusal: bool = False


SILENT: Final = Unmet(
    Reason.PROOF_MISSING,
    "it does not say who it is: its own keys may be missing or damaged, or it is not in signed mode",
    "'cruiser why ROBOT' shows what it says of itself, not verified",
)
"""A robot that answers nothing on ``@auth``."""

UNSIGNED: Final = Unmet(
    Reason.PROOF_WRONG,
    "its answer is not signed by the robot that was met",
    "it may have been started again: try again; 'cruiser why ROBOT' shows what it says of itself",
)
"""A robot that was met, and whose answer does not fit its key."""


NEW_GRANT: Final = "'cruiser provision renew operator', 'sign' at the authority, 'install --replace'"

_CURES: Final = {
    Reason.GRANT_EXPIRED: f"set the clock that is wrong, if one is; if not, get a new grant: {NEW_GRANT}",
    Reason.GRANT_UNKNOWN: f"get a grant of the authority that this robot has: {NEW_GRANT}, with --fingerprint F",
}
"""Cures of a grant that a robot refuses, where they say more than the robot's own."""


def not_believed(objection: Objection, chain: Sequence[Signed], trust: Trust, now_s: int) -> Unmet:
    """Return why the robot whose reply has this chain is not believed.

    Args:
        objection: to the reply.
        chain: the robot's own grant, and those of its signers; empty if it cannot be read.
        trust: the fleet's authority, as it is known here.
        now_s: by this computer's clock, seconds since 1970.
    """
    life = life_of(chain, now_s)
    if objection.reason is Reason.GRANT_EXPIRED and life:
        is_over = all(one.statement.not_before <= now_s for one in chain if isinstance(one.statement, Grant))
        cure = (
            "set this computer's clock if it is wrong; if not, the robot needs a new grant: "
            "'cruiser provision renew robot' on the robot, 'sign' at the authority, 'install --replace'"
            if is_over
            else "set this computer's clock: it is behind"
        )
        return Unmet(objection.reason, f"the robot's own grant {life}, and {_clock(now_s)}", cure)
    if objection.reason is Reason.GRANT_UNKNOWN and chain:
        return Unmet(
            objection.reason,
            f"the robot's own grant is signed by the authority's key {fingerprint(chain[-1].signer)}, and "
            f"authority.json here names the key {fingerprint(trust.active)}",
            "if it is a robot of yours, one of the two has the files of a former authority: 'cruiser provision "
            "renew' there, 'sign' at the authority of today, 'install --replace --fingerprint F'",
        )
    return Unmet(objection.reason, objection.detail or objection.text, SOMEBODY_ELSE)


def not_taken(objection: Objection, cure: str, chain: Sequence[Signed], now_s: int) -> Unmet:
    """Return why a robot that is believed refuses the grant that it was shown.

    Args:
        objection: the robot's, in its reply.
        cure: the robot's.
        chain: the grant, and those of its signers; empty if none was shown.
        now_s: by this computer's clock, seconds since 1970.
    """
    life = life_of(chain, now_s)
    dates = f". The grant here {life}, and {_clock(now_s)}" if life else ""
    timely = dates if objection.reason is Reason.GRANT_EXPIRED else ""
    return Unmet(
        objection.reason,
        f"it refuses the grant: {objection.text}{timely}",
        _CURES.get(objection.reason) or cure or TEXTS[objection.reason].cure,
        is_refusal=True,
    )


def life_of(chain: Sequence[Signed], now_s: int) -> str:
    """Return when a chain of grants holds, or why it does not hold now, in words; empty if it has no grant."""
    grants = [one.statement for one in chain if isinstance(one.statement, Grant)]
    if not grants:
        return ""
    begins_s, ends_s = max(one.not_before for one in grants), min(one.not_after for one in grants)
    if now_s > ends_s:
        return f"ended on {_date(ends_s)}"
    if now_s < begins_s:
        return f"begins on {_date(begins_s)}"
    return f"holds from {_date(begins_s)} until {_date(ends_s)}"


def _clock(now_s: int) -> str:
    return f"this computer's clock says {_date(now_s)}"


def _date(time_s: int) -> str:
    return f"{datetime.fromtimestamp(min(time_s, LATEST_S), UTC):%Y-%m-%d %H:%M} UTC"
