"""Repeated entries as one entry with a count: a drive stream is refused fifty times a second."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from itertools import islice
from typing import Final

import msgspec

from recorder.review.timeline.entries import Entry

SPELL_NS: Final = 2_500_000_000
"""Alike entries that follow each other within this time are one spell; so are entries that come each second."""

LATE_NS: Final = 60_000_000_000
"""A spell ends after this time without an addition: messages that were queried later may come out of order."""

SPELLS_MAX: Final = 10_000
"""Spells that are under way; beyond it the oldest is ended."""

NAMES_MAX: Final = 30
"""Names that a spell remembers; a chassis has ten feedback frames."""


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
