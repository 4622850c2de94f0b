"""The findings of a report as data and in words; charts are reduced while samples stream in.

Times are nanoseconds since 1970, by the robot's clock. Names and texts from a log may hold anything.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from math import cos, degrees, hypot, isfinite, pi, radians, remainder, sin, tau
from operator import itemgetter
from typing import Final

import msgspec

from gateway.chassis.odometry import GAP_NS
from recorder.reading.times import in_words
from recorder.record.accounting import KeyReport, total
from recorder.review.drives import DIED, Outage, RecordedDrive, operators_stops
from recorder.review.entries import Entry, EntryKind
from recorder.review.window import counted
from schemas.decisions import ArbiterState, SafetyState
from schemas.messages import Mode, RobotState
from schemas.reasons import TEXTS

BUCKETS_MAX: Final = 1500  # more than a chart is wide in pixels

BREAKS_MAX: Final = 1000
SPANS_MAX: Final = 600
PLACES_MAX: Final = 4000

LINES: Final = (
    "speed_limit_mps",
    "target_speed_mps",
    "output_speed_mps",
    "speed_mps",
    "steering_limit_deg",
    "target_angle_deg",
    "output_angle_deg",
    "angle_deg",
)
"""Values drawn over time, in the order of ``page.js``."""

BANDS: Final = ("mode", "arbiter", "lease")  # the chassis's mode, the arbiter's state, and the holder of the lease

TARGETS: Final = frozenset({"target_speed_mps", "target_angle_deg"})
"""Requested values. States repeat them; they hold only while the arbiter is engaged."""

_OUTPUTS: Final = ("target_speed_mps", "output_speed_mps", "target_angle_deg", "output_angle_deg")
_FIRST_STEP_M: Final = 0.01
_FIRST_TURN_RAD: Final = radians(2)

Point = tuple[int, float]
"""Time in nanoseconds, and value."""

Pose = tuple[float, float, float]
"""x and y in metres, and the heading in radians."""


class Span(msgspec.Struct, frozen=True):
    """A value and its time."""

    start_ns: int
    end_ns: int
    value: str


class Place(msgspec.Struct, frozen=True):
    """A position: forward (x) and left (y) of the first pose; with ``begins`` a piece of the path begins."""

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
        self.path = DrivenPath()

    def bound(self, share: float) -> None:
        """Limit the charts to this share of the usual points."""
        for line in self.lines.values():
            line.limit = round(BUCKETS_MAX * share)
        self.path.limit = round(PLACES_MAX * share)

    def add_state(self, time_ns: int, state: RobotState, pose: Pose | None, *, begins: bool) -> None:
        if pose is not None:
            self.path.add(time_ns, pose, begins=begins)
        self._draw("speed_mps", time_ns, state.speed_mps)
        self._draw("angle_deg", time_ns, state.angle_deg)
        self.bands["mode"].add(time_ns, "" if state.mode is Mode.UNDEFINED else state.mode.value)

    def add_arbiter(self, time_ns: int, state: SafetyState) -> None:
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

    Each bucket of time keeps its first, lowest, highest and last sample, so that no spike is lost.
    """

    def __init__(self, limit: int = BUCKETS_MAX) -> None:
        self.limit = limit
        self._points: list[Point] = []
        self._breaks: list[int] = []
        self._last_ns: int | None = None

    def add(self, time_ns: int, value: float) -> None:
        if self._last_ns is not None and time_ns - self._last_ns > GAP_NS:
            self.cut()
        self._last_ns = time_ns
        self._points.append((time_ns, value))
        if len(self._points) > 6 * self.limit:
            self._reduce()

    def cut(self) -> None:
        """Break the line: the value is not known until the next sample."""
        if self._last_ns is not None and len(self._breaks) < BREAKS_MAX:
            self._breaks.append(self._last_ns)
        self._last_ns = None

    def points(self, from_ns: int = 0, to_ns: int = 2**64) -> Iterator[Point | None]:
        """Yield the line by time, None at each break."""
        self._reduce()
        breaks, is_begun = sorted(self._breaks, reverse=True), False
        for point in self._points:
            if from_ns <= point[0] <= to_ns:
                if is_begun and breaks and breaks[-1] < point[0]:
                    yield None
                yield point
                is_begun = True
            while breaks and breaks[-1] < point[0]:
                breaks.pop()

    def _reduce(self) -> None:
        self._points = sorted(set(self._points))
        if len(self._points) <= self.limit:
            return
        first_ns = self._points[0][0]
        width_ns = (self._points[-1][0] - first_ns) // self.limit + 1
        kept: list[Point] = []
        for _, points in groupby(self._points, key=lambda point: (point[0] - first_ns) // width_ns):
            bucket = list(points)
            by_value = sorted(bucket, key=itemgetter(1))
            kept += sorted({bucket[0], by_value[0], by_value[-1], bucket[-1]})
        self._points = kept


class Spans:
    """One band of a chart: values and their times. Late samples are ignored."""

    def __init__(self) -> None:
        self._spans: list[Span] = []
        self._start_ns = self._last_ns = 0
        self._value: str | None = None

    def add(self, time_ns: int, value: str) -> None:
        if self._value is not None and time_ns < self._last_ns:
            return
        is_silent = self._value is not None and time_ns - self._last_ns > GAP_NS
        if value != self._value or is_silent:
            self._end(self._last_ns if is_silent else time_ns)
            self._value, self._start_ns = value, time_ns
        self._last_ns = time_ns

    def spans(self) -> list[Span]:
        """The spans so far, at most SPANS_MAX, without empty values."""
        now = [] if self._value is None else [Span(self._start_ns, self._last_ns, self._value)]
        return [span for span in [*self._spans, *now] if span.value]

    def _end(self, time_ns: int) -> None:
        if self._value is not None and time_ns > self._start_ns and len(self._spans) < SPANS_MAX:
            self._spans.append(Span(self._start_ns, time_ns, self._value))


class DrivenPath:
    """A path from zero, reduced to what is worth drawing, with breaks where samples are missing."""

    def __init__(self) -> None:
        self.limit = PLACES_MAX
        self._step_m, self._turn_rad = _FIRST_STEP_M, _FIRST_TURN_RAD
        self._places: list[Place] = []
        self._first: Pose | None = None
        self._last: Place | None = None

    def add(self, time_ns: int, pose: Pose, *, begins: bool) -> None:
        if self._first is None:
            self._first = pose
        (x_m, y_m, heading_rad), (first_x_m, first_y_m, first_rad) = pose, self._first
        x_m, y_m = x_m - first_x_m, y_m - first_y_m
        x_m, y_m = x_m * cos(first_rad) + y_m * sin(first_rad), y_m * cos(first_rad) - x_m * sin(first_rad)
        heading_rad = remainder(heading_rad - first_rad, tau)
        last = self._places[-1] if self._places else None
        begins |= last is None
        now = self._last = Place(time_ns, x_m, y_m, degrees(heading_rad), begins)
        if (
            begins
            or last is None
            or abs(remainder(heading_rad - radians(last.heading_deg), tau)) >= self._turn_rad
            or hypot(x_m - last.x_m, y_m - last.y_m) >= self._step_m
        ):
            self._keep(now)

    def places(self) -> list[Place]:
        if self._last is None or self._places[-1] is self._last:
            return self._places
        return [*self._places, self._last]

    def _keep(self, place: Place) -> None:
        self._places.append(place)
        if len(self._places) > self.limit:
            self._step_m *= 2
            self._turn_rad = min(2 * self._turn_rad, pi / 8)
            begun = [number for number, place in enumerate(self._places) if place.begins]
            # The starts of pieces stay, unless the log is full of gaps.
            kept = set(range(0, len(self._places), 2)) | set(begun[: self.limit // 4]) | {len(self._places) - 1}
            self._places = [self._places[number] for number in sorted(kept)]


class Why(msgspec.Struct, frozen=True):
    """The answer of ``why`` to a stop; a link is time since the stop, time of day, step and sentence."""

    headline: str
    links: list[tuple[str, str, str, str]]


class InForce(msgspec.Struct, frozen=True):
    """A gateway, in force until the next one."""

    since_ns: int
    variant: str
    configuration_sha256: str
    versions: dict[str, str]


class Driver(msgspec.Struct, frozen=True):
    """An operator who drove the robot, for how long and how far."""

    name: str
    seconds: float
    distance_m: float


class Refusal(msgspec.Struct, frozen=True):
    """The refused requests of one verb, operator and reason."""

    request: str
    operator: str
    reason: str
    count: int
    first_ns: int
    last_ns: int


class RobotSummary(msgspec.Struct, frozen=True):
    """A robot in figures.

    Attributes:
        key: the start of its keys.
        distance_m: the length of its path; a lower bound if ``gap_s`` is not 0.
        moving_s: of ``known_s`` with known speed.
        top_mps: negative in reverse.
        ends: number of requested ends by reason.
        ends_commanding: the recording ends while the robot is commanded.
        events: their number by kind.
        gaps: number of gaps in its motion; ``gap_s`` in all.
        lost_samples, lost_frames: by the recorder's account; None without one.
    """

    name: str
    key: str
    start_ns: int
    end_ns: int
    distance_m: float
    moving_s: float
    known_s: float
    top_mps: float
    top_ns: int
    stops: dict[str, int]
    ends: dict[str, int]
    worst: Entry | None
    outages: list[Outage]
    more_outages: int
    ends_commanding: bool
    events: dict[str, int]
    drivers: list[Driver]
    accepted: int
    refused: int
    refusals: list[Refusal]
    other_refusals: int
    gaps: int
    gap_s: float
    lost_samples: int | None
    lost_frames: int | None
    completeness: dict[str, KeyReport]
    in_force: list[InForce]
    more_in_force: int


class Drawn(msgspec.Struct, frozen=True):
    """The charts of a drive, or of a robot without one; lines have None at each break."""

    start_ns: int
    end_ns: int
    drive: RecordedDrive | None
    lines: dict[str, list[Point | None]]
    bands: dict[str, list[Span]]
    places: list[Place]
    moments: list[Entry]
    outages: list[tuple[int, int]]


class RobotReport(msgspec.Struct, frozen=True):
    """A robot; ``drawn`` are its newest drives, or the standing robot."""

    summary: RobotSummary
    moments: list[Entry]
    more_moments: int
    drives: list[RecordedDrive]
    more_drives: int
    drawn: list[Drawn]


class ReportedFile(msgspec.Struct, frozen=True):
    """A source file; ``is_accounted``: it has the recorder's account of losses."""

    name: str
    bytes: int
    start_ns: int
    end_ns: int
    is_accounted: bool
    is_being_written: bool


class Report(msgspec.Struct, frozen=True):
    """A report on the log times from ``from_ns`` to ``to_ns``, None without an end."""

    files: list[ReportedFile]
    from_ns: int
    to_ns: int | None
    robots: list[RobotReport]
    more_robots: int
    faults: list[str]
    fault_count: int
    version: str

    @property
    def drawn(self) -> list[tuple[RobotSummary, Drawn]]:
        return [(robot.summary, one) for robot in self.robots for one in robot.drawn]


STANDING_M: Final = 0.05  # a shorter path is the noise of a standing robot
SHOWN: Final = 8  # limit of items in a line; tables show all

ABSENT: Final = "not in the log"

Line = tuple[str, str]
"""A name and its text."""

_WORDS: Final = {reason.value: text.means for reason, text in TEXTS.items()} | {DIED: "the gateway died"}

_LOSSES: Final = {
    "lost_bus": "frames between chassis and gateway",
    "lost_source": "frames dropped by the gateway",
    "lost_link": "samples on the way to the recorder",
    "lost_queue": "samples dropped by the recorder",
    "lost_size": "samples too large to be recorded",
    "lost_full": "messages while the disk was full",
    "lost_disk": "messages not stored by the disk",
}


def verdict(robot: RobotReport) -> str:
    """The robot in a sentence: drives, distance, stops by cause, normal ends, losses."""
    summary = robot.summary
    drives = len(robot.drives) + robot.more_drives
    said = [f"{counted(drives, 'drive') if drives else 'no drive'}, {distance(summary)}", stops_by(summary.stops)]
    ends = sum(summary.ends.values())
    if ends:
        said.append(counted(ends, "normal end"))
    losses = ((summary.lost_samples, "sample"), (summary.lost_frames, "frame"))
    said += [f"{counted(count, noun)} lost" for count, noun in losses if count]
    if summary.ends_commanding:
        said.append("recording ends while the robot is commanded")
    return "; ".join(said) + "."


def distance(robot: RobotSummary) -> str:
    """The distance in words, as a lower bound if states are missing."""
    if not robot.known_s:
        return f"distance {ABSENT}"
    said = "0 m" if robot.distance_m < STANDING_M else metres(robot.distance_m)
    return f"at least {said} ({duration(robot.gap_s)} not recorded)" if robot.gaps else said


def drive_distance(robot: RobotSummary, drive: RecordedDrive) -> str:
    if not robot.known_s:
        return "-"
    return f"{'at least ' if drive.missing_s else ''}{metres(drive.distance_m)}"


def stops_by(stops: Mapping[str, int]) -> str:
    """Stops in words: the number of faults and of operators' stops, with the causes."""
    count, by_operators = sum(stops.values()), operators_stops(stops)
    if not count:
        return "no stops"
    if count == 1:
        return f"1 stop{' by an operator' if by_operators else ''}: {''.join(map(reason_words, stops))}"
    kinds = [
        *([counted(count - by_operators, "fault")] if count > by_operators else []),
        *([f"{by_operators} by operators"] if by_operators else []),
    ]
    causes = joined((f"{number} x {reason_words(cause)}" for cause, number in stops.items()), ", ")
    return f"{count} stops ({', '.join(kinds)}): {causes}"


def summary_lines(robot: RobotReport, report: Report) -> list[Line]:
    summary, worst = robot.summary, robot.summary.worst
    start_ns, end_ns = summary.start_ns, summary.end_ns
    return [
        ("When", f"{in_words(start_ns)} to {in_words(end_ns)}: {duration((end_ns - start_ns) / 1e9)}"),
        ("Distance", _distance(summary)),
        ("Worst moment", "none" if worst is None else f"{in_words(worst.time_ns)}: {moment_words(worst)}"),
        ("Gateway", joined(map(_outage, summary.outages)) or "no outage"),
        (
            "Driven by",
            joined(f"{one.name} {duration(one.seconds)}, {metres(one.distance_m)}" for one in summary.drivers)
            or ABSENT,
        ),
        ("Refused", _refused(summary)),
        ("Lost", joined(_missing(summary, report)) or "nothing"),
        ("Versions", _versions(summary)),
    ]


def _distance(robot: RobotSummary) -> str:
    if not robot.known_s:
        return ABSENT
    top = f"{abs(robot.top_mps):.2f} m/s{' in reverse' if robot.top_mps < 0 else ''} at {in_words(robot.top_ns)}"
    return f"{distance(robot)}, moving {duration(robot.moving_s)} of {duration(robot.known_s)}; top speed {top}"


def _outage(outage: Outage) -> str:
    commanding = " while commanding" if outage.is_commanding else ""
    if outage.began_ns is None:
        return f"silent from {in_words(outage.heard_ns)} to the end{commanding}"
    if outage.began_ns <= outage.heard_ns:
        return f"restarted at {in_words(outage.heard_ns)}{commanding}"
    silent_s = (outage.began_ns - outage.heard_ns) / 1e9
    return f"silent for {duration(silent_s)} from {in_words(outage.heard_ns)}{commanding}, then restarted"


def _refused(robot: RobotSummary) -> str:
    if not robot.refused:
        return f"none of {counted(robot.accepted, 'request')}"
    told = joined(
        f"{one.count} x {one.request} from {one.operator or 'no operator'}: {reason_words(one.reason)}"
        for one in robot.refusals
    )
    return f"{robot.refused} of {robot.accepted + robot.refused} requests: {told}"


def _missing(robot: RobotSummary, report: Report) -> list[str]:
    said = []
    if robot.gaps:
        said.append(f"{duration(robot.gap_s)} of motion in {counted(robot.gaps, 'gap')}")
    sums = total(robot.completeness.values())
    said += [f"{getattr(sums, name)} {what}" for name, what in _LOSSES.items() if getattr(sums, name)]
    bare = [file.name for file in report.files if not file.is_accounted]
    if bare:
        said.append(f"unknown for {joined(bare, ', ')} (no account of losses)")
    elif not robot.completeness:
        said.append("unknown (no account of losses)")
    return said


def _versions(robot: RobotSummary) -> str:
    """The versions of the first gateway, and the number of later ones."""
    said = []
    for first in robot.in_force[:1]:
        packages = (f"{package} {value}" for package, value in sorted(first.versions.items()))
        configuration = f"configuration {first.configuration_sha256[:12] or ABSENT}"
        said = [f"variant {first.variant}", *packages, configuration]
    if len(robot.in_force) > 1:
        said.append(f"{counted(len(robot.in_force) - 1, 'later gateway')}, see below")
    return ", ".join(said) or ABSENT


def moment_words(moment: Entry) -> str:
    """The text of an event, with its count; the text of a gap has its own."""
    if moment.count <= 1 or moment.kind is EntryKind.GAP:
        return moment.text
    lasted_s = (moment.last_ns - moment.time_ns) / 1e9
    return f"{moment.text} [{moment.count} times{f' within {duration(lasted_s)}' if lasted_s >= 0.05 else ''}]"


def who(moment: Entry) -> str:
    """The operator, or in parentheses the holder of the lease."""
    return moment.operator or (f"({moment.holder})" if moment.holder else "")


def reason_words(reason: str) -> str:
    return _WORDS.get(reason, reason)


def duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def metres(length_m: float) -> str:
    return f"{length_m / 1000:.2f} km" if length_m >= 10_000 else f"{length_m:.1f} m"


def size(count: int) -> str:
    for factor, unit in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if count >= factor:
            return f"{count / factor:.1f} {unit}"
    return f"{count} bytes"


def is_lossy(report: KeyReport) -> bool:
    """True if anything of a topic was lost, on either side of the recorder."""
    return bool(report.lost or report.lost_bus or report.lost_source)


def iso(time_ns: int) -> str:
    """A time in ISO 8601, with the precision that browsers know."""
    return in_words(time_ns).removesuffix(" UTC").replace(" ", "T") + "Z"


def joined(parts: Iterable[str], between: str = "; ") -> str:
    """The first parts, and the number of the others."""
    found = list(parts)
    more = [f"and {len(found) - SHOWN} more"] if len(found) > SHOWN else []
    return between.join([*found[:SHOWN], *more])
