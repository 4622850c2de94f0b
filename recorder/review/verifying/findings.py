"""Faults in the proofs of a log."""

from __future__ import annotations

from enum import Enum

import msgspec


class ProofFault(Enum):
    """The kind of a fault.

    ``unproven``: the log lacks the evidence. ``other_authority``: all that is signed goes back to an authority
    that was not given. Neither says that anything was tampered with; all others do.
    """

    MISSING = "missing"
    CHANGED = "changed"
    WRONGLY_SIGNED = "wrongly_signed"
    NOT_GRANTED = "not_granted"
    UNPROVEN = "unproven"
    OTHER_AUTHORITY = "other_authority"

    @property
    def is_tampering(self) -> bool:
        """Return True if it is certain that the log is not what the robot signed, or was not granted."""
        return self not in {ProofFault.UNPROVEN, ProofFault.OTHER_AUTHORITY}


class ProofFinding(msgspec.Struct, frozen=True):
    """A finding.

    Attributes:
        what: in words.
        time_ns: the robot's time of the first, nanoseconds since 1970; None if it is of no time.
        count: samples, or requests.
        until_ns: the robot's time of the last; None if there is but one time.
    """

    fault: ProofFault
    what: str
    time_ns: int | None = None
    count: int = 1
    until_ns: int | None = None
