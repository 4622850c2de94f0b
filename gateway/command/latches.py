"""Causes that keep the robot from being engaged until somebody resets them. Pure."""

from __future__ import annotations

from typing import Final

from schemas.reasons import Reason

NAMED: Final = 4
"""Names of those who stopped a robot that are kept at most."""

OTHERS: Final = "others"
"""In place of the names beyond those."""

_BY: Final = "by "
_AND: Final = ", "


class Latches:
    """Latched causes.

    Attributes:
        details: the latched causes, oldest first, each with its detail. That of a remote stop is who sent one,
            the newest first.
        newest_ns: when the newest of it was latched, monotonic.
    """

    def __init__(self) -> None:
        self.details: dict[Reason, str] = {}
        self.newest_ns = 0

    def add(self, reason: Reason, detail: str, now_ns: int, *, is_new_hit: bool) -> bool:
        """Latch a cause. Returns whether it was not latched before.

        Args:
            reason: the cause.
            detail: its figures; those of the first time are kept, and of a remote stop the names of all times.
            now_ns: monotonic.
            is_new_hit: each one counts: a reset that was on its way is not meant for the newest.
        """
        is_new = reason not in self.details
        if is_new:
            self.details[reason] = detail
        elif reason is Reason.REMOTE_STOP:
            self._name(_names(detail) + [name for name in self.stopped_by if name not in _names(detail)])
        if is_new or is_new_hit:
            self.newest_ns = now_ns
        return is_new

    @property
    def stopped_by(self) -> list[str]:
        """The names of those whose remote stops are latched, the newest first; after four of them "others"."""
        return _names(self.details.get(Reason.REMOTE_STOP, ""))

    def withdraw(self, detail: str) -> bool:
        """Take this name from among those who stopped it, unless it is the only one; True if it was there."""
        left = [name for name in self.stopped_by if name not in _names(detail)]
        is_there = 0 < len(left) < len(self.stopped_by)
        if is_there:
            self._name(left)
        return is_there

    def _name(self, names: list[str]) -> None:
        kept = names if len(names) <= NAMED else [*names[:NAMED], OTHERS]
        self.details[Reason.REMOTE_STOP] = _BY + _AND.join(kept)

    @property
    def newest(self) -> Reason:
        """The cause that was latched last.

        Raises:
            IndexError: nothing is latched.
        """
        return [*self.details][-1]


def _names(detail: str) -> list[str]:
    return detail.removeprefix(_BY).split(_AND) if detail.startswith(_BY) else []
