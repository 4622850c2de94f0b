"""The greatest age of a drive command, without clocks in common.

Each published state of the arbiter carries a challenge: random bytes that nobody can know before. A command
carries the newest challenge that its sender had seen, so it was made after that was published: its age is at most
the time since then. Only this can distinguish a stalled link, a replay, a sender whose clock is a year off, and a
command that was made today for tomorrow.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from schemas.reasons import Reason

REMEMBERED_NS: Final = 4_000_000_000
"""Challenges published longer ago are forgotten; a command that echoes one is too old for any setting."""


class ChallengeLog:
    """The time at which each challenge was published."""

    def __init__(self) -> None:
        self._published: deque[tuple[bytes, int]] = deque()
        self._times_ns: dict[bytes, int] = {}

    @property
    def published(self) -> list[tuple[bytes, int]]:
        """Those that are remembered, each with its time."""
        return list(self._published)

    def restore(self, published: list[tuple[bytes, int]]) -> None:
        """Remember these, and no others."""
        self._published = deque(published)
        self._times_ns = dict(self._published)

    def publish(self, challenge: bytes, now_ns: int) -> None:
        """Note that this challenge is published now."""
        self._published.append((challenge, now_ns))
        self._times_ns[challenge] = now_ns
        while now_ns - self._published[0][1] > REMEMBERED_NS:
            self._times_ns.pop(self._published.popleft()[0], None)

    def age_ns(self, challenge: bytes, now_ns: int) -> int | Reason:
        """Return the greatest age of a command that echoes this challenge, or why it is not known."""
        published_ns = self._times_ns.get(challenge)
        return Reason.CHALLENGE_UNKNOWN if published_ns is None else now_ns - published_ns
