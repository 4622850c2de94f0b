"""Drawings of a drive: lines over time, bands of values and the path, reduced while samples stream in."""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, cos, degrees, hypot, isfinite, pi, radians, sin, tan
from typing import Final

import msgspec

from recorder.review.drives import GAP_NS
from schemas.cruiser import WHEELBASE_M
from schemas.decisions import ArbiterState, SafetyState
from schemas.messages import Mode, RobotState

BUCKETS_MAX: Final = 1500
"""More than a chart is wide in pixels."""

BREAKS_MAX: Final = 1000
SPANS_MAX: Final = 600
PLACES_MAX: Final = 4000

MIXED: Final = "(changing)"
"""The value of a span that stands for several that are too short to be drawn."""

LINES: Final = (
    "speed_mps",
    "target_speed_mps",
    "output_speed_mps",
    "speed_limit_mps",
    "angle_deg",
    "target_angle_deg",
    "output_angle_deg",
    "steering_limit_deg",
)
"""Values that are drawn over time: measured ones of ``state``, commanded ones of ``safety/state``."""

BANDS: Final = ("mode", "arbiter", "lease")
"""The chassis's mode, the arbiter's state, and the holder of the lease."""

TARGETS: Final = frozenset({"target_speed_mps", "target_angle_deg"})
"""Commanded values. The state repeats them until others come; they hold while the arbiter is engaged."""

_OUTPUTS: Final = ("target_speed_mps", "output_speed_mps", "target_angle_deg", "output_angle_deg")
_FIRST_WIDTH_NS: Final = 1_000_000
_FIRST_STEP_M: Final = 0.01
_FIRST_TURN_RAD: Final = radians(2)

Point = tuple[int, float]
"""Time in nanoseconds, and value."""


class Span(msgspec.Struct, frozen=True):
    """A value, and when it held; times in nanoseconds since 1970."""

    start_ns: int
    end_ns: int
    value: str


class Place(msgspec.Struct, frozen=True):
    """A position of the robot.

    Attributes:
        x_m: forward, as it stood at first; ``y_m`` left.
        heading_deg: from x to y.
        begins: the path before it is broken off.
    """

    time_ns: int
    x_m: float
    y_m: float
    heading_deg: float
    begins: bool


class Charts:
    """The charts of one drive."""

    def __init__(self) -> None:
        self.lines = {name: Series() for name in LINES}
        self.bands = {name: Spans() for name in BANDS}
        self.path = Path()

    def bound(self, share: float) -> None:
        """Keep this part of the points that a chart usually has."""
        for line in self.lines.values():
            line.limit = round(BUCKETS_MAX * share)
        self.path.limit = round(PLACES_MAX * share)

    def add_state(self, time_ns: int, state: RobotState, step_m: float | None, *, begins: bool) -> None:
        """Add what was measured, and the way since the sample before; None if that is not known."""
        if step_m is not None:
            self.path.move(time_ns, step_m, state.angle_deg or 0.0, begins=begins)
        self._draw("speed_mps", time_ns, state.speed_mps)
        self._draw("angle_deg", time_ns, state.angle_deg)
        self.bands["mode"].add(time_ns, "" if state.mode is Mode.UNDEFINED else state.mode.value)

    def add_arbiter(self, time_ns: int, state: SafetyState) -> None:
        """Add what was commanded."""
        self.bands["arbiter"].add(time_ns, state.state.value)
        self.bands["lease"].add(time_ns, state.lease_holder)
        self._draw("speed_limit_mps", time_ns, state.speed_limit_mps)
        self._draw("steering_limit_deg", time_ns, state.steering_limit_deg)
        is_sending = state.state is not ArbiterState.STANDBY
        for name in _OUTPUTS:
            is_drawn = state.state is ArbiterState.ENGAGED if name in TARGETS else is_sending
            self._draw(name, time_ns, getattr(state, name) if is_drawn else None)

    def _draw(self, line: str, time_ns: int, value: float | None) -> None:
        if value is None or not isfinite(value):
            self.lines[line].cut()
        else:
            self.lines[line].add(time_ns, value)


