"""The lease, the link to its holder, and the age of the holder's commands. Pure.

- ``Leases``: one operator at a time may command the robot, and must renew. A lease has a public identifier here;
  its number is a secret (``gateway.command.restart``).
- ``ChallengeLog``: the greatest age of a command, without a common clock. Each published state carries random
  bytes, and a command echoes the newest that its sender had seen, so it was made after they were published. This
  distinguishes a new command from a stalled link, a replay and a wrong clock.
- ``OperatorLink``: order, age and content of the holder's drive commands.
- ``LinkAge``: the speed that this age allows. The robot drives some metres before it can react to its operator;
  ``command.travel_delay_m`` bounds these metres, and so the speed.
"""

from __future__ import annotations

from collections import deque
from math import copysign
from random import Random
from typing import Final

import msgspec

from gateway.command.motion import Target
from schemas.reasons import Reason
from schemas.requests import Role
from schemas.settings import DEADMAN_MAX_S, CommandSettings

_ID_BITS: Final = 48
_ENDED_KEPT: Final = 16
"""Ended leases that are remembered, so that a former holder learns the cause."""


class HeldLease(msgspec.Struct, frozen=True):
    """The right of an operator to command.

    Attributes:
        id: public, unique across runs.
        expires_ns: monotonic time at which it ends unless it is renewed.
    """

    id: int
    operator: str
    role: Role
    expires_ns: int


class Leases:
    """Gives, renews and ends leases, one at a time."""

    def __init__(self, duration_ns: int, random: Random) -> None:
        """Start without a lease. Identifiers are no secret, so a rerun can draw the same ones."""
        self.held: HeldLease | None = None
        self.given = 0
        self._duration_ns = duration_ns
        self._random = random
        self._ended: deque[tuple[int, Reason]] = deque(maxlen=_ENDED_KEPT)

    @property
    def ended(self) -> list[tuple[int, Reason]]:
        return list(self._ended)

    def restore(self, given: int, ended: list[tuple[int, Reason]]) -> None:
        """Continue after this many leases; none is held."""
        for _ in range(given - self.given):
            self._next_id()
        self._ended.extend(ended)

    def acquire(self, operator: str, role: Role, now_ns: int) -> HeldLease | Reason:
        """Give the lease if it is free."""
        return Reason.LEASE_HELD if self.held is not None else self._give(operator, role, now_ns)

    def take(self, operator: str, role: Role, now_ns: int) -> HeldLease | Reason:
        """Give the lease to an operator whose role is at least that of its holder."""
        if self.held is not None:
            if role.rank < self.held.role.rank:
                return Reason.ROLE_TOO_LOW
            self.end(Reason.LEASE_TAKEN)
        return self._give(operator, role, now_ns)

    def refusal(self, lease_id: int, operator: str) -> Reason | None:
        """Return why this operator's lease is not the one in force; None if it is."""
        lease = self.held
        if lease is not None and lease.id == lease_id and lease.operator == operator:
            return None
        return dict(self._ended).get(lease_id, Reason.NO_LEASE)

    def renew(self, now_ns: int) -> None:
        """Renew the lease, because its holder sent a request."""
        if self.held is not None:
            self.held = msgspec.structs.replace(self.held, expires_ns=now_ns + self._duration_ns)

    def end(self, reason: Reason) -> None:
        if self.held is not None:
            self._ended.append((self.held.id, reason))
            self.held = None

    def expire(self, now_ns: int) -> HeldLease | None:
        """End the lease if it has expired. Returns it then."""
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


REMEMBERED_NS: Final = 4_000_000_000
"""Age at which challenges are forgotten: a command that echoes an older one is too old for any setting."""


