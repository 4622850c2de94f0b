"""The link to the holder of the lease: the order, the age and the content of its drive commands. Pure."""

from __future__ import annotations

from gateway.command.freshness import ChallengeLog
from gateway.command.link_age import LinkAge
from schemas.settings import CommandSettings

FIRST_SEQUENCE = -1
"""Below the sequence of every drive command."""


class OperatorLink:
    """The drive commands of the lease's holder.

    Attributes:
        challenges: when each challenge was published.
        age: the age of the holder's commands, the deadman, and the speed that they allow.
        last_sequence: of the last fresh drive command under the lease in force.
        fresh_ns: arrival of the last drive command that the engaged robot executes, or its engagement, monotonic.
    """

    def __init__(self, settings: CommandSettings) -> None:
        self._settings = settings
        self.challenges = ChallengeLog()
        self.fresh_ns = 0
        self.begin_lease()

    def begin_lease(self) -> None:
        """Forget the commands of the holder before."""
        self.age = self.unused_age()
        self.last_sequence = FIRST_SEQUENCE
        self._last_drive: tuple[float, int] | None = None

    def unused_age(self) -> LinkAge:
        """The age of a link that carried no command."""
        return LinkAge(self._settings)

    def note_drive(self, sequence: int, speed_mps: float, now_ns: int) -> None:
        """Note a fresh drive command of the holder, whether the robot executes it or not."""
        self.last_sequence = sequence
        self._last_drive = (speed_mps, now_ns)

    def wants_motion(self, now_ns: int) -> bool:
        """A drive command that came lately is not zero."""
        if self._last_drive is None:
            return False
        speed_mps, at_ns = self._last_drive
        return speed_mps != 0 and now_ns - at_ns <= self.age.deadman_ns