class Series:
    """One line of a chart. Samples may come out of order.

    Time is cut into buckets, and of each the first, lowest, highest and last sample are kept: no spike is lost.
    When there are too many buckets they are made twice as wide.
    """

    def __init__(self, limit: int = BUCKETS_MAX) -> None:
        self.limit = limit
        self._width_ns = _FIRST_WIDTH_NS
        self._buckets: dict[int, list[Point]] = {}
        self._breaks: list[tuple[int, int]] = []
        self._last_ns: int | None = None

    def add(self, time_ns: int, value: float) -> None:
        """One more sample."""
        point = (time_ns, value)
        bucket = self._buckets.get(time_ns // self._width_ns)
        if bucket is None:
            self._buckets[time_ns // self._width_ns] = [point] * 4
            self._widen()
        else:
            _merge(bucket, point)
        if self._last_ns is not None and time_ns - self._last_ns > GAP_NS:
            self._add_break(self._last_ns, time_ns)
        self._last_ns = time_ns

    def cut(self) -> None:
        """The value is not known from here on: the next sample begins a new piece."""
        if self._last_ns is not None:
            self._add_break(self._last_ns, self._last_ns + 1)
            self._last_ns = None

    def points(self, from_ns: int = 0, to_ns: int = 2**64) -> Iterator[Point | None]:
        """Yield the line in the order of time, None where it is broken."""
        self._widen()
        breaks = sorted(self._breaks, reverse=True)
        before_ns = None
        for number in sorted(self._buckets):
            for point in sorted(dict.fromkeys(self._buckets[number])):
                if not from_ns <= point[0] <= to_ns:
                    continue
                is_broken = False
                while breaks and breaks[-1][0] < point[0]:
                    broken_ns = breaks.pop()[0]
                    is_broken |= before_ns is not None and broken_ns >= before_ns
                if is_broken:
                    yield None
                yield point
                before_ns = point[0]

    def _add_break(self, from_ns: int, to_ns: int) -> None:
        self._breaks.append((from_ns, to_ns))
        if len(self._breaks) > BREAKS_MAX:
            # Those that are too short to be seen go first.
            self._breaks = sorted(self._breaks, key=lambda one: one[0] - one[1])[: BREAKS_MAX // 2]

    def _widen(self) -> None:
        while len(self._buckets) > self.limit:
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


class Spans:
    """One band of a chart: values, and from when to when each held. What comes late is passed over.

    Args:
        limit: spans at most; beyond it short ones become one that is ``MIXED``.
    """

    def __init__(self, limit: int = SPANS_MAX) -> None:
        self._limit = limit
        self._shortest_ns = 1_000_000
        self._spans: list[Span] = []
        self._start_ns = self._last_ns = 0
        self._value: str | None = None

    def add(self, time_ns: int, value: str) -> None:
        """It was so at this time."""
        if self._value is not None and time_ns < self._last_ns:
            return
        is_silent = self._value is not None and time_ns - self._last_ns > GAP_NS
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


class Path:
    """The path from ways and steering angles, by the bicycle model: as many places as are worth drawing.

    Axes are those of ISO 8855, x forward and y left as the robot stood at first. Where samples are missing the
    path breaks off, and goes on from the same place.
    """

    def __init__(self) -> None:
        self.limit = PLACES_MAX
        self._step_m, self._turn_rad = _FIRST_STEP_M, _FIRST_TURN_RAD
        self._places: list[Place] = []
        self._x_m = self._y_m = self._heading_rad = self._last_rad = 0.0
        self._last_ns = 0

    def move(self, time_ns: int, step_m: float, angle_deg: float, *, begins: bool) -> None:
        """Move on, with half the turn before the step and half behind it."""
        before_rad, self._last_rad = self._last_rad, radians(angle_deg)
        self._last_ns = time_ns
        if begins or not self._places:
            self._keep(time_ns, begins=True)
            return
        turn_rad = step_m * tan((before_rad + self._last_rad) / 2) / WHEELBASE_M
        self._x_m += step_m * cos(self._heading_rad + turn_rad / 2)
        self._y_m += step_m * sin(self._heading_rad + turn_rad / 2)
        self._heading_rad = (self._heading_rad + turn_rad + pi) % (2 * pi) - pi
        last = self._places[-1]
        off_rad = self._heading_rad - radians(last.heading_deg)
        is_turned = abs(atan2(sin(off_rad), cos(off_rad))) >= self._turn_rad
        if is_turned or hypot(self._x_m - last.x_m, self._y_m - last.y_m) >= self._step_m:
            self._keep(time_ns, begins=False)

    def places(self) -> list[Place]:
        """Return the places, the last one included."""
        if not self._places or self._places[-1].time_ns == self._last_ns:
            return self._places
        return [*self._places, self._here(self._last_ns, begins=False)]

    def _here(self, time_ns: int, *, begins: bool) -> Place:
        return Place(time_ns, self._x_m, self._y_m, degrees(self._heading_rad), begins)

    def _keep(self, time_ns: int, *, begins: bool) -> None:
        self._places.append(self._here(time_ns, begins=begins))
        if len(self._places) > self.limit:
            self._step_m *= 2
            self._turn_rad = min(2 * self._turn_rad, pi / 8)
            begun = [number for number, place in enumerate(self._places) if place.begins]
            # Where each piece begins stays, unless the log is nothing but gaps.
            kept = set(range(0, len(self._places), 2)) | set(begun[: self.limit // 4]) | {len(self._places) - 1}
            self._places = [self._places[number] for number in sorted(kept)]
