"""Which robots a recorder records where several share a fleet. Pure.

It follows from a robot's name alone, so recorders need not know of each other.
"""

from __future__ import annotations

import re
from hashlib import sha256
from typing import Final, NamedTuple

from schemas.command_line import CommandError, ExitCode

SHARD_PATTERN: Final = r"([1-9][0-9]{0,2})/([1-9][0-9]{0,2})"


class Shard(NamedTuple):
    """One of several recorders: ``number`` counts from 1 to ``total``."""

    number: int
    total: int

    def has(self, robot: str) -> bool:
        """True if the robot is this recorder's: the SHA-256 of its name, as a number, modulo the total."""
        return int.from_bytes(sha256(robot.encode()).digest()) % self.total == self.number - 1


def shard_of(text: str) -> Shard:
    """Read ``NUMBER/COUNT``.

    Raises:
        CommandError: it is not of the form, or there is no such number.
    """
    match = re.fullmatch(SHARD_PATTERN, text)
    if match is None or int(match[1]) > int(match[2]):
        raise CommandError(f"the shard is {text!r}, and should be such as 2/4: the second of four", ExitCode.USAGE)
    return Shard(int(match[1]), int(match[2]))
