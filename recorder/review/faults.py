"""What is wrong with logs: counted, and the first ones told."""

from __future__ import annotations

from typing import Final

FAULTS_SHOWN: Final = 20
"""Faults that are told one by one; the rest are only counted."""


class Faults:
    """Gathers faults.

    Attributes:
        told: the first ones, in lines for people.
        count: all of them.
    """

    def __init__(self) -> None:
        self.told: list[str] = []
        self.count = 0

    def add(self, detail: str) -> None:
        """One more."""
        self.count += 1
        if len(self.told) < FAULTS_SHOWN:
            self.told.append(detail)

    def __bool__(self) -> bool:
        """Whether there are any."""
        return self.count > 0
