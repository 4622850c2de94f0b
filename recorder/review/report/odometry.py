"""The way of a robot from its speed, and its path from speed and steering angle.

The bicycle model: yaw rate = speed * tan(angle) / wheelbase. Axes are those of ISO 8855, x forward and y left as
the robot stood at first. Where samples are missing the path breaks off, and continues at the same place: nobody
knows where the robot was meanwhile.
"""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, isfinite, pi, radians, sin, tan
from typing import Final

import msgspec

from schemas.cruiser import WHEELBASE_M

GAP_NS: Final = 500_000_000
"""Ten periods of ``state``: beyond that nothing is integrated."""

CLOCK_STEP_NS: Final = 600_000_000_000
"""A source's time that goes back further was set anew; one that goes back less is of a sample there before."""

STANDING_MPS: Final = 0.02

PLACES_MAX: Final = 4000

_ANGLE_MAX_DEG: Final = 80.0
"""The chassis steers to 24 deg; what is beyond sense must not end the path."""
_SPEED_MAX_MPS: Final = 100.0
_FIRST_STEP_M: Final = 0.01
_FIRST_TURN_RAD: Final = radians(2)


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


class SpeedMeter:
    """Integrates speeds, of samples that may come twice, out of order or not at all.

    Attributes:
        distance_m: the length of the way, forward and in reverse.
        moving_ns: time for which the robot was faster than STANDING_MPS.
        known_ns: time for which that is known.
        top_mps: the highest speed, in either direction...
        top_ns: ...and when.
        gaps: number of times without data for longer than GAP_NS; ``gap_ns`` in all.
        stale: samples that were there before, or came out of order.
        begun_ns: the sample with which the newest time without a gap begins.
        last_ns: the newest known sample; None before the first.
    """

    def __init__(self) -> None:
        self.distance_m = 0.0
        self.moving_ns = self.known_ns = self.gaps = self.gap_ns = self.stale = 0
        self.top_mps, self.top_ns = 0.0, 0
        self.begun_ns = 0
        self.last_ns: int | None = None
        self._last_mps = 0.0

    def add(self, time_ns: int, speed_mps: float | None) -> float | None:
        """Add a sample; its speed is None where the robot does not know it.

        Returns the way since the sample before, in metres, negative in reverse, 0 after a gap; None for a sample
        that does not count.
        """
        before_ns = self.last_ns
        if before_ns is not None and before_ns - CLOCK_STEP_NS < time_ns <= before_ns:
            self.stale += 1
            return None
        if speed_mps is None or not _is_sound(speed_mps, _SPEED_MAX_MPS):
            return None
        if abs(speed_mps) > abs(self.top_mps):
            self.top_mps, self.top_ns = speed_mps, time_ns
        mean_mps = (self._last_mps + speed_mps) / 2
        self.last_ns, self._last_mps = time_ns, speed_mps
        if before_ns is None or not 0 < time_ns - before_ns <= GAP_NS:
            if before_ns is not None:
                self.gaps += 1
                self.gap_ns += max(0, time_ns - before_ns)
            self.begun_ns = time_ns
            return 0.0
        span_ns = time_ns - before_ns
        step_m = mean_mps * span_ns / 1e9
        self.distance_m += abs(step_m)
        self.known_ns += span_ns
        if abs(mean_mps) > STANDING_MPS:
            self.moving_ns += span_ns
        return step_m


class Odometer:
    """Integrates speeds and steering angles, and keeps as many places as are worth drawing.

    Attributes:
        speeds: those with an angle, by which the path grows.
        x_m, y_m, heading_rad: the end of the path.
        places: those that are kept.
    """

    def __init__(self, limit: int = PLACES_MAX) -> None:
        self._limit = limit
        self._step_m, self._turn_rad = _FIRST_STEP_M, _FIRST_TURN_RAD
        self.speeds = SpeedMeter()
        self.places: list[Place] = []
        self.x_m = self.y_m = self.heading_rad = 0.0
        self._last_rad = 0.0

    def add(self, time_ns: int, speed_mps: float | None, angle_deg: float | None) -> float:
        """Add a sample; None where the robot does not know. Returns by how far the path grew, in metres."""
        if angle_deg is None or not _is_sound(angle_deg, _ANGLE_MAX_DEG):
            speed_mps, angle_deg = None, 0.0
        step_m = self.speeds.add(time_ns, speed_mps)
        if step_m is None:
            return 0.0
        before_rad, self._last_rad = self._last_rad, radians(angle_deg)
        if self.speeds.begun_ns == time_ns:
            self._keep(time_ns, begins=True)
        else:
            self._move(time_ns, step_m, (before_rad + self._last_rad) / 2)
        return abs(step_m)

    def _move(self, time_ns: int, step_m: float, angle_rad: float) -> None:
        """Move on, with half the turn before the step and half behind it."""
        turn_rad = step_m * tan(angle_rad) / WHEELBASE_M
        self.x_m += step_m * cos(self.heading_rad + turn_rad / 2)
        self.y_m += step_m * sin(self.heading_rad + turn_rad / 2)
        self.heading_rad = (self.heading_rad + turn_rad + pi) % (2 * pi) - pi
        last = self.places[-1]
        is_far = hypot(self.x_m - last.x_m, self.y_m - last.y_m) >= self._step_m
        if is_far or abs(_between(self.heading_rad, radians(last.heading_deg))) >= self._turn_rad:
            self._keep(time_ns, begins=False)

    def _keep(self, time_ns: int, *, begins: bool) -> None:
        self.places.append(Place(time_ns, self.x_m, self.y_m, degrees(self.heading_rad), begins))
        if len(self.places) > self._limit:
            self._step_m *= 2
            self._turn_rad = min(2 * self._turn_rad, pi / 8)
            begun = [number for number, place in enumerate(self.places) if place.begins]
            # Where each piece begins stays, unless the log is nothing but gaps.
            kept = set(range(0, len(self.places), 2)) | set(begun[: self._limit // 4]) | {len(self.places) - 1}
            self.places = [self.places[number] for number in sorted(kept)]

    def end(self) -> list[Place]:
        """The places, the last one included."""
        last_ns = self.speeds.last_ns
        if last_ns is None or self.places[-1].time_ns == last_ns:
            return self.places
        last = Place(last_ns, self.x_m, self.y_m, degrees(self.heading_rad), begins=False)
        return [*self.places, last]


def _is_sound(value: float, most: float) -> bool:
    return isfinite(value) and abs(value) <= most


def _between(one_rad: float, other_rad: float) -> float:
    """The angle between two headings."""
    return atan2(sin(one_rad - other_rad), cos(one_rad - other_rad))
