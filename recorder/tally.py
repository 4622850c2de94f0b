"""What has come in on one key, and what has not. Pure."""

from __future__ import annotations

from typing import Final

SEQUENCE_SPAN: Final = 2**32
"""Sequences wrap here."""

RESTART_STEP: Final = SEQUENCE_SPAN // 2
"""A step forward of this much is a step back: the sender began anew, or a sample was late."""


class Tally:
    """What has come in on one key.

    Attributes:
        messages: records written.
        missed: samples that never came, by the gaps in ``sequence``.
        dropped: raw frames that the source itself had to drop, by its own count.
    """

    def __init__(self) -> None:
        self.messages = 0
        self.missed = 0
        self.dropped = 0
        self._next: int | None = None

    def count_sequence(self, sequence: int) -> bool:
        """Take note of a sample's sequence. False if it steps back: the source has begun anew."""
        expected, self._next = self._next, (sequence + 1) % SEQUENCE_SPAN
        if expected is None or sequence == expected:
            return True
        step = (sequence - expected) % SEQUENCE_SPAN
        if step >= RESTART_STEP:
            return False
        self.missed += step
        return True
