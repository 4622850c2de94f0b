"""The time, as far as it is proven: a robot has no clock that it can trust.

The floor is the newest time that somebody attested in a statement that was verified. It is kept across restarts.
From there the time since start-up is counted. A wall clock that is set back revives nothing; one that is set
forward only ends what would end later.

The authority attests, and each site for itself: so a site that lied, and was revoked, takes its word with it. Else
the floor never falls, but where a new authority takes the place of the former.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from schemas.authority.statement import Grant, Signed
from schemas.authority.trust import Trust

WITNESSES_KEPT: Final = 64
"""Sites whose word is kept; beyond it the earliest time goes, which counts for least."""

_S = 1_000_000_000


class Witness(msgspec.Struct, frozen=True):
    """A site, by all that would end its word.

    Attributes:
        revocable: identifiers and holders' keys of its grant and of those above, hexadecimal, sorted.
        epoch: the lowest of them.
    """

    revocable: tuple[Annotated[str, Meta(pattern=r"^([0-9a-f]{16}|[0-9a-f]{64})\Z")], ...]
    epoch: int

    @classmethod
    def of(cls, chain: Sequence[Signed]) -> Witness:
        """The site whose verified grant begins a chain."""
        grants = [one.statement for one in chain if isinstance(one.statement, Grant)]
        named = {one.id.hex() for one in chain} | {grant.key for grant in grants}
        return cls(tuple(sorted(named)), min(grant.epoch for grant in grants))

    def is_over(self, trust: Trust) -> bool:
        """Return True if the authority has revoked it. That its time is over unsays nothing."""
        return self.epoch < trust.epoch or not trust.revoked.isdisjoint(map(bytes.fromhex, self.revocable))


class Word(msgspec.Struct, frozen=True):
    """The newest time that a site attested, as it is kept: seconds since 1970."""

    witness: Witness
    at_s: int


class _Point(msgspec.Struct, frozen=True):
    """A time, and when it was: since the machine's start."""

    at_s: int
    since_ns: int

    def least_s(self, boot_ns: int) -> int:
        return self.at_s + max(0, boot_ns - self.since_ns) // _S


class TimeFloor:
    """A lower bound of the time."""

    def __init__(self, floor_s: int, boot_ns: int, words: Iterable[Word] = ()) -> None:
        """The floor as it was kept.

        Args:
            floor_s: as the authority attested it, seconds since 1970.
            boot_ns: time since the machine's start, sleep included (CLOCK_BOOTTIME).
            words: as sites did.
        """
        self._authority = _Point(floor_s, boot_ns)
        self._sites = {word.witness: _Point(word.at_s, boot_ns) for word in words}

    def least_s(self, boot_ns: int) -> int:
        """The earliest that it can be, seconds since 1970."""
        return max(point.least_s(boot_ns) for point in (self._authority, *self._sites.values()))

    def now_s(self, boot_ns: int, wall_s: int) -> int:
        """The time by which grants are judged: the later of the floor and the wall clock."""
        return max(self.least_s(boot_ns), wall_s)

    def restart(self, at_s: int, boot_ns: int) -> None:
        """A new authority says what time it is: a thief of the former one's key may have said anything."""
        self._authority = _Point(at_s, boot_ns)
        self._sites.clear()

    def lift(self, at_s: int, boot_ns: int, witness: Witness | None = None) -> None:
        """A statement that was verified says that it is so late at least.

        Args:
            at_s: seconds since 1970.
            boot_ns: time since the machine's start.
            witness: the site that signed it; None if the authority did.
        """
        point = _Point(at_s, boot_ns)
        if witness is None:
            if at_s > self._authority.least_s(boot_ns):
                self._authority = point
            return
        before = self._sites.get(witness)
        if before is not None and at_s <= before.least_s(boot_ns):
            return
        self._sites[witness] = point
        if len(self._sites) > WITNESSES_KEPT:
            del self._sites[min(self._sites, key=lambda one: self._sites[one].least_s(boot_ns))]

    def lift_by_grants(self, chain: Sequence[Signed], boot_ns: int) -> None:
        """A chain of grants was verified, and each of them has begun: it is later than that, its signer says."""
        for place, one in enumerate(chain):
            above = chain[place + 1 :]
            if isinstance(one.statement, Grant):
                self.lift(one.statement.not_before, boot_ns, Witness.of(above) if above else None)

    def forget(self, trust: Trust) -> None:
        """Drop the words of sites that are revoked now: the floor falls to the time that others attested."""
        self._sites = {one: point for one, point in self._sites.items() if not one.is_over(trust)}

    def kept(self, boot_ns: int) -> tuple[int, list[Word]]:
        """The floor as the authority attested it, and as sites did that say it is later."""
        floor_s = self._authority.least_s(boot_ns)
        words = (Word(one, point.least_s(boot_ns)) for one, point in self._sites.items())
        return floor_s, [word for word in words if word.at_s > floor_s]
