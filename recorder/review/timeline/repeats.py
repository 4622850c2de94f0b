"""Repeated and missing samples of a log, by their sequences."""

from __future__ import annotations

from collections import deque
from typing import Final

import msgspec

IDS_KEPT: Final = 50_000
"""So many samples of a topic are remembered: a quarter of an hour of decisions, as many as are ever asked for."""

PIECES_MAX: Final = 1000


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
        return self._told + [_hole(*pair) for pair in zip(self._pieces, self._pieces[1:], strict=False)]

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
