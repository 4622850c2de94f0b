"""Links that are bad, as one table, and what becomes of messages on them, in simulated time. Pure.

Zenoh runs over TCP. There a message that is lost is sent again, and all that follows waits for it: whoever is at
the other end sees no loss, but a stall of about one round trip in that direction. What is sent again may be lost
again.
"""

from __future__ import annotations

from collections import deque
from random import Random
from typing import Any

import msgspec


class LinkProfile(msgspec.Struct, frozen=True):
    """A kind of link.

    Attributes:
        one_way_s: the mean delay of a message in either direction.
        jitter: the delay varies by this share of it, to either side.
        loss: the share of messages that is lost at first.
        stall_every_s: nothing comes through in either direction every so often, in the mean; 0 is never...
        stall_s: ...for this long.
        deadman_s: what such a link needs, as it is asked for at engage; None is the configured one.
    """

    name: str
    one_way_s: float
    jitter: float = 0.0
    loss: float = 0.0
    stall_every_s: float = 0.0
    stall_s: float = 0.0
    deadman_s: float | None = None

    @property
    def slug(self) -> str:
        """The name as a word of the command line."""
        return self.name.lower().replace(" ", "-")

    def delay_s(self, random: Random) -> float:
        """Draw how long a message takes one way, in seconds."""
        delay_s = self.one_way_s * (1 + self.jitter * random.uniform(-1, 1))
        while random.random() < self.loss:
            delay_s += 2 * self.one_way_s
        return delay_s


LINKS = (
    LinkProfile("LAN", 0.0005, jitter=0.3),
    LinkProfile("Wi-Fi", 0.005, jitter=0.9, loss=0.005, stall_every_s=20, stall_s=0.15),
    LinkProfile("LTE good", 0.03, jitter=0.3, loss=0.002, stall_every_s=60, stall_s=0.2),
    LinkProfile("LTE bad", 0.1, jitter=0.3, loss=0.01, stall_every_s=30, stall_s=0.4, deadman_s=0.8),
    LinkProfile("handover", 0.05, jitter=0.3, loss=0.002, stall_every_s=15, stall_s=0.8, deadman_s=1.0),
    LinkProfile("satellite", 0.3, jitter=0.1, loss=0.002, deadman_s=1.0),
)

FAR = LinkProfile("200 ms", 0.2, jitter=0.3, loss=0.01, deadman_s=1.0)
"""The link of the goal: over it a robot that is asked for 0.5 m/s hardly ever stops."""


class _Direction:
    """One way of a link: messages come out in their order."""

    def __init__(self) -> None:
        self.waiting: deque[tuple[int, Any]] = deque()
        self.last_ns = 0


class LossyLink:
    """Both ways of a link.

    Attributes:
        profile: what kind of link it is now; what is under way keeps its delay.
        is_cut: nothing arrives any more.
    """

    def __init__(self, profile: LinkProfile, seed: int) -> None:
        self.is_cut = False
        self.profile = profile
        self._random = Random(seed)  # noqa: S311 - the same link each time
        self._stall_ends_ns = 0
        self._stalls_ns = self._next_stall_ns(0)
        self._up, self._down = _Direction(), _Direction()

    def send_up(self, message: object, now_ns: int) -> None:
        """To the robot."""
        self._send(self._up, message, now_ns)

    def send_down(self, message: object, now_ns: int) -> None:
        """From the robot."""
        self._send(self._down, message, now_ns)

    def receive_up(self, now_ns: int) -> list[Any]:
        """What has reached the robot."""
        return self._receive(self._up, now_ns)

    def receive_down(self, now_ns: int) -> list[Any]:
        """What has reached the operator."""
        return self._receive(self._down, now_ns)

    def _send(self, direction: _Direction, message: object, now_ns: int) -> None:
        delay_s = self.profile.delay_s(self._random)
        direction.last_ns = max(direction.last_ns, now_ns + round(delay_s * 1e9))
        direction.waiting.append((direction.last_ns, message))

    def _receive(self, direction: _Direction, now_ns: int) -> list[Any]:
        if now_ns >= self._stalls_ns:
            self._stall_ends_ns = self._stalls_ns + round(self.profile.stall_s * 1e9)
            self._stalls_ns = self._next_stall_ns(self._stall_ends_ns)
        if self.is_cut or now_ns < self._stall_ends_ns:
            return []
        arrived = []
        while direction.waiting and direction.waiting[0][0] <= now_ns:
            arrived.append(direction.waiting.popleft()[1])
        return arrived

    def _next_stall_ns(self, from_ns: int) -> int:
        every_s = self.profile.stall_every_s
        return from_ns + round(self._random.expovariate(1 / every_s) * 1e9) if every_s else 2**63
