"""Counters of one key: samples received, missed and lost. Pure."""

from __future__ import annotations

from typing import Final

from schemas.recording import GapReason

SEQUENCE_SPAN: Final = 2**32
"""Sequences wrap here."""

UNREAD: Final = frozenset({GapReason.QUEUE, GapReason.SIZE})
"""Reasons for the loss of samples that were never decoded: their sequence is not known."""

SOURCES_MAX: Final = 16
"""Sources of one key that are followed; of more, those that were silent longest begin anew."""

RESTART_STEP: Final = 2**24
"""A step forward of this much (two days at 100 Hz) is none: the sender began anew, or a sample was late."""


class KeyCounters:
    """Counts the samples of one key.

    Attributes:
        samples: samples decoded, or kept as they are.
        messages: messages made of them.
        unwritten: messages of those that are in no log, for whatever reason.
        missed: samples that never came, by the gaps in ``sequence``, without those that were dropped unread.
        dropped: raw frames that the source itself had to drop, by its own count.
        lost: messages that reached the recorder and are not in the log, by reason.
        lost_bus: frames of the chassis that never reached its gateway, by its own count; None if it reports none.
    """

    def __init__(self) -> None:
        self.samples = 0
        self.messages = 0
        self.unwritten = 0
        self.missed = 0
        self.dropped = 0
        self.lost: dict[GapReason, int] = {}
        self.lost_bus: int | None = None
        self._bus_count: int | None = None
        # By source, the one that was heard last at the end.
        self._sources: dict[str, int | None] = {}
        self.next: int | None = None
        """The sequence that the next sample should have; None before the first."""
        self._unread = 0
        """Samples dropped unread while ``next`` was ``_unread_at``."""
        self._unread_at: int | None = None

    @property
    def unread(self) -> int:
        """Samples that were dropped before they were decoded."""
        return sum(count for reason, count in self.lost.items() if reason in UNREAD)

    def lose(self, reason: GapReason, count: int) -> None:
        """So many samples or messages reached the recorder and are not in the log."""
        self.lost[reason] = self.lost.get(reason, 0) + count
        if reason in UNREAD:
            self._unread = count + (self._unread if self._unread_at == self.next else 0)
            self._unread_at = self.next

    def find(self) -> None:
        """One that was missed has come after all."""
        self.missed = max(0, self.missed - 1)

    def count_bus(self, lost: int) -> None:
        """The gateway's count of frames lost on the bus since it started; the first one is where we begin."""
        before, self._bus_count = self._bus_count, lost
        # A count that falls is a gateway's that began anew.
        new = 0 if before is None else lost - before if lost >= before else lost
        self.lost_bus = (self.lost_bus or 0) + new

    def count_source(self, source: str, sequence: int) -> None:
        """Take note of a sample by the sequence that Zenoh gives it: each source of a key has its own."""
        self.next = self._sources.pop(source, None)
        self.count_sequence(sequence % SEQUENCE_SPAN)
        self._sources[source] = self.next
        if len(self._sources) > SOURCES_MAX:
            del self._sources[next(iter(self._sources))]

    def count_sequence(self, sequence: int) -> bool:
        """Take note of a sample's sequence. False if it steps back: the source has begun anew."""
        expected, self.next = self.next, (sequence + 1) % SEQUENCE_SPAN
        if expected is None or sequence == expected:
            return True
        step = (sequence - expected) % SEQUENCE_SPAN
        if step >= RESTART_STEP:
            return False
        # What was dropped unread since the sample before this one left a gap, too.
        self.missed += max(0, step - self._unread) if self._unread_at == expected else step
        return True
