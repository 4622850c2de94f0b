"""The drives of a robot: distances, stops, ends and the worst moment, from its samples and entries. Pure.

Report, catalog and searches share these figures. Memory does not grow with a log.
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

REST_NS: Final = 600_000_000_000  # a shorter rest belongs to the drive

MARGIN_NS: Final = 10_000_000_000
"""The time before and after a drive that belongs to it: what led to it, and how its stop ended."""

DRIVES_MAX: Final = 500  # limit of drives that are listed; others are only counted

CLOCK_STEP_NS: Final = 600_000_000_000
"""A time that goes back further is a step of the clock; one that goes back less, a repeated sample."""

MOVING_MPS: Final = 0.02  # a lower speed counts as no motion in distances and times of a drive
JUMP_MPS: Final = 0.5  # a larger change from one sample to the next is a wrong scale or frame, not motion

SPEED_MAX_MPS: Final = 100.0

DIED: Final = "gateway_died"  # the cause of a stop without a known reason

BY_OPERATORS: Final = frozenset(
    {Reason.REMOTE_STOP.value, Reason.HAND_TRANSMITTER.value, Reason.LEASE_TAKEN.value}
)
"""Causes of stops by operators; all others are faults."""

ENTRIES_MAX: Final = 2000
ERRORS_MAX: Final = 500  # errors kept beyond these: a thousand leases must not hide a gateway that died

GAPS_MAX: Final = 200

_RANKS: Final = {Severity.INFO: 0, Severity.WARNING: 1, Severity.ERROR: 2}
_IN_OTHER_TABLES: Final = frozenset({EntryKind.REFUSAL, EntryKind.REQUEST})


def operators_stops(stops: Mapping[str, int]) -> int:
    return sum(count for cause, count in stops.items() if cause in BY_OPERATORS)


class RecordedWay(DeadReckoning):
    """The robot's path since the first sample: by its own odometry, or by its speeds if the log has none."""

    def __init__(self) -> None:
        super().__init__(CHASSIS.wheelbase_m)
        self._said: Odometry | None = None
        self._said_ns = 0

    def follow(self, said: Odometry, time_ns: int) -> None:
        """Move as the robot's odometry did since its last sample; a restart or a reset continues from here."""
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
        """Move to a sample of ``state``, unless the odometry covers this time."""
        if self._said is None or abs(time_ns - self._said_ns) > GAP_NS:
            super().move(time_ns, speed_mps, angle_deg)


class SpeedMeter:
    """Measures speed and distance from samples that may repeat, come out of order or be missing.

    Attributes:
        moving_ns: time above MOVING_MPS, of ``known_ns`` with known speed.
        top_mps: the highest plausible speed, negative in reverse, at ``top_ns``.
        gaps: times without data for longer than GAP_NS, except long rests; ``gap_ns`` in all.
        begun_ns: the first sample after the newest gap.
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
        return self.way.distance_m

    def add(self, time_ns: int, speed_mps: float | None, angle_deg: float = 0.0) -> float | None:
        """Add a sample. Returns the distance since the one before in metres; None if it does not count."""
        before_ns, before_mps = self.last_ns, self._last_mps
        if before_ns is not None and before_ns - CLOCK_STEP_NS < time_ns <= before_ns:
            return None
        if speed_mps is None or not isfinite(speed_mps) or abs(speed_mps) > SPEED_MAX_MPS:
            return None
        self.last_ns, self._last_mps = time_ns, speed_mps
        self.way.move(time_ns, speed_mps, angle_deg)
        step_m, self._counted_m = self.distance_m - self._counted_m, self.distance_m
        if before_ns is None or not 0 < time_ns - before_ns <= GAP_NS:
            # A long time without data at rest, between two drives, is no loss.
            is_rest = max(abs(before_mps), abs(speed_mps)) <= MOVING_MPS
            if before_ns is not None and not (is_rest and time_ns - before_ns > REST_NS):
                self.miss(time_ns - before_ns)
            self.begun_ns, self._is_doubted = time_ns, False
            self._top(time_ns, speed_mps)
            return step_m
        if abs(speed_mps - before_mps) > JUMP_MPS:
            self._is_doubted = not self._is_doubted
        elif abs(speed_mps) < MOVING_MPS:
            self._is_doubted = False
        self._top(time_ns, speed_mps)
        span_ns = time_ns - before_ns
        mean_mps = (before_mps + speed_mps) / 2
        self.known_ns += span_ns
        if abs(mean_mps) > MOVING_MPS:
            self.moving_ns += span_ns
        return step_m

    def miss(self, span_ns: int) -> None:
        self.gaps += 1
        self.gap_ns += max(0, span_ns)

    def _top(self, time_ns: int, speed_mps: float) -> None:
        if abs(speed_mps) > abs(self.top_mps) and not self._is_doubted:
            self.top_mps, self.top_ns = speed_mps, time_ns


class RecordedDrive(msgspec.Struct):
    """A time of being commanded or moving, between two long rests.

    Attributes:
        log_start_ns, log_end_ns: the log times of its first and last message.
        missing_s: time without data: the distance is at least ``distance_m``.
        ends: number of requested ends.
        severity, is_stop, worst, worst_ns: the worst moment; ``worst`` is empty if there is only information.
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
        return self.start_ns - MARGIN_NS <= time_ns <= self.end_ns + MARGIN_NS

    def take(self, entry: Entry) -> None:
        self.stops += entry.is_stop
        self.ends += entry.kind is EntryKind.END
        if _weight(entry) > 2 * _RANKS[self.severity] + self.is_stop:
            self.severity, self.is_stop = entry.severity, entry.is_stop
            self.worst, self.worst_ns = entry.text, entry.time_ns


