"""The hash chains over what a robot records of itself: journal, decisions, events.

Each second the robot signs the heads of its chains. Who holds the samples between two heads can see that none is
missing and none was changed; who holds the newest head, that nothing was cut off before it. A chain is of one
subject, whose samples are numbered: the sample of sequence n is the chain's link n. The heads of a run name those
that the robot signed last in the run before: so no run can be left out between two.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Final, Self

import msgspec

from schemas.authority.proof import ProofKind, signed_bytes

HEAD_PERIOD_NS: Final = 1_000_000_000
"""Heads are published once a second."""

CHAINED: Final = ("journal", "safety/decision", "safety/event")
"""Subjects that have a chain."""

FORMER_BYTES: Final = 48
"""The length of what names the heads of the run before."""


def first_link(boot: bytes, subject: str) -> bytes:
    """The head of a chain without a sample, 32 bytes: it belongs to one run of one subject."""
    return hashlib.sha256(signed_bytes(ProofKind.HEAD, boot, subject.encode())).digest()


def next_link(head: bytes, payload: bytes) -> bytes:
    """The head after one more sample: SHA-256 over the head before and the sample's MessagePack bytes."""
    return hashlib.sha256(head + payload).digest()


class FormerHeads(msgspec.Struct, frozen=True):
    """The last heads of a run that its robot kept, as those of the next run name them.

    Attributes:
        boot: of that run.
        sequence: of those heads.
        digest: SHA-256 of the text under their signature.
    """

    boot: bytes
    sequence: int
    digest: bytes

    @classmethod
    def of(cls, boot: bytes, sequence: int, text: bytes) -> Self:
        """Name heads by the text under their signature."""
        return cls(boot, sequence, hashlib.sha256(text).digest())

    @classmethod
    def read(cls, said: bytes) -> Self | None:
        """Read the 48 bytes in which heads name others; None if they name none."""
        if len(said) != FORMER_BYTES:
            return None
        return cls(said[:8], int.from_bytes(said[8:16], "big"), said[16:])

    def text(self) -> bytes:
        """The 48 bytes: the run, the sequence, the digest."""
        return self.boot + self.sequence.to_bytes(8, "big") + self.digest


def heads_text(
    boot: bytes, time_ns: int, sequence: int, heads: Mapping[str, tuple[int, bytes]], former: bytes = b""
) -> bytes:
    """The text under the signature of published heads.

    Args:
        boot: of the gateway's run.
        time_ns: since 1970, by the robot's clock.
        sequence: of these heads, so that none can be left out and the others numbered anew.
        heads: by subject, how many samples the chain holds and its head.
        former: the heads of the run before, as ``FormerHeads.text`` names them; empty if they are not known.
    """
    parts = (part for subject, (count, head) in sorted(heads.items()) for part in _parts(subject, count, head))
    # One part, where a subject has three: neither can be read as the other.
    linked = (former,) if former else ()
    numbers = time_ns.to_bytes(8, "big"), sequence.to_bytes(8, "big")
    return signed_bytes(ProofKind.HEAD, boot, *numbers, *linked, *parts)


def _parts(subject: str, count: int, head: bytes) -> tuple[bytes, bytes, bytes]:
    return subject.encode(), count.to_bytes(8, "big"), head
