"""Ranges of time, each a time and the one after its last. Pure."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable

Range = tuple[int, int]


def merged(ranges: Iterable[Range], near_ns: int = 0) -> list[Range]:
    """Ranges in order, those that touch or are near made one."""
    found: list[Range] = []
    for from_ns, to_ns in sorted(ranges):
        if found and from_ns <= found[-1][1] + near_ns:
            found[-1] = found[-1][0], max(found[-1][1], to_ns)
        else:
            found.append((from_ns, to_ns))
    return found


def without(ranges: list[Range], taken: list[Range]) -> list[Range]:
    """Return the parts of merged ranges that lie outside of other merged ones."""
    left: list[Range] = []
    place = 0
    for from_ns, to_ns in ranges:
        while place < len(taken) and taken[place][1] <= from_ns:
            place += 1
        begin_ns = from_ns
        for first_ns, end_ns in taken[place:]:
            if first_ns >= to_ns:
                break
            if begin_ns < first_ns:
                left.append((begin_ns, first_ns))
            begin_ns = end_ns
        if begin_ns < to_ns:
            left.append((begin_ns, to_ns))
    return left


def overlaps(ranges: list[Range], from_ns: int, to_ns: int) -> bool:
    """Report whether any of merged ranges and this one have a time in common."""
    place = bisect_left(ranges, to_ns, key=lambda one: one[0])
    return place > 0 and ranges[place - 1][1] > from_ns
