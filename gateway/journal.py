"""The journal: everything the core was given, in its order and with its times. Pure.

With the configuration and the run number it is enough to run the core again: see ``gateway.rerun.rerun``. An input
is an array: its kind, the monotonic time, and what the core's method of that kind was given. Once a minute, while
the gateway is at rest, it says what it would have to be remembered by, so that what follows is enough.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final

import msgspec

from schemas.decisions import Journal
from schemas.journal import COMMAND_RULES, Kind
from schemas.messages import SEQUENCE_MAX

Input = tuple[Any, ...]

LINKS: Final = (
    "bus_up",
    "bus_losses",
    "guarded",
    "guard_sends",
    "guard_stops",
    "is_behind",
    "realtime",
    "guard_says",
)
"""The links that the command flow decides by. Older journals hold the first six only."""

FRAME: Final = Kind.FRAME.value
"""Of all kinds this one is written 7,500 times a second, and a plain integer is encoded in half the time."""


class JournalWriter:
    """Gathers inputs until they are taken."""

    def __init__(self, run: int) -> None:
        self._run = run
        self._inputs: list[Input] = []
        self._first = 0
        self._sequence = 0
        self.add = self._inputs.append

    def take(self, wall_ns: int) -> Journal | None:
        """The inputs since the last time, as one message; None if there are none."""
        inputs = self._inputs
        if not inputs:
            return None
        journal = Journal(
            time_ns=wall_ns,
            sequence=self._sequence,
            run=self._run,
            first=self._first,
            count=len(inputs),
            inputs=_ENCODER.encode(inputs),
            rules=COMMAND_RULES,
        )
        self._first += len(inputs)
        self._sequence = (self._sequence + 1) & SEQUENCE_MAX
        inputs.clear()
        return journal


_ENCODER: Final = msgspec.msgpack.Encoder()
_DECODER: Final = msgspec.msgpack.Decoder(list[tuple[Any, ...]])


class BrokenJournalError(ValueError):
    """An input that cannot be given to a core: the log was damaged, or a newer version wrote it."""


class JournalGapError(BrokenJournalError):
    """Part of a run's journal is missing, so it cannot be run again."""


def read(journals: Iterable[Journal]) -> Iterator[Input]:
    """The inputs of a run, in their order; a log may hold its journals in any, and some of them twice.

    Raises:
        JournalGapError: they do not begin with the first input, some are missing, or they are of several runs.
        BrokenJournalError: one cannot be read.
    """
    once = {(journal.first, journal.run): journal for journal in journals}
    yield from follow([journal for _, journal in sorted(once.items())], 0)


def follow(journals: Iterable[Journal], first: int | None = None) -> Iterator[Input]:
    """The inputs of journals that follow each other.

    Args:
        journals: of one run, in their order.
        first: the place of the first input; None takes it as it comes.

    Raises:
        JournalGapError: some are missing, or another run begins.
        BrokenJournalError: one cannot be read.
    """
    run, expected = None, first
    for journal in journals:
        if run not in {None, journal.run}:
            raise JournalGapError(f"run {run} ends after {expected} inputs, and run {journal.run} begins")
        run, expected = journal.run, journal.first if expected is None else expected
        if journal.first != expected:
            cure = "" if expected else "; a run is run again from its first input alone, and the log begins later"
            raise JournalGapError(f"inputs {expected} to {journal.first - 1} are missing{cure}")
        expected += journal.count
        yield from inputs_of(journal)


def inputs_of(journal: Journal) -> list[Input]:
    """The inputs that a message holds.

    Raises:
        BrokenJournalError: they cannot be read.
    """
    try:
        return _DECODER.decode(journal.inputs)
    except (ValueError, RecursionError) as error:  # Not UTF-8, or nested too deeply, as msgspec raises it too.
        raise BrokenJournalError(f"inputs {journal.first} on cannot be read: {error}") from error


def reach(journals: Iterable[Journal]) -> dict[int, int]:
    """Count what can be run again: of each run the inputs from its first on, up to a gap; 0 without it."""
    reached: dict[int, int] = {}
    for journal in sorted(journals, key=lambda one: one.first):
        expected = reached.setdefault(journal.run, 0)
        if journal.first == expected:
            reached[journal.run] += journal.count
    return reached
