"""A robot's runs, out of its logs: the journal in its order, and beside it what the gateway said.

A journal message holds what the gateway's core was given, in order. A run can be given to the arbiter again from
its first input on, as far as none is missing. What a recorder asked for later stands behind newer messages, so
what is ahead of its time is held until its turn, up to a bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import msgspec

from recorder.review.faults import Faults
from recorder.review.rows import Row
from recorder.review.topics import UNREADABLE
from schemas.decisions import Journal

JOURNAL: Final = "journal"
"""The subject."""

HELD_BYTES: Final = 64_000_000
"""Inputs that wait for those before them. A gateway keeps 16 MB for those who come late."""


class RunEnd(msgspec.Struct, frozen=True):
    """How far a run's journal goes.

    Attributes:
        run: its number.
        inputs: so many from the first on are there without a gap.
        detail: what is missing behind them; empty if nothing is.
    """

    run: int
    inputs: int
    detail: str


class Tape:
    """Plays the rows of one robot: its journals run by run, everything else to whoever takes it.

    Args:
        rows: of one robot, by log time.
        take: takes each row that is no journal, in its place between the journals.
        faults: takes what cannot be read.
    """

    def __init__(self, rows: Iterator[Row], take: Callable[[Row], None], faults: Faults) -> None:
        self._rows = rows
        self._take = take
        self._faults = faults
        self._next: Journal | None = None
        self._past: set[int] = set()

    def next_run(self) -> bool:
        """Goes on to the beginning of the next run; False if there is none."""
        if self._next is None:
            self._next = self._read()
        return self._next is not None

    @property
    def next_time_ns(self) -> int:
        """When the first journal of the run that has come was published; 0 if none has."""
        return 0 if self._next is None else self._next.time_ns

    def journals(self, ended: Callable[[RunEnd], None]) -> Iterator[Journal]:
        """The journals of the run that has come, in their order; at the end it is told how far they go."""
        journal, self._next = self._next, None
        if journal is None:
            return
        run, expected, held_bytes = journal.run, 0, 0
        held: dict[int, Journal] = {}
        while journal is not None and journal.run == run and held_bytes <= HELD_BYTES:
            if journal.first >= expected and journal.first not in held:
                held[journal.first] = journal
                held_bytes += len(journal.inputs)
            while (due := held.pop(expected, None)) is not None:
                held_bytes -= len(due.inputs)
                expected += due.count
                yield due
            journal = self._read()
        self._past.add(run)
        if journal is not None and journal.run != run:
            self._next = journal
        ended(RunEnd(run, expected, _missing(expected, held)))

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
            # Nothing to run is in an empty one, and it would be held for ever.
            if isinstance(journal, Journal) and journal.count and journal.run not in self._past:
                return journal
        return None


def _missing(expected: int, held: dict[int, Journal]) -> str:
    if not held:
        return ""
    cure = "" if expected else "; a run is run again from its first input alone, and the log begins later"
    return f"inputs {expected} to {min(held) - 1} are missing{cure}"
