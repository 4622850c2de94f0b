"""Which robots a recorder records where several share a fleet. Pure.

Rendezvous hashing (Thaler and Ravishankar, 1998): each robot has an order of preference among the shards, made of
its name alone, and is recorded by the first of them that is there. When a shard goes, its own robots move, and no
others.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from hashlib import blake2b
from typing import Final, NamedTuple

from schemas.exit_codes import CommandError, ExitCode

SILENT_NS: Final = 2_000_000_000
"""A shard that was seen is there for so long after it went: links flap."""

START_NS: Final = 10_000_000_000
"""One that was not seen yet is waited for so long: computers do not start all at once."""

OVERLAP_NS: Final = 5_000_000_000
"""A robot that another shard takes over is recorded for so long by both: a message twice is better than none."""

ROBOTS_MAX: Final = 20_000
"""Robots that are known by name at most: anybody may declare a token."""

SHARD_PATTERN: Final = r"([1-9][0-9]{0,2})/([1-9][0-9]{0,2})"


class Shard(NamedTuple):
    """One of several recorders: ``number`` counts from 1 to ``total``."""

    number: int
    total: int

    @property
    def chunk(self) -> str:
        """It as a chunk of a key."""
        return f"{self.number}-of-{self.total}"


def shard_of(text: str) -> Shard:
    """Read ``NUMBER/COUNT``.

    Raises:
        CommandError: it is not of the form, or there is no such number.
    """
    match = re.fullmatch(SHARD_PATTERN, text)
    if match is None or int(match[1]) > int(match[2]):
        raise CommandError(f"the shard is {text!r}, and should be such as 2/4: the second of four", ExitCode.USAGE)
    return Shard(int(match[1]), int(match[2]))


@lru_cache(ROBOTS_MAX)
def preference(robot: str, count: int) -> tuple[int, ...]:
    """Return the shards in the order in which a robot belongs to them.

    The one with the greatest BLAKE2b digest of 8 bytes of ``NUMBER/ROBOT`` comes first.
    """

    def weight(number: int) -> bytes:
        return blake2b(f"{number}/{robot}".encode(), digest_size=8).digest()

    return tuple(sorted(range(1, count + 1), key=weight, reverse=True))


class Shards:
    """The shards of a fleet as one of them sees the others, and the robots that are its own.

    Args:
        own: this recorder's.
        now_ns: monotonic.
    """

    def __init__(self, own: Shard, now_ns: int) -> None:
        self.own = own
        self._there: dict[int, set[str]] = {number: set() for number in range(1, own.total + 1)}
        self._there_to_ns = dict.fromkeys(self._there, now_ns + START_NS)
        self._robots: set[str] = set()
        self._unjudged: set[str] = set()
        """Robots that were met since it was last judged whose they are."""
        self._judged_by: frozenset[int] = frozenset()
        """The shards that were there then."""
        self._recorded: dict[str, int | None] = {}
        """The robots that are recorded here; since when another shard is to do it, or None."""

    def see(self, number: int, recorder: str, *, is_there: bool, now_ns: int) -> None:
        """Note that a recorder of a shard has come, or has gone."""
        names = self._there.get(number)
        if names is None:
            return
        (names.add if is_there else names.discard)(recorder)
        self._there_to_ns[number] = now_ns + SILENT_NS

    def meet(self, robot: str) -> None:
        """Note a robot that is connected, or was."""
        if robot not in self._robots and len(self._robots) < ROBOTS_MAX:
            self._robots.add(robot)
            self._unjudged.add(robot)

    def wait(self, now_ns: int) -> None:
        """Judge nobody: this recorder itself is cut off, and sees no shard."""
        self._there_to_ns = {number: max(to_ns, now_ns + SILENT_NS) for number, to_ns in self._there_to_ns.items()}

    def namesakes(self) -> list[str]:
        """The recorders of this recorder's own shard, itself included."""
        return sorted(self._there[self.own.number])

    def there(self, now_ns: int) -> list[int]:
        """The shards that are there, or were until a moment ago."""
        return [
            number
            for number, names in self._there.items()
            if number == self.own.number or names or now_ns < self._there_to_ns[number]
        ]

    def recorded(self, now_ns: int) -> frozenset[str]:
        """The robots that are to be recorded here now."""
        there = frozenset(self.there(now_ns))
        # Whose a robot is follows from its name and from who is there: mostly a few are to be looked at.
        judged = self._unjudged if there == self._judged_by else self._robots
        self._unjudged, self._judged_by = set(), there
        for robot in judged:
            owner = next(number for number in preference(robot, self.own.total) if number in there)
            if owner == self.own.number:
                self._recorded[robot] = None
            elif robot in self._recorded and self._recorded[robot] is None:
                self._recorded[robot] = now_ns
        for robot in [*self._over(now_ns)]:
            del self._recorded[robot]
        return frozenset(self._recorded)

    def _over(self, now_ns: int) -> Iterator[str]:
        for robot, since_ns in self._recorded.items():
            if since_ns is not None and now_ns - since_ns >= OVERLAP_NS:
                yield robot
