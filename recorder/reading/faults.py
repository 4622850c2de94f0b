"""Faults of logs: all are counted, the first ones are listed."""

from __future__ import annotations

from typing import Final

FAULTS_SHOWN: Final = 20
"""Faults that are listed one by one; the rest are only counted."""


KNOWN_MAX: Final = 10_000
"""So many are known again: a question may read a log more than once."""


class Faults:
    """Gathers faults, each once.

    Attributes:
        told: the first ones, in lines for people.
        count: all of them.
    """

    def __init__(self) -> None:
        self.told: list[str] = []
        self.count = 0
        self._known: dict[str, None] = {}

    def add(self, detail: str) -> None:
        """One more, unless it is known."""
        if detail in self._known:
            return
        if len(self._known) < KNOWN_MAX:
            self._known[detail] = None
        self.count += 1
        if len(self.told) < FAULTS_SHOWN:
            self.told.append(detail)

    def add_all(self, others: Faults) -> None:
        """Those that somebody else found, in the same logs."""
        for detail in others._known:
            self.add(detail)

    def __bool__(self) -> bool:
        """Report whether there are any."""
        return self.count > 0
