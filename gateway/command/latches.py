"""Causes that keep the robot from being engaged until somebody resets them. Pure."""

from __future__ import annotations

from schemas.reasons import Reason


class Latches:
    """Latched causes.

    Attributes:
        details: the latched causes, oldest first, each with its detail.
        newest_ns: when the newest of it was latched, monotonic.
    """

    def __init__(self) -> None:
        self.details: dict[Reason, str] = {}
        self.newest_ns = 0

    def add(self, reason: Reason, detail: str, now_ns: int, *, is_new_hit: bool) -> bool:
        """Latch a cause. Returns whether it was not latched before.

        Args:
            reason: the cause.
            detail: its figures; those of the first time are kept.
            now_ns: monotonic.
            is_new_hit: each one counts: a reset that was on its way is not meant for the newest.
        """
        is_new = reason not in self.details
        if is_new:
            self.details[reason] = detail
        if is_new or is_new_hit:
            self.newest_ns = now_ns
        return is_new

    @property
    def newest(self) -> Reason:
        """The cause that was latched last.

        Raises:
            IndexError: nothing is latched.
        """
        return [*self.details][-1]
