"""The drives of a robot: distances, stops, ends and the worst moment, from its samples and its entries. Pure.

Report, catalog and searches print these figures, so there is one number of each. Memory does not grow with a log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from math import cos, isfinite, remainder, sin, tau
from typing import Final

import msgspec

from gateway.chassis.odometry import GAP_NS, DeadReckoning
from gateway.choice.chassis import CHASSIS
from recorder.review.entries import Entry, EntryKind, EntrySource
from schemas.decisions import Severity
from schemas.messages import Odometry
from schemas.reasons import Reason

REST_NS: Final = 600_000_000_000
"""A rest that is shorter belongs to the drive."""

MARGIN_NS: Final = 10_000_000_000
"""The time before and behind a drive that belongs to it: what led to it, and how its stop ended."""

DRIVES_MAX: Final = 500
"""The first so many are told one by one; more are counted."""

CLOCK_STEP_NS: Final = 600_000_000_000
"""A source's time that goes back further was set anew; one that goes back less is of a sample there before."""

STANDING_MPS: Final = 0.02
JUMP_MPS: Final = 0.5
"""No robot changes its speed by more from one sample to the next: that is a wrong scale, or a wrong frame."""

SPEED_MAX_MPS: Final = 100.0

DIED: Final = "gateway_died"
"""The cause of a stop of which no more is known."""

BY_OPERATORS: Final = frozenset(
    {Reason.REMOTE_STOP.value, Reason.HAND_TRANSMITTER.value, Reason.LEASE_TAKEN.value}
)
"""Causes of stops that are somebody's doing; all others are faults."""

ENTRIES_MAX: Final = 2000
ERRORS_MAX: Final = 500
"""Errors that are kept beyond these: a thousand leases must not hide a gateway that died."""

GAPS_MAX: Final = 200

_RANKS: Final = {Severity.INFO: 0, Severity.WARNING: 1, Severity.ERROR: 2}
_IN_OTHER_TABLES: Final = frozenset({EntryKind.REFUSAL, EntryKind.REQUEST})


def operators_stops(stops: Mapping[str, int]) -> int:
    """Return how many of these stops, by cause, were made by operators."""
    return sum(count for cause, count in stops.items() if cause in BY_OPERATORS)


class RecordedWay(DeadReckoning):
    """The way of a robot since the first sample: by its own odometry, or by its speeds where the log has none."""

    def __init__(self) -> None:
        super().__init__(CHASSIS.wheelbase_m)
        self._said: Odometry | None = None
        self._said_ns = 0

    def follow(self, said: Odometry, time_ns: int) -> None:
        """Go on as the robot's odometry did since its last sample. Another gateway, or a reset, begins anew."""
        before, self._said, self._said_ns = self._said, said, time_ns
        self.last_ns = None
        if (
            before is None
            or not 0 < said.time_ns - before.time_ns <= GAP_NS
            or said.distance_m < before.distance_m
        ):
            return
        turned_rad = self.heading_rad - before.heading_rad
        ahead_m, aside_m = said.x_m - before.x_m, said.y_m - before.y_m
        self.x_m += ahead_m * cos(turned_rad) - aside_m * sin(turned_rad)
        self.y_m += ahead_m * sin(turned_rad) + aside_m * cos(turned_rad)
        self.heading_rad = remainder(said.heading_rad + turned_rad, tau)
        self.distance_m += said.distance_m - before.distance_m

    def move(self, time_ns: int, speed_mps: float | None, angle_deg: float | None) -> None:
        """Go on to a sample of ``state``, unless the odometry has told of this time."""
        if self._said is None or abs(time_ns - self._said_ns) > GAP_NS:
            super().move(time_ns, speed_mps, angle_deg)


