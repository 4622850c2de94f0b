"""The messages of several logs in the order of their log times, whatever the order in their files.

A chunk is read when the time has come at which it begins, and held until its last message is given: as many are
held as overlap in time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from heapq import heappop, heappush, merge
from typing import Final

from recorder.reading.faults import Faults
from recorder.reading.rows import END_OF_TIME_NS, Progress
from recorder.review.joining.source import JoinSource, Row

HELD_BYTES_MAX: Final = 96_000_000
"""The most bytes of messages held. Where more overlap, the order is given up, and that is reported."""

ROW_BYTES: Final = 200
"""Memory that a held message takes besides its data."""


class _Held:
    """The messages of a chunk that have not been given."""

    __slots__ = ("at", "rows", "size")

    def __init__(self, rows: list[Row]) -> None:
        self.rows = rows
        self.at = 0
        self.size = sum(len(row[4]) + ROW_BYTES for row in rows)


def in_order(
    sources: Sequence[JoinSource], from_ns: int, to_ns: int, faults: Faults, progress: Progress = lambda _: None
) -> Iterator[Row]:
    """The wanted messages of a time.

    Args:
        sources: the logs.
        from_ns: the first log time...
        to_ns: ...and the first one that is too late.
        faults: collects an entry if too much overlaps.
        progress: receives the number of bytes that were read.
    """
    chunks = merge(*(_chunks(source, number, from_ns, to_ns) for number, source in enumerate(sources)))
    # Each with the time of its next message, and a number that tells those of the same time apart.
    held: list[tuple[int, int, _Held]] = []
    held_bytes = count = 0
    is_in_order = True
    following = next(chunks, None)
    while held or following is not None:
        if following is not None and (not held or held[0][0] >= following[0]):
            if held_bytes <= HELD_BYTES_MAX or not held:
                _, number, chunk = following
                rows = _Held(sources[number].rows(chunk, from_ns, to_ns))
                progress(sources[number].length(chunk))
                if rows.rows:
                    held_bytes += rows.size
                    count += 1
                    heappush(held, (rows.rows[0][0], count, rows))
                following = next(chunks, None)
                continue
            if is_in_order:
                faults.add("too much overlaps in time: the messages are not all in the order of their log times")
                is_in_order = False
        _, number, first = heappop(held)
        until_ns = held[0][0] if held else END_OF_TIME_NS
        if following is not None and is_in_order:
            until_ns = min(until_ns, following[0])
        # At least one, or nothing would ever go on.
        end = _end(first, until_ns)
        yield from first.rows[first.at : end]
        first.at = end
        if end < len(first.rows):
            heappush(held, (first.rows[end][0], number, first))
        else:
            held_bytes -= first.size


def _end(held: _Held, until_ns: int) -> int:
    """Up to which of its messages may be given before that time."""
    rows, end = held.rows, held.at + 1
    if rows[-1][0] < until_ns:
        return len(rows)
    while end < len(rows) and rows[end][0] < until_ns:
        end += 1
    return end


def _chunks(source: JoinSource, number: int, from_ns: int, to_ns: int) -> Iterator[tuple[int, int, int]]:
    """Beginning, source and number of each chunk that may hold messages of this time, by their beginnings."""
    for chunk in sorted(range(len(source.starts)), key=source.starts.__getitem__):
        if source.starts[chunk] < to_ns and source.ends[chunk] >= from_ns:
            yield source.starts[chunk], number, chunk
