"""One robot's part of a report, from its messages one by one; memory does not grow with their number."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import isfinite
from typing import Final

import msgspec

from gateway.chassis.odometry import GAP_NS
from recorder.record.accounting import KeyReport
from recorder.review.drives import MARGIN_NS, REST_NS, Drives, Outage, RecordedDrive
from recorder.review.entries import Entry, Repeats, RobotClock
from recorder.review.events import LogEnding
from recorder.review.report.findings import (
    Charts,
    Drawn,
    Driver,
    InForce,
    Pose,
    Refusal,
    RobotReport,
    RobotSummary,
)
from schemas.decisions import COMMANDING, ArbiterState, Decision, SafetyEvent, SafetyState, Verdict
from schemas.messages import GatewayHealth, GatewayInfo, Message, Mode, Odometry, RobotState, Variant

MOST: Final = 200  # limit of gateways and configurations

UNKNOWN: Final = Variant.UNKNOWN.value
_PACKAGE: Final = "versions."


class Versions:
    """Gathers what gateways and recorders say of versions and configurations, in any order."""

    def __init__(self) -> None:
        self._told: dict[tuple[int, str], InForce] = {}
        self.left_out = 0

    def hear(self, info: GatewayInfo) -> None:
        self._add(InForce(info.started_ns, info.variant.value, info.configuration_sha256, dict(info.versions)))

    def read(self, facts: Mapping[str, str]) -> None:
        packages = {name.removeprefix(_PACKAGE): one for name, one in facts.items() if name.startswith(_PACKAGE)}
        with suppress(ValueError):
            started_ns = int(facts.get("started_ns", ""))
            sha256 = facts.get("configuration_sha256", "")
            if 0 <= started_ns < 2**63:
                self._add(InForce(started_ns, facts.get("variant", UNKNOWN), sha256, packages))

    def _add(self, told: InForce) -> None:
        known = self._told.get((told.since_ns, told.configuration_sha256))
        if known is None and len(self._told) >= MOST:
            self.left_out += 1
        elif known is None or known.variant == UNKNOWN:
            self._told[told.since_ns, told.configuration_sha256] = told

    def in_force(self, offset_ns: int = 0, from_ns: int = 0, to_ns: int = 2**64) -> list[InForce]:
        """The gateways that were in force in this time, by their start."""
        told = sorted(self._told.values(), key=lambda one: one.since_ns)
        dated = [msgspec.structs.replace(one, since_ns=max(0, one.since_ns + offset_ns)) for one in told]
        ends_ns = [one.since_ns for one in dated[1:]] + [2**64]
        pairs = zip(dated, ends_ns, strict=False)
        return [one for one, end_ns in pairs if one.since_ns < to_ns and end_ns > from_ns]


REMOTE_CONTROL: Final = "the remote control (RC)"
OTHERS: Final = "(others)"

REFUSALS_MAX: Final = 200
DRIVERS_MAX: Final = 200

DRAWN_MAX: Final = 30  # limit of drives that are drawn, the newest ones; the others get a command
WHOLE_SHARES: Final = 4  # so many drives are drawn in full resolution; more share the same number of points
REMEMBERED: Final = 4096  # messages of a subject that are recognised when they come a second time
CLOCK_TRUST_NS: Final = 24 * 3600 * 1_000_000_000  # a time further from its receipt is not used

CLOCKS_APART_NS: Final = 2_000_000_000
"""The largest difference of the robot's clock and the recorder's that is not corrected."""

_ANGLE_MAX_DEG: Final = 80.0  # the chassis steers to 24 deg; a value beyond sense must not end the path

TAKEN: Final[frozenset[type[msgspec.Struct]]] = frozenset(
    {RobotState, Odometry, SafetyState, SafetyEvent, Decision, GatewayHealth}
)
"""Classes of messages that an account takes."""

_Sample = tuple[int, RobotState | SafetyState, Pose | None, bool]
"""Time, message, the robot's pose if known, and whether a piece of the path begins with it."""