class SpeedMeter:
    """Measures speeds and the way, of samples that may come twice, out of order or not at all.

    Attributes:
        moving_ns: time for which the robot was faster than STANDING_MPS, of ``known_ns`` of which that is known.
        top_mps: the highest believable speed, negative in reverse; ``top_ns``, when.
        gaps: number of times without data for longer than GAP_NS, but for long rests; ``gap_ns`` in all.
        begun_ns: the sample with which the newest time without a gap begins.
    """

    def __init__(self) -> None:
        self.way = RecordedWay()
        self.moving_ns = self.known_ns = self.gaps = self.gap_ns = 0
        self.top_mps, self.top_ns = 0.0, 0
        self.begun_ns = 0
        self.last_ns: int | None = None
        self._last_mps = self._counted_m = 0.0
        self._is_doubted = False

    @property
    def distance_m(self) -> float:
        """The length of the way, forward and in reverse."""
        return self.way.distance_m

    def add(self, time_ns: int, speed_mps: float | None, angle_deg: float = 0.0) -> float | None:
        """Add a sample; return the way since the one before in metres, None for one that does not count."""
        before_ns, before_mps = self.last_ns, self._last_mps
        if before_ns is not None and before_ns - CLOCK_STEP_NS < time_ns <= before_ns:
            return None
        if speed_mps is None or not isfinite(speed_mps) or abs(speed_mps) > SPEED_MAX_MPS:
            return None
        self.last_ns, self._last_mps = time_ns, speed_mps
        self.way.move(time_ns, speed_mps, angle_deg)
        step_m, self._counted_m = self.distance_m - self._counted_m, self.distance_m
        if before_ns is None or not 0 < time_ns - before_ns <= GAP_NS:
            # Between two drives, at rest, a long time without data is no loss.
            is_rest = max(abs(before_mps), abs(speed_mps)) <= STANDING_MPS
            if before_ns is not None and not (is_rest and time_ns - before_ns > REST_NS):
                self.miss(time_ns - before_ns)
            self.begun_ns, self._is_doubted = time_ns, False
            self._top(time_ns, speed_mps)
            return step_m
        if abs(speed_mps - before_mps) > JUMP_MPS:
            self._is_doubted = not self._is_doubted
        elif abs(speed_mps) < STANDING_MPS:
            self._is_doubted = False
        self._top(time_ns, speed_mps)
        span_ns = time_ns - before_ns
        mean_mps = (before_mps + speed_mps) / 2
        self.known_ns += span_ns
        if abs(mean_mps) > STANDING_MPS:
            self.moving_ns += span_ns
        return step_m

    def miss(self, span_ns: int) -> None:
        """Note a time of which nothing is known."""
        self.gaps += 1
        self.gap_ns += max(0, span_ns)

    def _top(self, time_ns: int, speed_mps: float) -> None:
        if abs(speed_mps) > abs(self.top_mps) and not self._is_doubted:
            self.top_mps, self.top_ns = speed_mps, time_ns


class RecordedDrive(msgspec.Struct):
    """A time of being commanded, or of moving, behind a long rest and before another one.

    Attributes:
        log_start_ns, log_end_ns: the log times of its first and last message.
        missing_s: time in it of which nothing is known: the distance is at least ``distance_m``.
        stops: their number; ``ends`` that of the ends that were asked for.
        severity: that of the worst moment, and whether it ``is_stop``.
        worst: that in words; empty if nothing is worse than news.
        worst_ns: and when it was.
    """

    start_ns: int
    end_ns: int
    log_start_ns: int
    log_end_ns: int
    distance_m: float = 0.0
    missing_s: float = 0.0
    stops: int = 0
    ends: int = 0
    severity: Severity = Severity.INFO
    is_stop: bool = False
    worst: str = ""
    worst_ns: int = 0

    def is_near(self, time_ns: int) -> bool:
        """Report whether a time is within its margins."""
        return self.start_ns - MARGIN_NS <= time_ns <= self.end_ns + MARGIN_NS

    def take(self, entry: Entry) -> None:
        """Add an entry of its time."""
        self.stops += entry.is_stop
        self.ends += entry.kind is EntryKind.END
        if _weight(entry) > 2 * _RANKS[self.severity] + self.is_stop:
            self.severity, self.is_stop = entry.severity, entry.is_stop
            self.worst, self.worst_ns = entry.text, entry.time_ns


class Outage(msgspec.Struct, frozen=True):
    """The time from the last message of a gateway's arbiter to the first of another one; None if there is none."""

    heard_ns: int
    began_ns: int | None
    is_commanding: bool


