"""A robot's runs, out of its logs: the journal in its order, and beside it what the gateway said.

A journal message holds what the gateway's core was given, in order. Where none is missing a run is whole; else it
falls into parts, each without a gap. What a recorder asked for later stands behind newer messages, so what is
ahead of its time is held until its turn, up to a bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.rows import Row
from recorder.reading.topics import UNREADABLE
from schemas.decisions import Journal

JOURNAL: Final = "journal"
"""The subject."""

HELD_MAX: Final = 600
"""Journals that wait for those before them, half a minute's: what a recorder asks for comes within seconds."""

HELD_BYTES: Final = 64 * 1024 * 1024
"""The length of all that wait."""

JOURNAL_BYTES: Final = 1024 * 1024
"""The longest inputs of a journal: a twentieth of a second has some kilobytes, and a checkpoint some ten more."""


class PartEnd(msgspec.Struct, frozen=True):
    """The extent of a part of a run.

    Attributes:
        run: the run's number.
        first: the place of its first input in the run, from 0.
        inputs: their number.
        detail: the gap before or behind it; empty if there is none.
    """

    run: int
    first: int
    inputs: int
    detail: str


class Tape:
    """Plays the rows of one robot: its journals part by part, everything else to whoever takes it.

    Attributes:
        end: the end of the part that was played last.

    Args:
        rows: of one robot, by log time.
        take: takes each row that is no journal, in its place between the journals.
        faults: takes what cannot be read.
    """

    def __init__(self, rows: Iterator[Row], take: Callable[[Row], None], faults: Faults) -> None:
        self._rows = rows
        self._take = take
        self._faults = faults
        self._run: int | None = None
        self._held: dict[int, Journal] = {}
        self._reached = 0
        """The place behind all that was played of the run."""
        self._next: Journal | None = None
        """The first of the run that follows."""
        self._past: set[int] = set()
        self.end = PartEnd(0, 0, 0, "")

    def next_part(self) -> bool:
        """Advance to the beginning of the next part; False if there is none."""
        if self._held:
            return True
        if self._run is not None:
            self._past.add(self._run)
            self._run = None
        journal = self._next or self._read()
        self._next = None
        if journal is None:
            return False
        self._run, self._reached = journal.run, 0
        self._held[journal.first] = journal
        return True

    @property
    def next_time_ns(self) -> int:
        """The publish time of the first journal of the part that has come; 0 if none has."""
        return self._held[min(self._held)].time_ns if self._held else 0

    def journals(self) -> Iterator[Journal]:
        """Yield the journals of the part that has come, in order; at the end ``end`` describes the part."""
        run = self._run
        if run is None:
            return
        # A part behind a gap has waited for what is missing; a run's beginning may still come.
        while not self._reached and 0 not in self._held and self._waits():
            pass
        first = expected = 0 if 0 in self._held else min(self._held)
        self.end = PartEnd(run, first, 0, "")
        before, self._reached, is_over = self._reached, max(self._reached, first), False
        while not is_over:
            while (due := self._held.pop(expected, None)) is not None:
                expected = self._reached = expected + due.count
                yield due
            is_over = not self._waits()
        gaps = [(before, first), *([(expected, min(self._held))] if self._held else [])]
        missing = [f"inputs {begin} to {end - 1} are missing" for begin, end in gaps if begin < end]
        self.end = PartEnd(run, first, expected - first, "; ".join(missing))

    def break_off(self, detail: str) -> None:
        """End the part: the journal played last cannot be used. Another part begins behind it."""
        inputs = max(self._reached - self.end.first, 0)
        self.end = msgspec.structs.replace(self.end, inputs=inputs, detail=detail)

    def _waits(self) -> bool:
        """Read one more journal of the run; False if it has no more, or too many wait already."""
        if self._next is not None or self._is_full:
            return False
        journal = self._read()
        if journal is None:
            return False
        if journal.run != self._run:
            self._next = journal
            return False
        if journal.first >= self._reached:
            self._held.setdefault(journal.first, journal)
        return True

    @property
    def _is_full(self) -> bool:
        return len(self._held) >= HELD_MAX or sum(len(one.inputs) for one in self._held.values()) > HELD_BYTES

    def _read(self) -> Journal | None:
        """The next journal of a run that is not over."""
        for row in self._rows:
            if row.topic.subject != JOURNAL or row.topic.decode is None:
                self._take(row)
                continue
            try:
                journal = row.topic.decode(row.data)
            except UNREADABLE as error:
                self._faults.add(f"{row.topic.name}: a journal that cannot be read: {error}")
                continue
            if isinstance(journal, Journal) and len(journal.inputs) > JOURNAL_BYTES:
                self._faults.add(
                    f"{row.topic.name}: a journal of {len(journal.inputs)} bytes, which no gateway says"
                )
                continue
            # Nothing to run is in an empty one, and it would be held for ever.
            if isinstance(journal, Journal) and journal.count and journal.run not in self._past:
                return journal
        return None
