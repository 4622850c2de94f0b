"""A table of bad links. Pure.

Zenoh runs over TCP: a lost message is sent again, and all later ones wait for it. The other end sees no loss, but
a stall of about a round trip in that direction; what is sent again may be lost again.
"""

from __future__ import annotations

from random import Random

import msgspec


class LinkProfile(msgspec.Struct, frozen=True):
    """A kind of link.

    Attributes:
        one_way_s: mean delay in either direction.
        jitter: share by which the delay varies to either side.
        loss: share of messages that is lost at first.
        stall_every_s, stall_s: mean time between stalls of both directions, and their length; 0 is never.
        deadman_s: the deadman that an engage requests on such a link; None is the configured one.
    """

    name: str
    one_way_s: float
    jitter: float = 0.0
    loss: float = 0.0
    stall_every_s: float = 0.0
    stall_s: float = 0.0
    deadman_s: float | None = None

    def delay_s(self, random: Random) -> float:
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

# The link of the goal: at 0.5 m/s a robot hardly ever stops.
FAR = LinkProfile("200 ms", 0.2, jitter=0.3, loss=0.01, deadman_s=1.0)
