"""The lease: one operator at a time may command the robot, and must keep saying so.

Here a lease has an identifier, which is public. The number that its holder's requests carry is a secret, and not
known here: see ``gateway.command.lease_numbers``.
"""

from __future__ import annotations

from collections import deque
from random import Random
from typing import Final

import msgspec

from schemas.reasons import Reason
from schemas.requests import Role

_ID_BITS: Final = 48
_ENDED_KEPT: Final = 16
"""Leases whose end is remembered, so that a former holder learns the cause."""


class HeldLease(msgspec.Struct, frozen=True):
    """The right of an operator to command.

    Attributes:
        id: distinguishes it from every other lease of any run. Public.
        expires_ns: monotonic time at which it ends unless it is renewed.
    """

    id: int
    operator: str
    role: Role
    expires_ns: int


class Leases:
    """Gives, renews and ends leases; one at a time.

    Attributes:
        held: the one in force, or None.
        given: number of leases given.
    """

    def __init__(self, duration_ns: int, random: Random) -> None:
        """A desk without a lease.

        Args:
            duration_ns: a lease that is not renewed for this long expires.
            random: the source of identifiers. It keeps no secret, so that a run can be run again.
        """
        self.held: HeldLease | None = None
        self.given = 0
        self._duration_ns = duration_ns
        self._random = random
        self._ended: deque[tuple[int, Reason]] = deque(maxlen=_ENDED_KEPT)

    @property
    def ended(self) -> list[tuple[int, Reason]]:
        """The leases that ended last, and why."""
        return list(self._ended)

    def restore(self, given: int, ended: list[tuple[int, Reason]]) -> None:
        """Continue as after these leases were given and ended; nobody holds one."""
        for _ in range(given - self.given):
            self._next_id()
        self._ended.extend(ended)

    def acquire(self, operator: str, role: Role, now_ns: int) -> HeldLease | Reason:
        """Give the lease, if nobody holds it."""
        return Reason.LEASE_HELD if self.held is not None else self._give(operator, role, now_ns)

    def take(self, operator: str, role: Role, now_ns: int) -> HeldLease | Reason:
        """Give the lease to someone of a higher or equal role than its holder's."""
        if self.held is not None:
            if role.rank < self.held.role.rank:
                return Reason.ROLE_TOO_LOW
            self.end(Reason.LEASE_TAKEN)
        return self._give(operator, role, now_ns)

    def refusal(self, lease_id: int, operator: str) -> Reason | None:
        """Return why this lease of this operator is not the one in force, or None if it is."""
        lease = self.held
        if lease is not None and lease.id == lease_id and lease.operator == operator:
            return None
        return dict(self._ended).get(lease_id, Reason.NO_LEASE)

    def renew(self, now_ns: int) -> None:
        """Renew the lease: its holder has sent a request."""
        if self.held is not None:
            self.held = msgspec.structs.replace(self.held, expires_ns=now_ns + self._duration_ns)

    def end(self, reason: Reason) -> None:
        """End the lease, if there is one."""
        if self.held is not None:
            self._ended.append((self.held.id, reason))
            self.held = None

    def expire(self, now_ns: int) -> HeldLease | None:
        """End the lease if its time is over; returns it then."""
        lease = self.held
        if lease is None or now_ns < lease.expires_ns:
            return None
        self.end(Reason.LEASE_EXPIRED)
        return lease

    def _give(self, operator: str, role: Role, now_ns: int) -> HeldLease:
        self.held = HeldLease(self._next_id(), operator, role, now_ns + self._duration_ns)
        return self.held

    def _next_id(self) -> int:
        self.given += 1
        return self._random.getrandbits(_ID_BITS) + 1
