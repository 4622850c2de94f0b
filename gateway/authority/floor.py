"""The time, as far as it is proven: a robot has no clock that it can trust.

The floor is the newest time that the authority named in a statement that was verified. It is kept across restarts.
From there the time since start-up is counted. A wall clock that is set back revives nothing; one that is set
forward only ends what would end later. The floor falls only where a new authority takes the place of the former.
"""

from __future__ import annotations

from typing import Final

_S: Final = 1_000_000_000


class TimeFloor:
    """A lower bound of the time."""

    def __init__(self, floor_s: int, boot_ns: int) -> None:
        """The floor as it was kept.

        Args:
            floor_s: seconds since 1970.
            boot_ns: time since the machine's start, sleep included (CLOCK_BOOTTIME).
        """
        self.restart(floor_s, boot_ns)

    def least_s(self, boot_ns: int) -> int:
        """The earliest that it can be, seconds since 1970."""
        return self._floor_s + max(0, boot_ns - self._since_ns) // _S

    def now_s(self, boot_ns: int, wall_s: int) -> int:
        """The time by which grants are judged: the later of the floor and the wall clock."""
        return max(self.least_s(boot_ns), wall_s)

    def restart(self, at_s: int, boot_ns: int) -> None:
        """A new authority says what time it is: a thief of the former one's key may have said anything."""
        self._floor_s, self._since_ns = at_s, boot_ns

    def lift(self, at_s: int, boot_ns: int) -> None:
        """A statement that was verified says that it is so late at least: seconds since 1970."""
        if at_s > self.least_s(boot_ns):
            self.restart(at_s, boot_ns)
