"""The parts of a file that have to be read for some channels and some time, by the index of its chunks. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import BinaryIO, Final

from recorder.mcap.framing import FIRST_RECORD, DamagedError
from recorder.mcap.summary_reader import LogSummary

GAP_BYTES: Final = 131_072
"""Two parts that lie no further apart are read as one: one request more takes longer."""


def stretches(
    summary: LogSummary, stream: BinaryIO, channels: Collection[int], from_ns: int, to_ns: int
) -> Iterator[tuple[int, int]]:
    """Return beginning and end of each part of a file that may hold wanted messages, in bytes and in their order.

    Where the index of chunks does not tell all, it is the whole data section.

    Args:
        summary: of the file.
        stream: the file.
        channels: by their ids.
        from_ns: the first log time.
        to_ns: the first one that is too late.
    """
    whole = [(FIRST_RECORD, summary.start)]
    statistics = summary.statistics
    if statistics is None or len(summary.channels) < statistics.channel_count or not summary.chunks_at:
        return iter(whole)
    if not channels:
        return iter(())
    found: list[tuple[int, int]] = []
    chunks = 0
    wanted = frozenset(channels)
    try:
        for chunk in summary.chunks(stream):
            chunks += 1
            places = chunk.place_map()
            if places and (chunk.start_ns >= to_ns or chunk.end_ns < from_ns or wanted.isdisjoint(places)):
                continue
            found.append((chunk.offset, chunk.offset + chunk.length + chunk.indexes_length))
    except DamagedError:
        return iter(whole)
    return iter(joined(found)) if chunks == statistics.chunk_count else iter(whole)


def joined(parts: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return parts of a file, each from an offset to another, in order; those that lie close together as one."""
    found: list[tuple[int, int]] = []
    for start, end in sorted(parts):
        if found and start - found[-1][1] <= GAP_BYTES:
            found[-1] = found[-1][0], max(end, found[-1][1])
        else:
            found.append((start, end))
    return found
