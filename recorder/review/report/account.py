"""All of one robot, from its messages one by one, in memory that does not grow with them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite
from typing import Final

import msgspec

from recorder.record.accounting import KeyReport
from recorder.review.clock import RobotClock
from recorder.review.entries import FRAME_COUNTS, Entry, fault_words
from recorder.review.events import SILENT_NS, LogEnding
from recorder.review.repeats import Repeats
from recorder.review.report.drives import REST_NS, Drives
from recorder.review.report.event_log import CLOCKS_APART_NS, EventLog
from recorder.review.report.findings import (
    Driver,
    Outage,
    Refusal,
    ReportedDrive,
    RobotCharts,
    RobotReport,
    RobotSummary,
    Unwritten,
)
from recorder.review.report.odometry import GAP_NS, PLACES_MAX, STANDING_MPS, Odometer
from recorder.review.report.series import BUCKETS_MAX, Series
from recorder.review.report.spans import Spans
from recorder.review.report.versions import Versions
from schemas.decisions import COMMANDING, ArbiterState, Decision, SafetyEvent, SafetyState, Verdict
from schemas.messages import GatewayHealth, Message, Mode, RobotState

REMOTE_CONTROL: Final = "the remote control (RC)"

REFUSALS_MAX: Final = 200
DRIVERS_MAX: Final = 200
FAULTS_MAX: Final = 200
OTHERS: Final = "(others)"

REMEMBERED: Final = 4096
"""Messages of a subject that are known again when they come a second time."""

CLOCK_TRUST_NS: Final = 24 * 3600 * 1_000_000_000
"""A time that is further from the receipt is of no use."""

_COUNTED_BY_FRAME: Final = frozenset(kind for _, kind, _ in FRAME_COUNTS)
"""Kinds of faults that each frame of the health counts for itself."""

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

TARGETS: Final = frozenset({"target_speed_mps", "target_angle_deg"})
"""Commanded values. The state repeats them until others come; they hold while the arbiter is engaged."""

BANDS: Final = ("mode", "arbiter", "lease")
"""The chassis's mode, the arbiter's state, and the holder of the lease."""


class Account:
    """Gathers what is said of a robot.

    Args:
        name: its label.
        key: the beginning of its keys.
        versions: of its gateways, as far as they are known before.
        begins_ns: its logs, or the period that is asked about, begin then. A recorder may have asked a gateway for
            what was before; it is left out.
        ends_ns: likewise what was later.
        share: the part of the points that a chart usually has.
    """

    def __init__(
        self,
        name: str,
        key: str,
        versions: Versions | None = None,
        begins_ns: int = 0,
        *,
        ends_ns: int = 2**64,
        share: float = 1.0,
    ) -> None:
        self.name = name
        self.key = key
        self._begins_ns, self._ends_ns = begins_ns - CLOCKS_APART_NS, ends_ns
        self.versions = Versions() if versions is None else versions
        self.event_log = EventLog()
        self._start_ns, self._end_ns = 2**64, 0
        self._clock = RobotClock()
        self._drives = Drives()
        self._odometer = Odometer(round(PLACES_MAX * share))
        self._lines = {line: Series(GAP_NS, round(BUCKETS_MAX * share)) for line in LINES}
        self._bands = {band: Spans(GAP_NS) for band in BANDS}
        self._seen: dict[type[Message], Repeats] = {}
        self._held_by = ""
        """The operator who drives the robot over Zenoh at present."""
        self._state_ns = 0
        self._driven: dict[str, list[float]] = {}
        self._ends_commanding = False
        self._verdicts: Counter[Verdict] = Counter()
        self._refusals: dict[tuple[str, str, str], list[int]] = {}
        self._health: Counter[str] = Counter()
        self._counts: dict[str, int] = {}
        self._unwritten: Counter[tuple[str, str]] = Counter()

    def take(self, message: Message, publish_ns: int, log_ns: int) -> bool:
        """The next message, of a kind that TAKEN lists: when the robot says it was, and when it was received.

        Returns:
            whether it is new, and not there for the second time.
        """
        seen = self._seen.get(type(message))
        if seen is None:
            seen = self._seen[type(message)] = Repeats(REMEMBERED)
        if not seen.is_new(message.time_ns, message.sequence):
            return False
        time_ns = self._place(message, publish_ns, log_ns)
        if not self._begins_ns <= time_ns < self._ends_ns:
            return True
        self._start_ns, self._end_ns = min(self._start_ns, time_ns), max(self._end_ns, time_ns)
        match message:
            case RobotState():
                self._take_state(message, time_ns, log_ns)
            case SafetyState():
                self._take_arbiter(message, time_ns)
                if message.state in COMMANDING:
                    self._drives.add(time_ns, log_ns)
            case Decision():
                self._take_decision(message, time_ns)
            case GatewayHealth():
                self._take_health(message)
            case _:
                pass
        return True

    def _place(self, message: Message, publish_ns: int, log_ns: int) -> int:
        """Its place on the time axis."""
        tick: int | None = None
        if isinstance(message, SafetyState):
            self._clock.hear(message.tick, publish_ns, log_ns)
        if isinstance(message, SafetyState | SafetyEvent | Decision):
            tick = message.tick
        time_ns = self._clock.place(publish_ns, log_ns, tick)
        return time_ns if abs(time_ns - log_ns) < CLOCK_TRUST_NS else log_ns

    def take_entry(self, entry: Entry) -> None:
        """The next entry of the timeline that is about this robot."""
        if entry.last_ns >= self._begins_ns and entry.time_ns < self._ends_ns:
            self.event_log.take(entry)
            self._drives.take_entry(entry)

    def lose(self, topic: str, reason: str, count: int) -> None:
        """The recorder says that it could not keep so many messages."""
        if len(self._unwritten) < REFUSALS_MAX or (topic, reason) in self._unwritten:
            self._unwritten[topic, reason] += count

    def end(self, found: LogEnding) -> None:
        """The logs end in the middle of a drive, or after the gateway fell silent. The timeline says so, too."""
        if found.is_silent:
            self.event_log.add_outage(Outage(found.entry.time_ns, None, found.is_commanding))
        else:
            self._ends_commanding = True

    def set_apart(self, spans: Sequence[tuple[int, int]]) -> None:
        """Between two logs nobody knows whether a gateway was silent.

        Args:
            spans: first and last log time of each of this robot's logs.
        """
        self.event_log.set_apart(_pauses(spans))

    def sum_up(
        self, completeness: dict[str, KeyReport], facts: dict[str, str], from_ns: int = 0, to_ns: int = 2**64
    ) -> RobotReport | None:
        """Sum up what has been found; None if nothing came.

        Args:
            completeness: the recorder's account of this robot's topics.
            facts: other facts about it in the logs.
            from_ns: gateways that were in force before are left out...
            to_ns: ...and those that came then or later.
        """
        if not self._end_ns:
            return None
        happened = self.event_log
        speeds = self._odometer.speeds
        drivers = [Driver(name, seconds, metres) for name, (seconds, metres) in self._driven.items()]
        refusals = [Refusal(*about, *counted) for about, counted in self._refusals.items()]
        refused = self._verdicts[Verdict.REFUSED]
        summary = RobotSummary(
            name=self.name,
            key=self.key,
            start_ns=self._start_ns,
            end_ns=self._end_ns,
            distance_m=speeds.distance_m,
            moving_s=speeds.moving_ns / 1e9,
            known_s=speeds.known_ns / 1e9,
            top_mps=speeds.top_mps,
            top_ns=speeds.top_ns,
            stops={cause: count for cause, count in happened.stops.most_common() if count},
            ends=dict(happened.ends.most_common()),
            outages=happened.outages,
            more_outages=happened.more_outages,
            ends_commanding=self._ends_commanding,
            events=dict(happened.counts.most_common()),
            drivers=sorted(drivers, key=lambda one: -one.seconds),
            accepted=self._verdicts[Verdict.ACCEPTED],
            refused=refused,
            refusals=sorted(refusals, key=lambda one: -one.count),
            other_refusals=refused - sum(one.count for one in refusals),
            gaps=speeds.gaps,
            gap_s=speeds.gap_ns / 1e9,
            stale=speeds.stale,
            silences=happened.silences,
            more_silences=happened.more_silences,
            health={name: count for name, count in self._health.items() if count},
            completeness=completeness,
            unwritten=[Unwritten(*about, count) for about, count in self._unwritten.most_common()],
            facts=facts,
            in_force=self.versions.in_force(self._clock.offset_ns, from_ns, to_ns),
            more_in_force=self.versions.left_out,
        )
        drives = self._drives.drives()
        return RobotReport(summary, self._draw(), drives, self._drives.more, self._is_apart(drives))

    def _is_apart(self, drives: Sequence[ReportedDrive]) -> bool:
        if len(drives) != 1:
            return bool(drives)
        return max(drives[0].start_ns - self._start_ns, self._end_ns - drives[0].end_ns) > REST_NS

    def _draw(self) -> RobotCharts:
        places = self._odometer.end()
        ordered = sorted(places, key=lambda place: place.time_ns)
        return RobotCharts(
            lines={name: series.points() for name, series in self._lines.items()},
            bands={name: spans.spans() for name, spans in self._bands.items()},
            places=places,
            moments=self.event_log.moments(ordered, self._start_ns, self._end_ns),
            more_moments=self.event_log.more_moments,
            outages=[(one.heard_ns, one.began_ns) for one in self.event_log.outages if one.began_ns is not None],
        )

    def _take_state(self, state: RobotState, time_ns: int, log_ns: int) -> None:
        grew_m = self._odometer.add(time_ns, state.speed_mps, state.angle_deg)
        if state.speed_mps is not None and abs(state.speed_mps) > STANDING_MPS:
            self._drives.add(time_ns, log_ns, grew_m)
        self._draw_on("speed_mps", time_ns, state.speed_mps)
        self._draw_on("angle_deg", time_ns, state.angle_deg)
        self._bands["mode"].add(time_ns, "" if state.mode is Mode.UNDEFINED else state.mode.value)
        span_ns = time_ns - self._state_ns
        self._state_ns = time_ns
        driver = REMOTE_CONTROL if state.mode is Mode.REMOTE else self._held_by
        if not driver:
            return
        if driver not in self._driven and len(self._driven) >= DRIVERS_MAX:
            driver = OTHERS
        driven = self._driven.setdefault(driver, [0.0, 0.0])
        driven[0] += span_ns / 1e9 if 0 < span_ns <= GAP_NS else 0.0
        driven[1] += grew_m

    def _take_arbiter(self, state: SafetyState, time_ns: int) -> None:
        self._held_by = state.lease_holder if state.state is ArbiterState.ENGAGED else ""
        self._bands["arbiter"].add(time_ns, state.state.value)
        self._bands["lease"].add(time_ns, state.lease_holder)
        self._draw_on("speed_limit_mps", time_ns, state.speed_limit_mps)
        self._draw_on("steering_limit_deg", time_ns, state.steering_limit_deg)
        # In standby the chassis is told nothing.
        is_told = state.state is not ArbiterState.STANDBY
        for name in ("target_speed_mps", "output_speed_mps", "target_angle_deg", "output_angle_deg"):
            is_drawn = state.state is ArbiterState.ENGAGED if name in TARGETS else is_told
            self._draw_on(name, time_ns, getattr(state, name) if is_drawn else None)

    def _draw_on(self, line: str, time_ns: int, value: float | None) -> None:
        if value is None or not isfinite(value):
            self._lines[line].cut()
        else:
            self._lines[line].add(time_ns, value)

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

    def _take_health(self, health: GatewayHealth) -> None:
        counts = {
            "lost frames": sum(frame.lost for frame in health.feedback),
            "frames with a wrong checksum": sum(frame.checksum_faults for frame in health.feedback),
            "frames with an implausible value": sum(frame.implausible for frame in health.feedback),
            "frames that were dropped unread": health.bus_drops,
            "losses of the bus": health.bus_losses,
            "samples that Zenoh did not take": health.publish_failures,
            "requests dropped unread": health.inbox_drops,
            **{fault_words(kind): n for kind, n in health.faults.items() if kind not in _COUNTED_BY_FRAME},
        }
        for name, count in counts.items():
            # The first one tells of the time before the log; a count that fell was begun anew.
            grown = count - self._counts.get(name, 0) if self._counts else 0
            if name in self._health or len(self._health) < FAULTS_MAX:
                self._health[name] += grown if grown >= 0 else count
        self._counts = counts


TAKEN: Final[frozenset[type[msgspec.Struct]]] = frozenset(
    {RobotState, SafetyState, SafetyEvent, Decision, GatewayHealth}
)
"""Classes of messages that an account is made of."""


def _pauses(spans: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """From when to when no log holds anything, between the first and the last one; a change of files is none."""
    found: list[tuple[int, int]] = []
    ends_ns: int | None = None
    for start_ns, end_ns in sorted(spans):
        if ends_ns is not None and start_ns - ends_ns > SILENT_NS:
            found.append((ends_ns, start_ns))
        ends_ns = end_ns if ends_ns is None else max(ends_ns, end_ns)
    return found
