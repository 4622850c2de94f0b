"""The journal's entries, which are the inputs of the gateway's core, and the rules by which they were written.

The same inputs give the same decisions under the same rules alone. A journal names the rules under which it was
made, so that whoever runs it again under others knows that differences are to be expected.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Kind(IntEnum):
    """The kind of an input of the core: the method that received it."""

    FRAME = 0  # [can_id, data, wall_ns, fd_flags, remote_length]
    REQUEST = 1
    """handle, verb, operator, payload, size, fault; in journals of before without the fault. The payload names the
    lease by its identifier: see ``gateway.command.restart``. In signed mode the payload is as it was
    received, and attachment and credentials follow: see ``gateway.command.rulings``."""
    LINKS = 2  # those that ``gateway.journal.LINKS`` names, in its order; only when one of them has changed
    TICK = 3  # wall_ns, late_ns, challenge; under rules 1 without the challenge
    SENT = 4  # count, wall_ns
    SHUT_DOWN = 5
    REST = 6
    """[what the arbiter is remembered by], controller, and the links as in LINKS: nothing is given to the core.
    The gateway is at rest, and from here on a run can be run again: see ``gateway.command.restart``."""
    GUARD_STOP = 7  # words: the guard stopped the robot before this start, and nobody has reset that
    WARNING = 8  # words: what was found at the start and a person should know
    END_LEASE = 9  # reason, words: the grant of who holds the lease does not hold any more
    BARS = 10  # {reason: words}: why nobody may engage the robot, whoever asks; empty again when that is over
    CARRIED = 11
    """[latched causes with their details, why the last stop began, its figures, whether a stop is owed, lamps,
    horn]: the gateway has started again by itself, with renewed files: see ``gateway.command.restart``"""
    CHECKPOINT = 12
    """wall_ns, state: nothing is given to the core. All of its state, as MessagePack, once a minute whatever the
    robot does, so that from here on a version of the same state can run it again: see ``gateway.journal``"""
    CRASHED = 13  # the gateway before this one did not end in order


COMMAND_RULES: Final = 7
"""The rules of this version. A change that decides something otherwise raises it: see CHANGELOG.md."""


def rules_notice(rules: int) -> str:
    """Return a warning for a journal that was made under other rules; empty if the rules are those of today."""
    if rules == COMMAND_RULES:
        return ""
    # Under rules 1 journals had no number.
    return (
        f"made under rules {max(rules, 1)}, today's are {COMMAND_RULES}: differences are expected (CHANGELOG.md)"
    )
