"""Numbers over time, reduced while they stream in.

Time is cut into buckets, and of each the first, lowest, highest and last sample are kept: drawn as lines that is
the same picture as all of them would be, and no spike is lost. When there are too many buckets they are made twice
as wide. Samples may come out of order.
"""

from __future__ import annotations

from typing import Final

BUCKETS_MAX: Final = 1500
"""More than a chart is wide in pixels."""

BREAKS_MAX: Final = 1000

_FIRST_WIDTH_NS: Final = 1_000_000

Point = tuple[int, float]
"""Time in nanoseconds, and value."""


class Series:
    """One line of a chart.

    Args:
        break_ns: samples further apart in time break the line.
        limit: buckets at most.
    """

    def __init__(self, break_ns: int, limit: int = BUCKETS_MAX) -> None:
        self._break_ns = break_ns
        self._limit = limit
        self._width_ns = _FIRST_WIDTH_NS
        self._buckets: dict[int, list[Point]] = {}
        """First, lowest, highest and last sample, by the number of the bucket."""
        self._breaks: list[tuple[int, int]] = []
        self._last_ns: int | None = None
        self.samples = 0

    def add(self, time_ns: int, value: float) -> None:
        """One more sample."""
        point = (time_ns, value)
        bucket = self._buckets.get(time_ns // self._width_ns)
        if bucket is None:
            self._buckets[time_ns // self._width_ns] = [point] * 4
            if len(self._buckets) > self._limit:
                self._widen()
        else:
            _merge(bucket, point)
        if self._last_ns is not None and time_ns - self._last_ns > self._break_ns:
            self._add_break(self._last_ns, time_ns)
        self._last_ns = time_ns
        self.samples += 1

    def cut(self) -> None:
        """The value is not known from here on: the next sample begins a new piece."""
        if self._last_ns is not None:
            self._add_break(self._last_ns, self._last_ns + 1)
            self._last_ns = None

    def points(self) -> list[Point | None]:
        """The line in the order of time, None where it is broken."""
        found: list[Point | None] = []
        breaks = sorted(self._breaks)
        at, before_ns = 0, None
        for number in sorted(self._buckets):
            for point in sorted(dict.fromkeys(self._buckets[number])):
                while at < len(breaks) and breaks[at][0] < point[0]:
                    if before_ns is not None and breaks[at][0] >= before_ns and found[-1] is not None:
                        found.append(None)
                    at += 1
                found.append(point)
                before_ns = point[0]
        return found

    def _add_break(self, from_ns: int, to_ns: int) -> None:
        self._breaks.append((from_ns, to_ns))
        if len(self._breaks) > BREAKS_MAX:
            # Those that are too short to be seen go first.
            self._breaks = sorted(self._breaks, key=lambda one: one[0] - one[1])[: BREAKS_MAX // 2]

    def _widen(self) -> None:
        while len(self._buckets) > self._limit:
            self._width_ns *= 2
            wider: dict[int, list[Point]] = {}
            for number, points in self._buckets.items():
                bucket = wider.setdefault(number // 2, points)
                if bucket is not points:
                    for point in points:
                        _merge(bucket, point)
            self._buckets = wider


def _merge(bucket: list[Point], point: Point) -> None:
    first, lowest, highest, last = bucket
    if point[0] < first[0]:
        bucket[0] = point
    if point[1] < lowest[1]:
        bucket[1] = point
    if point[1] > highest[1]:
        bucket[2] = point
    if point[0] >= last[0]:
        bucket[3] = point