class ChallengeLog:
    """The times at which challenges were published."""

    def __init__(self) -> None:
        self._published: deque[tuple[bytes, int]] = deque()
        self._times_ns: dict[bytes, int] = {}

    @property
    def published(self) -> list[tuple[bytes, int]]:
        return list(self._published)

    def restore(self, published: list[tuple[bytes, int]]) -> None:
        self._published = deque(published)
        self._times_ns = dict(self._published)

    def publish(self, challenge: bytes, now_ns: int) -> None:
        self._published.append((challenge, now_ns))
        self._times_ns[challenge] = now_ns
        while now_ns - self._published[0][1] > REMEMBERED_NS:
            self._times_ns.pop(self._published.popleft()[0], None)

    def age_ns(self, challenge: bytes, now_ns: int) -> int | Reason:
        """Return the greatest age of a command that echoes this challenge, or why it is not known."""
        published_ns = self._times_ns.get(challenge)
        return Reason.CHALLENGE_UNKNOWN if published_ns is None else now_ns - published_ns


MEAN_NS: Final = 1_000_000_000
"""The age that bounds the speed is at least the mean over this time: no deadman lasts longer."""

LARGEST_NS: Final = 300_000_000
"""It is also at least the largest age in this time: a link that just became slow is slow."""

QUANTILES_NS: Final = 10_000_000_000
"""Time over which median and 99th percentile are computed."""

RANK_NS: Final = 200_000_000
"""Period at which both are computed: sorting takes time in the loop."""

KEPT: Final = 500
"""Most commands that they are computed from, 50 a second."""

REFUSED_AS: Final = {
    Reason.TOO_OLD: "too old",
    Reason.CHALLENGE_UNKNOWN: "echoing an unknown challenge",
    Reason.SEQUENCE: "out of sequence",
}
"""Refusals for which a stream of commands does not prevent the deadman stop, in words."""

_NS_PER_S: Final = 1_000_000_000


class Ages(msgspec.Struct, frozen=True):
    """Ages of accepted commands, in seconds; None if there were none. ``age_s`` includes the camera's delay."""

    age_s: float | None = None
    last_s: float | None = None
    p50_s: float | None = None
    p99_s: float | None = None