class Drives:
    """The drives of one robot, and what happened to it.

    Attributes:
        more: drives for which there was no room.
        stops: number of stops, by cause; ``ends`` of what was asked for, by reason.
        entries: those that are kept; of a stop the reason is its cause.
        worst: the worst entry; None if nothing is worse than news.
    """

    def __init__(self) -> None:
        self.more = 0
        self.motion = SpeedMeter()
        self.stops: Counter[str] = Counter()
        self.ends: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()
        self.entries: list[Entry] = []
        self.outages: list[Outage] = []
        self.more_outages = 0
        self.worst: Entry | None = None
        self._drives: list[RecordedDrive] = []
        self._now: RecordedDrive | None = None
        self._gaps: dict[int, int] = {}
        """The newest times without a word of the arbiter: by their ends their beginnings."""
        self._cause = ""
        self._stop_at: int | None = None
        """The place of the newest stop among the entries, if there was room for it."""

    def move(self, time_ns: int, log_ns: int, speed_mps: float | None, angle_deg: float = 0.0) -> float | None:
        """Add a sample of its speed and steering. Returns as ``SpeedMeter.add`` does."""
        before_ns, gap_ns = self.motion.last_ns, self.motion.gap_ns
        step_m = self.motion.add(time_ns, speed_mps, angle_deg)
        if speed_mps is not None and abs(speed_mps) > STANDING_MPS:
            self.command(time_ns, log_ns)
        now = self._now
        if now is not None and step_m is not None and now.start_ns <= time_ns <= now.end_ns + REST_NS:
            now.distance_m += step_m
            if before_ns is not None and now.start_ns <= before_ns and time_ns <= now.end_ns:
                now.missing_s += (self.motion.gap_ns - gap_ns) / 1e9
        return step_m

    def command(self, time_ns: int, log_ns: int) -> None:
        """It was commanded, or moved, at this time."""
        now = self._now
        if now is None or not now.start_ns - REST_NS <= time_ns <= now.end_ns + REST_NS:
            now = self._now = RecordedDrive(time_ns, time_ns, log_ns, log_ns)
            if len(self._drives) < DRIVES_MAX:
                self._drives.append(now)
            else:
                self.more += 1
        now.start_ns, now.end_ns = min(now.start_ns, time_ns), max(now.end_ns, time_ns)
        now.log_start_ns, now.log_end_ns = min(now.log_start_ns, log_ns), max(now.log_end_ns, log_ns)

    def take(self, entry: Entry) -> None:
        """Add the next entry of the timeline that is about this robot, by its time."""
        if entry.kind in _IN_OTHER_TABLES:
            return
        self._keep(entry)
        self._count_stop(entry)
        if _weight(entry) > (0 if self.worst is None else _weight(self.worst)):
            self.worst = entry
        if entry.kind is EntryKind.END:
            self.ends[entry.reason.value] += 1
        elif entry.kind is EntryKind.GAP and entry.source is EntrySource.LOG and entry.last_ns > entry.time_ns:
            self._gaps[entry.last_ns] = entry.time_ns
            if len(self._gaps) > GAPS_MAX:
                del self._gaps[next(iter(self._gaps))]
        elif _is_restart(entry):
            heard_ns = self._gaps.pop(entry.time_ns, entry.time_ns)
            self.fall_silent(Outage(heard_ns, entry.time_ns, entry.severity is Severity.ERROR))
        for one in reversed(self._drives):
            if one.is_near(entry.time_ns):
                one.take(entry)
                return

    def fall_silent(self, outage: Outage) -> None:
        """The gateway fell silent."""
        if len(self.outages) < GAPS_MAX:
            self.outages.append(outage)
        else:
            self.more_outages += 1

    @property
    def now(self) -> RecordedDrive | None:
        """The newest drive."""
        return self._now

    @property
    def more_entries(self) -> int:
        """Number of entries for which there was no room."""
        return self.counts.total() - len(self.entries)

    def drives(self) -> list[RecordedDrive]:
        """The drives, by time."""
        return sorted(self._drives, key=lambda one: one.start_ns)

    def _keep(self, entry: Entry) -> None:
        self.counts[entry.kind.value] += 1
        room = ENTRIES_MAX + (ERRORS_MAX if entry.severity is Severity.ERROR else 0)
        if len(self.entries) < room:
            self.entries.append(entry)

    def _count_stop(self, entry: Entry) -> None:
        """Count a stop by its cause; of a gateway that died the next one may say it."""
        if entry.is_stop:
            self._cause = DIED if entry.reason is Reason.NONE else entry.reason.value
            self._stop_at = len(self.entries) - 1 if self.entries[-1:] == [entry] else None
            self.stops[self._cause] += 1
        elif entry.kind is EntryKind.ENGAGED:
            self._cause = ""
        elif entry.kind is EntryKind.LATCH and self._cause == DIED:
            self.stops[DIED] -= 1
            self._cause = entry.reason.value
            self.stops[self._cause] += 1
            if self._stop_at is not None:
                stop = self.entries[self._stop_at]
                self.entries[self._stop_at] = msgspec.structs.replace(stop, reason=entry.reason)


def _weight(entry: Entry) -> int:
    """Weigh an entry: a stop is worse than what is as grave."""
    return 2 * _RANKS[entry.severity] + entry.is_stop


def _is_restart(entry: Entry) -> bool:
    """Report whether another gateway began, and the one before did not shut down by request."""
    is_grave = entry.severity is not Severity.INFO
    return entry.kind is EntryKind.GATEWAY and is_grave and entry.source is not EntrySource.RECORDER
