"""The journal's entries, which are the inputs of the gateway's core, and the version of the rules.

The same inputs give the same decisions only under the same rules. A journal names its rules, so that a rerun under
others can announce differences.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Kind(IntEnum):
    """The kind of an input of the core: the method that received it."""

    FRAME = 0  # [can_id, data, wall_ns, fd_flags, remote_length]
    REQUEST = 1
    """handle, verb, operator, payload, size, fault; in earlier journals without the fault. The payload names the
    lease by its identifier: see ``gateway.command.restart``. In signed mode the payload is as received, and
    attachment and credentials follow: see ``gateway.command.rulings``."""
    LINKS = 2  # values in the order of ``gateway.journal.LINKS``, when one of them has changed
    TICK = 3  # wall_ns, late_ns, challenge; under rules 1 without the challenge
    SENT = 4  # count, wall_ns
    SHUT_DOWN = 5
    REST = 6
    """[the arbiter's state at rest], controller, and the links as in LINKS; not an input of the core. The gateway
    is at rest, and a rerun can begin here: see ``gateway.command.restart``."""
    GUARD_STOP = 7  # text: the guard stopped the robot before this start, and it was not reset
    WARNING = 8  # text: a finding at the start for people
    END_LEASE = 9  # reason, text: the grant of the lease's holder is no longer valid
    BARS = 10  # {reason: text}: why the robot cannot be engaged; empty when that ends
    CARRIED = 11
    """[latched causes with their details, the last stop's reason, its figures, whether a stop is owed, lamps,
    horn]: the gateway restarted itself with renewed files: see ``gateway.command.restart``"""
    CHECKPOINT = 12
    """wall_ns, state; not an input of the core. Its whole state, as MessagePack, once a minute, so that a rerun by
    a version with the same state can begin here: see ``gateway.journal``"""
    CRASHED = 13  # the gateway before this one crashed


COMMAND_RULES: Final = 7  # raised by each change of a decision: see CHANGELOG.md


def rules_notice(rules: int) -> str:
    """Return a warning for a journal that was made under other rules; else empty."""
    if rules == COMMAND_RULES:
        return ""
    # Under rules 1 journals had no number.
    return (
        f"made under rules {max(rules, 1)}, today's are {COMMAND_RULES}: differences are expected (CHANGELOG.md)"
    )
