"""Joins the messages of a topic to runs without a gap, by their sequence, and counts what lies between. Pure.

Messages may come in any order: what was asked for later stands behind what came by itself, and the same may be in
several logs. So each message only lengthens a run of messages that follow each other, and the runs are put in the
order of their publish times at the end. Memory grows with the gaps, not with the log.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from operator import attrgetter
from typing import Final

from recorder.backfill.ranges import merged
from recorder.encoding.key_counters import RESTART_STEP, SEQUENCE_SPAN

OPEN_RUNS: Final = 4
"""Runs that may go on by turns: what comes by itself, and what was asked for."""

BATCH_NS: Final = 1_000_000_000
"""The frames of one batch are no further apart than this; the same sequence later is another gateway's."""

RUNS_MAX: Final = 4096
"""Beyond this many they are put in order meanwhile."""


class SequenceRun:
    """Messages whose sequences follow each other; the frames of a batch share theirs."""

    __slots__ = ("first", "first_ns", "last", "last_ns")

    def __init__(self, sequence: int, publish_ns: int) -> None:
        self.first = self.last = sequence
        self.first_ns = self.last_ns = publish_ns

    def add(self, sequence: int, publish_ns: int) -> bool:
        """Add a message that follows the last one. Return False if it does not follow."""
        if sequence != self.last + 1 and (sequence != self.last or publish_ns > self.last_ns + BATCH_NS):
            return False
        self.last = sequence
        if publish_ns > self.last_ns:
            self.last_ns = publish_ns
        elif publish_ns < self.first_ns:
            self.first_ns = publish_ns
        return True

    def join(self, other: SequenceRun) -> bool:
        """Add a run that begins no earlier. Return False if it neither follows this one nor is a part of it."""
        length, begins, ends = (
            (sequence - self.first) % SEQUENCE_SPAN for sequence in (self.last, other.first, other.last)
        )
        if begins == length:
            is_next = other.first_ns - self.last_ns <= BATCH_NS
        else:
            is_next = begins == length + 1 or (begins < length and other.first_ns <= self.last_ns)
        if is_next:
            if ends > length:
                self.last = other.last
            self.last_ns = max(self.last_ns, other.last_ns)
        return is_next


def _is_free(runs: list[SequenceRun], run: SequenceRun, publish_ns: int) -> bool:
    """Report whether no other run begins between the end of this one and that time: then it cannot go on there."""
    return not any(run.last_ns < other.first_ns < publish_ns for other in runs)


class SequenceLine:
    """The messages of one topic."""

    def __init__(self) -> None:
        self._runs: list[SequenceRun] = []
        self._limit = RUNS_MAX

    def add(self, sequence: int, publish_ns: int) -> None:
        """Add a message that is there."""
        if self._runs and self._runs[-1].add(sequence, publish_ns):
            return
        recent = self._runs[-OPEN_RUNS:]
        for run in reversed(recent[:-1]):
            if _is_free(recent, run, publish_ns) and run.add(sequence, publish_ns):
                return
        if len(self._runs) >= self._limit:
            self._runs = self.runs()
            self._limit = RUNS_MAX + 2 * len(self._runs)
        self._runs.append(SequenceRun(sequence, publish_ns))

    def runs(self) -> list[SequenceRun]:
        """Return the runs, in the order of time."""
        joined: list[SequenceRun] = []
        for run in sorted(self._runs, key=attrgetter("first_ns", "first")):
            if not joined or not joined[-1].join(run):
                joined.append(run)
        self._runs = joined
        return joined

    def gaps(self) -> Iterator[tuple[SequenceRun, SequenceRun, int | None]]:
        """The runs around each gap, and how many sequences are missing; None where the source began anew."""
        runs = self.runs()
        for before, after in pairwise(runs):
            step = (after.first - before.last - 1) % SEQUENCE_SPAN
            yield before, after, step if step < RESTART_STEP else None


class Cover:
    """The times at which there was any message at all."""

    def __init__(self, silence_ns: int) -> None:
        self._silence_ns = silence_ns
        self._spans: list[list[int]] = []
        self._limit = RUNS_MAX

    def add(self, publish_ns: int) -> None:
        """Add a message that is there."""
        for span in reversed(self._spans[-OPEN_RUNS:]):
            if span[0] - self._silence_ns <= publish_ns <= span[1] + self._silence_ns:
                if publish_ns > span[1]:
                    span[1] = publish_ns
                elif publish_ns < span[0]:
                    span[0] = publish_ns
                return
        if len(self._spans) >= self._limit:
            self._join()
            self._limit = RUNS_MAX + 2 * len(self._spans)
        self._spans.append([publish_ns, publish_ns])

    def silences(self) -> Iterator[tuple[int, int]]:
        """The last message before each silence, and the first one after it."""
        self._join()
        for before, after in pairwise(self._spans):
            yield before[1], after[0]

    def _join(self) -> None:
        self._spans = list(map(list, merged(((first, last) for first, last in self._spans), self._silence_ns)))