class LinkAge:
    """The link of one lease holder, measured by its commands."""

    def __init__(self, settings: CommandSettings) -> None:
        self._travel_delay_m = settings.travel_delay_m
        self._view_delay_ns = round(settings.view_delay_s * _NS_PER_S)
        self._configured_s = settings.deadman_s
        self.deadman_ns = round(settings.deadman_s * _NS_PER_S)
        self.accepted_seq: int | None = None
        self._ages: deque[tuple[int, int]] = deque(maxlen=KEPT)
        self._recent: deque[tuple[int, int]] = deque()
        self._recent_sum_ns = 0
        self._rank_due_ns = 0
        self._quantiles_s: tuple[float | None, float | None] = (None, None)
        self._refused: dict[Reason, tuple[int, int | None]] = {}

    def begin(self, deadman_s: float | None) -> None:
        """Begin an engagement, with a longer deadman than the configured one if requested."""
        wanted_s = min(max(deadman_s or 0.0, self._configured_s), DEADMAN_MAX_S)
        self.deadman_ns = round(wanted_s * _NS_PER_S)
        self._refused.clear()

    def accept(self, seq: int, age_ns: int, now_ns: int) -> None:
        self.accepted_seq = seq
        self._ages.append((now_ns, age_ns))
        self._recent.append((now_ns, age_ns))
        self._recent_sum_ns += age_ns
        self._refused.clear()

    def refuse(self, reason: Reason, age_ns: int | None) -> None:
        """Note a refused drive command; only refusals caused by the link count."""
        if reason in REFUSED_AS:
            count, _ = self._refused.get(reason, (0, None))
            self._refused[reason] = count + 1, age_ns

    def silence(self, silent_ns: int) -> str:
        """Describe the time since the last accepted command, with the refused commands and their age."""
        words = [f"none for {silent_ns / 1e6:.0f} ms"]
        for reason, (count, age_ns) in self._refused.items():
            commands = "1 command" if count == 1 else f"{count} commands"
            age = "" if age_ns is None else f", {age_ns / 1e6:.0f} ms"
            words.append(f"{commands} refused as {REFUSED_AS[reason]}{age}")
        return "; ".join(words)

    def ages(self, now_ns: int) -> Ages:
        """Return the ages of the recently accepted commands."""
        if not self._ages or now_ns - self._ages[-1][0] > QUANTILES_NS:
            return Ages()
        age_ns = self._age_ns(now_ns)
        if now_ns >= self._rank_due_ns:
            self._rank_due_ns = now_ns + RANK_NS
            self._quantiles_s = self._rank(now_ns)
        p50_s, p99_s = self._quantiles_s
        return Ages(None if age_ns is None else age_ns / 1e9, self._ages[-1][1] / 1e9, p50_s, p99_s)

    def _rank(self, now_ns: int) -> tuple[float | None, float | None]:
        ages_ns = sorted(age_ns for at_ns, age_ns in self._ages if now_ns - at_ns <= QUANTILES_NS)
        if not ages_ns:
            return None, None
        return ages_ns[(len(ages_ns) - 1) // 2] / 1e9, ages_ns[(len(ages_ns) - 1) * 99 // 100] / 1e9

    def speed_limit_mps(self, now_ns: int) -> float | None:
        """Return the highest speed that the travel delay allows; None if the age is unknown."""
        delay_s = self.delay_s(now_ns)
        return None if delay_s is None else self._travel_delay_m / delay_s

    def delay_s(self, now_ns: int) -> float | None:
        """Return the time from what the operator saw to the stop after a cut link; None if unknown."""
        age_ns = self._age_ns(now_ns)
        return None if age_ns is None else (age_ns + self.deadman_ns) / 1e9

    def bounded(self, target: Target, fastest_mps: float, now_ns: int) -> Target:
        """Return the target, slowed down to what the travel delay allows unless another limit is lower."""
        limit_mps = self.speed_limit_mps(now_ns)
        if limit_mps is None or min(abs(target.speed_mps), fastest_mps) <= limit_mps:
            return target
        return Target(copysign(limit_mps, target.speed_mps), target.angle_deg)

    def _age_ns(self, now_ns: int) -> int | None:
        """The age of what the operator sees; None if no command was accepted in the last second."""
        recent = self._recent
        while recent and now_ns - recent[0][0] > MEAN_NS:
            self._recent_sum_ns -= recent.popleft()[1]
        if not recent:
            return None
        largest_ns = 0
        for at_ns, age_ns in reversed(recent):
            if now_ns - at_ns > LARGEST_NS:
                break
            largest_ns = max(largest_ns, age_ns)
        return max(self._recent_sum_ns // len(recent), largest_ns) + self._view_delay_ns


FIRST_SEQUENCE = -1
"""Below every sequence of a drive command."""


class OperatorLink:
    """The drive commands of the lease's holder.

    Attributes:
        last_sequence: of the last fresh drive command of this lease.
        fresh_ns: arrival of the last executed drive command, or time of engagement, monotonic.
    """

    def __init__(self, settings: CommandSettings) -> None:
        self._settings = settings
        self.challenges = ChallengeLog()
        self.fresh_ns = 0
        self.begin_lease()

    def begin_lease(self) -> None:
        self.age = self.unused_age()
        self.last_sequence = FIRST_SEQUENCE
        self._last_drive: tuple[float, int] | None = None

    def unused_age(self) -> LinkAge:
        return LinkAge(self._settings)

    def note_drive(self, sequence: int, speed_mps: float, now_ns: int) -> None:
        """Note a fresh drive command, whether the robot executes it or not."""
        self.last_sequence = sequence
        self._last_drive = (speed_mps, now_ns)

    def wants_motion(self, now_ns: int) -> bool:
        """A recent drive command has a speed."""
        if self._last_drive is None:
            return False
        speed_mps, at_ns = self._last_drive
        return speed_mps != 0 and now_ns - at_ns <= self.age.deadman_ns