class Outage(msgspec.Struct, frozen=True):
    """The time from the last state of a gateway to the first of the next one; None if there is none."""

    heard_ns: int
    began_ns: int | None
    is_commanding: bool


class Drives:
    """The drives of one robot, and what happened to it.

    Attributes:
        more: number of drives beyond ``DRIVES_MAX``.
        now: the newest drive.
        stops: number of stops by cause; ``ends``, of requested ends by reason.
        entries: the first ones; the reason of a stop is its cause.
        worst: the worst entry; None if there is only information.
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
        self.now: RecordedDrive | None = None
        self._gaps: dict[int, int] = {}  # the starts of the newest gaps in the states, by their ends
        self._cause = ""
        self._stop_at: int | None = None  # the newest stop's place among the entries, if it was kept

    def move(self, time_ns: int, log_ns: int, speed_mps: float | None, angle_deg: float = 0.0) -> float | None:
        """Add a sample of speed and steering. Returns the same as ``SpeedMeter.add``."""
        before_ns, gap_ns = self.motion.last_ns, self.motion.gap_ns
        step_m = self.motion.add(time_ns, speed_mps, angle_deg)
        if speed_mps is not None and abs(speed_mps) > MOVING_MPS:
            self.command(time_ns, log_ns)
        now = self.now
        if now is not None and step_m is not None and now.start_ns <= time_ns <= now.end_ns + REST_NS:
            now.distance_m += step_m
            if before_ns is not None and now.start_ns <= before_ns and time_ns <= now.end_ns:
                now.missing_s += (self.motion.gap_ns - gap_ns) / 1e9
        return step_m

    def command(self, time_ns: int, log_ns: int) -> None:
        now = self.now
        if now is None or not now.start_ns - REST_NS <= time_ns <= now.end_ns + REST_NS:
            now = self.now = RecordedDrive(time_ns, time_ns, log_ns, log_ns)
            if len(self._drives) < DRIVES_MAX:
                self._drives.append(now)
            else:
                self.more += 1
        now.start_ns, now.end_ns = min(now.start_ns, time_ns), max(now.end_ns, time_ns)
        now.log_start_ns, now.log_end_ns = min(now.log_start_ns, log_ns), max(now.log_end_ns, log_ns)

    def take(self, entry: Entry) -> None:
        """Add the robot's next entry, by time."""
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
        if len(self.outages) < GAPS_MAX:
            self.outages.append(outage)
        else:
            self.more_outages += 1

    @property
    def more_entries(self) -> int:
        return self.counts.total() - len(self.entries)

    def drives(self) -> list[RecordedDrive]:
        return sorted(self._drives, key=lambda one: one.start_ns)

    def _keep(self, entry: Entry) -> None:
        self.counts[entry.kind.value] += 1
        room = ENTRIES_MAX + (ERRORS_MAX if entry.severity is Severity.ERROR else 0)
        if len(self.entries) < room:
            self.entries.append(entry)

    def _count_stop(self, entry: Entry) -> None:
        """Count a stop by its cause, which the next gateway may report if this one died."""
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
    """The weight of an entry; a stop counts more than another of its severity."""
    return 2 * _RANKS[entry.severity] + entry.is_stop


def _is_restart(entry: Entry) -> bool:
    """True if the gateway restarted without a requested shutdown."""
    is_grave = entry.severity is not Severity.INFO
    return entry.kind is EntryKind.GATEWAY and is_grave and entry.source is not EntrySource.RECORDER