class Account:
    """Gathers one robot's part.

    Messages from before ``begins_ns``, which a recorder queried afterwards, are left out.
    """

    def __init__(self, name: str, key: str, versions: Versions | None = None, begins_ns: int = 0) -> None:
        self.name = name
        self.key = key
        self.versions = Versions() if versions is None else versions
        self.drives = Drives()
        self._begins_ns = begins_ns - CLOCKS_APART_NS
        self._start_ns, self._end_ns = 2**64, 0
        self._clock = RobotClock()
        self._charts: deque[tuple[RecordedDrive | None, Charts]] = deque([(None, Charts())], DRAWN_MAX)
        self._lead: deque[_Sample] = deque()
        """The newest samples, which are drawn before the drive that they lead to."""
        self._seen: dict[type[Message], Repeats] = {}
        self._held_by = ""
        self._state_ns = 0
        self._driven: dict[str, list[float]] = {}
        self._ends_commanding = False
        self._verdicts: Counter[Verdict] = Counter()
        self._refusals: dict[tuple[str, str, str], list[int]] = {}

    def take(self, message: Message, publish_ns: int, log_ns: int) -> bool:
        """Take the next message of a kind in TAKEN. Returns False if it is a repeated one."""
        seen = self._seen.get(type(message))
        if seen is None:
            seen = self._seen[type(message)] = Repeats(REMEMBERED)
        if not seen.is_new(message.time_ns, message.sequence):
            return False
        time_ns = self._place(message, publish_ns, log_ns)
        if time_ns < self._begins_ns:
            return True
        self._start_ns, self._end_ns = min(self._start_ns, time_ns), max(self._end_ns, time_ns)
        match message:
            case RobotState():
                self._take_state(message, time_ns, log_ns)
            case Odometry():
                self.drives.motion.way.follow(message, time_ns)
            case SafetyState():
                self._held_by = message.lease_holder if message.state is ArbiterState.ENGAGED else ""
                if message.state in COMMANDING:
                    self.drives.command(time_ns, log_ns)
                self._draw((time_ns, message, None, False))
            case Decision():
                self._take_decision(message, time_ns)
            case _:
                pass
        return True

    def _place(self, message: Message, publish_ns: int, log_ns: int) -> int:
        tick: int | None = None
        if isinstance(message, SafetyState):
            self._clock.hear(message.tick, publish_ns, log_ns)
        if isinstance(message, SafetyState | SafetyEvent | Decision):
            tick = message.tick
        time_ns = self._clock.place(publish_ns, log_ns, tick)
        return time_ns if abs(time_ns - log_ns) < CLOCK_TRUST_NS else log_ns

    def take_entry(self, entry: Entry) -> None:
        if entry.last_ns >= self._begins_ns:
            self.drives.take(entry)

    def end(self, found: LogEnding) -> None:
        """The logs end while the robot is commanded, or after the gateway went silent."""
        if found.is_silent:
            self.drives.fall_silent(Outage(found.entry.time_ns, None, found.is_commanding))
        else:
            self._ends_commanding = True

    def miss(self, from_ns: int | None, to_ns: int | None) -> None:
        """Note what is missing at the start and the end of the requested time."""
        motion = self.drives.motion
        if from_ns is not None and motion.last_ns is not None and self._start_ns - from_ns > CLOCKS_APART_NS:
            motion.miss(self._start_ns - from_ns)
        if to_ns is not None and motion.last_ns is not None and to_ns - motion.last_ns > GAP_NS:
            motion.miss(to_ns - motion.last_ns)

    def sum_up(
        self, completeness: dict[str, KeyReport], from_ns: int = 0, to_ns: int = 2**64
    ) -> RobotReport | None:
        if not self._end_ns:
            return None
        found, motion = self.drives, self.drives.motion
        drivers = [Driver(name, seconds, metres) for name, (seconds, metres) in self._driven.items()]
        refusals = [Refusal(*about, *counted) for about, counted in self._refusals.items()]
        refused = self._verdicts[Verdict.REFUSED]
        worst = found.worst
        accounts = completeness.values()
        summary = RobotSummary(
            name=self.name,
            key=self.key,
            start_ns=self._start_ns,
            end_ns=self._end_ns,
            distance_m=motion.distance_m,
            moving_s=motion.moving_ns / 1e9,
            known_s=motion.known_ns / 1e9,
            top_mps=motion.top_mps,
            top_ns=motion.top_ns,
            stops={cause: count for cause, count in found.stops.most_common() if count},
            ends=dict(found.ends.most_common()),
            worst=None if worst is None else self._near(worst),
            outages=found.outages,
            more_outages=found.more_outages,
            ends_commanding=self._ends_commanding,
            events=dict(found.counts.most_common()),
            drivers=sorted(drivers, key=lambda one: -one.seconds),
            accepted=self._verdicts[Verdict.ACCEPTED],
            refused=refused,
            refusals=sorted(refusals, key=lambda one: -one.count),
            other_refusals=refused - sum(one.count for one in refusals),
            gaps=motion.gaps,
            gap_s=motion.gap_ns / 1e9,
            lost_samples=sum(one.lost for one in accounts) if accounts else None,
            lost_frames=sum((one.lost_bus or 0) + one.lost_source for one in accounts) if accounts else None,
            completeness=completeness,
            in_force=self.versions.in_force(self._clock.offset_ns, from_ns, to_ns),
            more_in_force=self.versions.left_out,
        )
        moments = sorted(map(self._near, found.entries), key=lambda one: one.time_ns)
        return RobotReport(summary, moments, found.more_entries, found.drives(), found.more, self._drawn(moments))

    def _near(self, entry: Entry) -> Entry:
        """The entry, moved into the robot's time if it is far outside."""
        if self._start_ns - CLOCK_TRUST_NS < entry.time_ns < self._end_ns + CLOCK_TRUST_NS:
            return entry
        time_ns = min(max(entry.time_ns, self._start_ns), self._end_ns)
        return msgspec.structs.replace(entry, time_ns=time_ns, last_ns=entry.last_ns + time_ns - entry.time_ns)

    # What is drawn.

    def _draw(self, sample: _Sample) -> None:
        """Draw a sample, except in a long rest. Each drive has charts of its own."""
        time_ns = sample[0]
        self._lead.append(sample)
        while time_ns - self._lead[0][0] > MARGIN_NS:
            self._lead.popleft()
        now, (drawn, charts) = self.drives.now, self._charts[-1]
        if now is drawn:
            if now is None or now.start_ns - REST_NS <= time_ns <= now.end_ns + REST_NS:
                _add(charts, sample)
            return
        if drawn is None and time_ns - self._start_ns <= REST_NS:
            self._charts[-1] = now, charts
            _add(charts, sample)
            return
        if drawn is None:
            self._charts.clear()
        charts = Charts()
        for one in self._lead:
            _add(charts, one)
        self._charts.append((now, charts))
        for _, each in self._charts:
            each.bound(min(1.0, WHOLE_SHARES / len(self._charts)))

    def _drawn(self, moments: Sequence[Entry]) -> list[Drawn]:
        """The charts, each cut to the margins of its drive."""
        outages = [(one.heard_ns, one.began_ns) for one in self.drives.outages if one.began_ns is not None]
        found = []
        for drive, charts in self._charts:
            from_ns, to_ns = self._start_ns, self._end_ns
            if drive is not None and (
                len(self._charts) > 1 or max(drive.start_ns - from_ns, to_ns - drive.end_ns) > REST_NS
            ):
                from_ns, to_ns = max(from_ns, drive.start_ns - MARGIN_NS), min(to_ns, drive.end_ns + MARGIN_NS)
            found.append(
                Drawn(
                    start_ns=from_ns,
                    end_ns=to_ns,
                    drive=drive,
                    lines={name: list(line.points(from_ns, to_ns)) for name, line in charts.lines.items()},
                    bands={
                        name: [one for one in band.spans() if one.end_ns >= from_ns and one.start_ns <= to_ns]
                        for name, band in charts.bands.items()
                    },
                    places=[one for one in charts.path.places() if from_ns <= one.time_ns <= to_ns],
                    moments=[one for one in moments if from_ns <= one.time_ns <= to_ns],
                    outages=[one for one in outages if one[1] >= from_ns and one[0] <= to_ns],
                )
            )
        return found

    # One for each class of messages.

    def _take_state(self, state: RobotState, time_ns: int, log_ns: int) -> None:
        angle_deg = state.angle_deg
        is_steered = angle_deg is not None and isfinite(angle_deg) and abs(angle_deg) <= _ANGLE_MAX_DEG
        motion = self.drives.motion
        step_m = self.drives.move(time_ns, log_ns, state.speed_mps if is_steered else None, angle_deg or 0.0)
        pose = None if step_m is None else (motion.way.x_m, motion.way.y_m, motion.way.heading_rad)
        self._draw((time_ns, state, pose, motion.begun_ns == time_ns))
        span_ns = time_ns - self._state_ns
        self._state_ns = time_ns
        driver = REMOTE_CONTROL if state.mode is Mode.REMOTE else self._held_by
        if not driver:
            return
        if driver not in self._driven and len(self._driven) >= DRIVERS_MAX:
            driver = OTHERS
        driven = self._driven.setdefault(driver, [0.0, 0.0])
        driven[0] += span_ns / 1e9 if 0 < span_ns <= GAP_NS else 0.0
        driven[1] += step_m or 0.0

    def _take_decision(self, decision: Decision, time_ns: int) -> None:
        self._verdicts[decision.verdict] += 1
        if decision.verdict is not Verdict.REFUSED:
            return
        about = (decision.request, decision.operator, decision.reason.value)
        counted = self._refusals.get(about)
        if counted is not None:
            counted[0] += 1
            counted[1:] = [min(counted[1], time_ns), max(counted[2], time_ns)]
        elif len(self._refusals) < REFUSALS_MAX:
            self._refusals[about] = [1, time_ns, time_ns]


def _add(charts: Charts, sample: _Sample) -> None:
    time_ns, message, pose, begins = sample
    if isinstance(message, RobotState):
        charts.add_state(time_ns, message, pose, begins=begins)
    else:
        charts.add_arbiter(time_ns, message)
