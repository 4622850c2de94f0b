"""Samples and entries that are there several times, or not at all: by their sequences, and by what they say."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterable
from itertools import islice, pairwise
from typing import Final

import msgspec

from recorder.review.entries import Entry

IDS_KEPT: Final = 50_000
"""So many samples of a topic are remembered: a quarter of an hour of decisions, as many as are ever asked for."""

PIECES_MAX: Final = 1000

SPELL_NS: Final = 2_500_000_000
"""Alike entries that follow each other within this time are one spell; so are entries that come each second."""

LATE_NS: Final = 60_000_000_000
"""A spell ends after this time without an addition: messages that were queried later may come out of order."""

SPELLS_MAX: Final = 10_000
"""Spells that are under way; beyond it the oldest is ended."""

NAMES_MAX: Final = 30
"""Names that a spell remembers; a chassis has ten feedback frames."""


class SequenceHole(msgspec.Struct, frozen=True):
    """Samples that are not in the log.

    Attributes:
        after_ns: when the last one before them was.
        before_ns: when the first one behind them was.
    """

    count: int
    after_ns: int
    before_ns: int


class _Piece(msgspec.Struct):
    first: int
    last: int
    first_ns: int
    last_ns: int


class Sequences:
    """The samples of one topic and one run of its sender, in whatever order they come."""

    def __init__(self) -> None:
        self._pieces: list[_Piece] = []
        self._told: list[SequenceHole] = []

    def add(self, sequence: int, time_ns: int) -> None:
        """A sample is there."""
        pieces = self._pieces
        at = len(pieces)
        while at and pieces[at - 1].first > sequence:
            at -= 1
        before = pieces[at - 1] if at else None
        if before is not None and before.first <= sequence <= before.last + 1:
            if sequence > before.last:
                before.last, before.last_ns = sequence, time_ns
                self._join(at)
            return
        pieces.insert(at, _Piece(sequence, sequence, time_ns, time_ns))
        self._join(at + 1)
        if len(pieces) > PIECES_MAX:
            self._told.append(_hole(pieces[0], pieces[1]))
            del pieces[0]

    def holes(self) -> list[SequenceHole]:
        """Return the ranges of missing samples between the first and the last one."""
        return self._told + [_hole(*pair) for pair in pairwise(self._pieces)]

    def _join(self, at: int) -> None:
        if 0 < at < len(self._pieces) and self._pieces[at - 1].last + 1 == self._pieces[at].first:
            behind = self._pieces.pop(at)
            self._pieces[at - 1].last, self._pieces[at - 1].last_ns = behind.last, behind.last_ns


def _hole(before: _Piece, behind: _Piece) -> SequenceHole:
    return SequenceHole(behind.first - before.last - 1, before.last_ns, behind.first_ns)


class Repeats:
    """Finds samples that were there before: an incident beside its log, two recorders' logs.

    Args:
        kept: so many samples are remembered.
    """

    def __init__(self, kept: int = IDS_KEPT) -> None:
        self._kept = kept
        self._ids: set[tuple[int, int]] = set()
        self._order: deque[tuple[int, int]] = deque()

    def is_new(self, publish_ns: int, sequence: int) -> bool:
        """The first with this publish time and sequence, as far as is remembered."""
        one = (publish_ns, sequence)
        if one in self._ids:
            return False
        self._ids.add(one)
        self._order.append(one)
        if len(self._order) > self._kept:
            self._ids.discard(self._order.popleft())
        return True


class _Spell(msgspec.Struct):
    entry: Entry
    first_ns: int
    last_ns: int
    count: int
    touched_ns: int
    about: dict[str, None]


class Spells:
    """Gathers what is alike."""

    def __init__(self) -> None:
        self._open: dict[Hashable, _Spell] = {}
        self._over: list[Entry] = []

    def add(self, key: Hashable, entry: Entry, log_ns: int, about: Iterable[str] = ()) -> None:
        """One more, or ``entry.count`` more; alike are those with the same key.

        The spell's text is the last's. What they are ``about`` is named before it, of all of them together.
        """
        spell = self._open.get(key)
        if spell is not None:
            if spell.first_ns - SPELL_NS <= entry.time_ns <= spell.last_ns + SPELL_NS:
                if entry.time_ns >= spell.last_ns:
                    spell.entry, spell.last_ns = entry, entry.last_ns
                spell.first_ns = min(spell.first_ns, entry.time_ns)
                spell.count += entry.count
                spell.touched_ns = log_ns
                spell.about = _first_names((*spell.about, *about))
                return
            del self._open[key]
            self._over.append(_told(spell))
        elif len(self._open) >= SPELLS_MAX:
            self._over.append(_told(self._open.pop(next(iter(self._open)))))
        self._open[key] = _Spell(entry, entry.time_ns, entry.last_ns, entry.count, log_ns, _first_names(about))

    def take(self, log_ns: int | None = None) -> list[Entry]:
        """The spells that are over at this log time; all of them without one."""
        over, self._over = self._over, []
        ended = [
            key
            for key, spell in self._open.items()
            if log_ns is None or not 0 <= log_ns - spell.touched_ns <= LATE_NS
        ]
        return over + [_told(self._open.pop(key)) for key in ended]


def _first_names(names: Iterable[str]) -> dict[str, None]:
    return dict.fromkeys(islice(dict.fromkeys(names), NAMES_MAX))


def _told(spell: _Spell) -> Entry:
    text, names = spell.entry.text, ", ".join(spell.about)
    if names:
        count = f"{'at least ' if len(spell.about) == NAMES_MAX else ''}{len(spell.about)} frames"
        text = f"{names}: {text}" if len(spell.about) == 1 else f"{count} ({names}): {text}"
    return msgspec.structs.replace(
        spell.entry, time_ns=spell.first_ns, last_ns=spell.last_ns, count=spell.count, text=text
    )
