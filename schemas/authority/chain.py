"""The hash chains over what a robot records of itself: journal, decisions, events.

Each second the robot signs the heads of its chains. Who holds the samples between two heads can see that none is
missing and none was changed; who holds the newest head, that nothing was cut off before it. A chain is of one
subject, whose samples are numbered: the sample of sequence n is the chain's link n.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Final

from schemas.authority.proof import ProofKind, signed_bytes

HEAD_PERIOD_NS: Final = 1_000_000_000
"""Heads are published once a second."""

CHAINED: Final = ("journal", "safety/decision", "safety/event")
"""Subjects that have a chain."""


def first_link(boot: bytes, subject: str) -> bytes:
    """The head of a chain without a sample, 32 bytes: it belongs to one run of one subject."""
    return hashlib.sha256(signed_bytes(ProofKind.HEAD, boot, subject.encode())).digest()


def next_link(head: bytes, payload: bytes) -> bytes:
    """The head after one more sample: SHA-256 over the head before and the sample's MessagePack bytes."""
    return hashlib.sha256(head + payload).digest()


def heads_text(boot: bytes, time_ns: int, heads: Mapping[str, tuple[int, bytes]]) -> bytes:
    """The text under the signature of published heads.

    Args:
        boot: of the gateway's run.
        time_ns: since 1970, by the robot's clock.
        heads: by subject, how many samples the chain holds and its head.
    """
    parts = (part for subject, (count, head) in sorted(heads.items()) for part in _parts(subject, count, head))
    return signed_bytes(ProofKind.HEAD, boot, time_ns.to_bytes(8, "big"), *parts)


def _parts(subject: str, count: int, head: bytes) -> tuple[bytes, bytes, bytes]:
    return subject.encode(), count.to_bytes(8, "big"), head
