"""The bands of a chart: values, and from when to when each held."""

from __future__ import annotations

from typing import Final

import msgspec

SPANS_MAX: Final = 600

MIXED: Final = "(changing)"
"""The value of a span that stands for several that are too short to be drawn."""


class Span(msgspec.Struct, frozen=True):
    """A value, and when it held; times in nanoseconds since 1970."""

    start_ns: int
    end_ns: int
    value: str


class Spans:
    """One band of a chart. Samples come in the order of time; what comes late is passed over.

    Args:
        break_ns: across a longer silence nothing is known.
        limit: spans at most; beyond it short ones become one that is ``MIXED``.
    """

    def __init__(self, break_ns: int, limit: int = SPANS_MAX) -> None:
        self._break_ns = break_ns
        self._limit = limit
        self._shortest_ns = 1_000_000
        self._spans: list[Span] = []
        self._start_ns = self._last_ns = 0
        self._value: str | None = None

    def add(self, time_ns: int, value: str) -> None:
        """It was so at this time."""
        if self._value is not None and time_ns < self._last_ns:
            return
        is_silent = self._value is not None and time_ns - self._last_ns > self._break_ns
        if value != self._value or is_silent:
            self._end(self._last_ns if is_silent else time_ns)
            self._value, self._start_ns = value, time_ns
        self._last_ns = time_ns

    def spans(self) -> list[Span]:
        """All of them so far; those whose value is empty are left out."""
        now = [] if self._value is None else [Span(self._start_ns, self._last_ns, self._value)]
        return [span for span in [*self._spans, *now] if span.value]

    def _end(self, time_ns: int) -> None:
        if self._value is not None and time_ns > self._start_ns:
            self._spans.append(Span(self._start_ns, time_ns, self._value))
        while len(self._spans) > self._limit:
            self._shortest_ns *= 2
            self._spans = _coarser(self._spans, self._shortest_ns)


def _coarser(spans: list[Span], shortest_ns: int) -> list[Span]:
    """Neighbours of which one is short become one, as long as that is not yet long itself."""
    coarse: list[Span] = []
    for span in spans:
        before = coarse[-1] if coarse else None
        if before is not None and span.end_ns - before.start_ns <= shortest_ns:
            value = before.value if before.value == span.value else MIXED
            coarse[-1] = Span(before.start_ns, span.end_ns, value)
        else:
            coarse.append(span)
    return coarse
