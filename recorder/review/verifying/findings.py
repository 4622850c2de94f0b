"""Faults in the proofs of a log."""

from __future__ import annotations

from enum import Enum

import msgspec


class ProofFault(Enum):
    """The kind of a fault. ``unproven``: the log lacks the evidence; all others are certain."""

    MISSING = "missing"
    CHANGED = "changed"
    WRONGLY_SIGNED = "wrongly_signed"
    NOT_GRANTED = "not_granted"
    UNPROVEN = "unproven"


class ProofFinding(msgspec.Struct, frozen=True):
    """A finding.

    Attributes:
        what: in words.
        time_ns: the robot's time of the first, nanoseconds since 1970; None if it is of no time.
        count: samples, or requests.
    """

    fault: ProofFault
    what: str
    time_ns: int | None = None
    count: int = 1
