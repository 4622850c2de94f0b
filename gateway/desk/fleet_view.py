"""The fleet as browsers see it: rows of the overview, newest samples, histories. Pure."""

from __future__ import annotations

import math
from array import array
from collections import defaultdict, deque
from typing import Final

import msgspec

from gateway.chassis.odometry import DeadReckoning
from gateway.choice.chassis import CHASSIS
from gateway.client.fleet import (
    FINE,
    LOOK,
    OFFLINE,
    WORDS,
    Bounds,
    Fleet,
    RobotStatus,
    alarm,
    read_sample,
    word_of,
)
from gateway.client.refusal import state_line, text_of
from gateway.desk.words import DeskHistory, DeskPose, DeskWhy, RecorderRow, RobotRow
from gateway.telemetry.samples import Arrival, Missed, Received
from schemas.command_line import plain, short
from schemas.decisions import SafetyEvent, SafetyState, Severity
from schemas.messages import GatewayHealth
from schemas.reasons import ACQUIRE, ENGAGE, RESET, TEXTS, Reason, cure_of
from schemas.recording import RecorderHealth
from schemas.subjects import BY_TYPE

PERIOD_NS: Final = 200_000_000

LENGTH: Final = 1500  # points of a robot: five minutes

FIELDS: Final = (
    *("asked_mps", "told_mps", "speed_mps", "limit_mps", "asked_deg", "told_deg", "angle_deg"),
    *("x_m", "y_m", "heading_rad"),
)
"""Speed: requested, commanded, measured, limit. Steering angle: the first three. Pose: odometry over the states
that the desk received, from zero.
"""

_KEPT: Final = LENGTH * len(FIELDS)


class Histories:
    """The last minutes of each robot."""

    def __init__(self) -> None:
        # Single precision, six times as compact as tuples: a thousand robots take 120 MB at most.
        self._points: dict[str, array[float]] = {}
        self._newest_ns: dict[str, int] = {}
        self._odometry: defaultdict[str, DeadReckoning] = defaultdict(lambda: DeadReckoning(CHASSIS.wheelbase_m))

    def add(self, report: RobotStatus, now_ns: int) -> None:
        state, safety = report.state, report.safety
        measured = (None, None) if state is None else (state.speed_mps, state.angle_deg)
        odometry = self._odometry[report.robot]
        if state is not None and state.time_ns != odometry.last_ns:
            odometry.move(state.time_ns, *measured)
        limit = None if safety is None else safety.travel_speed_limit_mps
        point = (
            *((None, None) if safety is None else (safety.target_speed_mps, safety.output_speed_mps)),
            measured[0],
            None if safety is None else min(safety.speed_limit_mps, limit or safety.speed_limit_mps),
            *((None, None) if safety is None else (safety.target_angle_deg, safety.output_angle_deg)),
            measured[1],
            odometry.x_m,
            odometry.y_m,
            odometry.heading_rad,
        )
        points = self._points.setdefault(report.robot, array("f"))
        points.extend(math.nan if value is None else value for value in point)
        if len(points) >= 2 * _KEPT:
            del points[:_KEPT]
        self._newest_ns[report.robot] = now_ns

    def keep(self, robots: list[str]) -> None:
        for robot in self._points.keys() - set(robots):
            del self._points[robot], self._newest_ns[robot], self._odometry[robot]

    def of(self, robot: str, now_ns: int) -> DeskHistory:
        points = self._points.get(robot, array("f"))[-_KEPT:]
        age_s = (now_ns - self._newest_ns.get(robot, now_ns)) / 1e9
        return DeskHistory(
            robot,
            age_s,
            {
                name: [None if math.isnan(value) else value for value in points[at :: len(FIELDS)]]
                for at, name in enumerate(FIELDS)
            },
        )

    def pose(self, robot: str) -> DeskPose | None:
        if (odometry := self._odometry.get(robot)) is None:
            return None
        return DeskPose(robot, odometry.x_m, odometry.y_m, odometry.heading_rad)


COUNT_MAX: Final = 2**53 - 1

BUTTONS: Final = {
    RESET: "press Reset, then ",
    ENGAGE: "Take control",
    ACQUIRE: "Take control",
    " ('cruiser drive ROBOT')": "",
    "name whose stop you clear: 'cruiser reset ROBOT --of NAME'": "press Reset",
}
"""Buttons of the page in place of commands in cures."""


def row_of(report: RobotStatus, event: SafetyEvent | None) -> RobotRow:
    state, safety = report.state, report.safety
    word, reasons = word_of(report)
    return RobotRow(
        level=max(WORDS[word], LOOK if report.newer or report.health is None else FINE),
        word=word,
        text=short(plain(_text_of(report, word, reasons))),
        driver=short(plain(safety.lease_holder)) if safety is not None else "",
        speed_mps=_rounded(state.speed_mps if state is not None else None),
        limit_mps=_rounded(_limit_mps(safety) if safety is not None else None),
        link_age_s=_rounded(safety.link_age_s if safety is not None else None),
        lost=_count(sum(frame.lost for frame in report.health.feedback)) if report.health is not None else None,
        event=short(plain(event.text)) if event is not None else "",
        reasons=[reason.value for reason in reasons],
    )


def recorder_row(name: str, health: RecorderHealth) -> RecorderRow:
    return RecorderRow(
        name,
        health.state.value,
        health.robots,
        _count(health.missed + sum(health.dropped.values())),
        health.disk_free_bytes,
    )


def why_not(
    safety: SafetyState, health: GatewayHealth | None, robot: str
) -> tuple[list[tuple[str, str, str]], list[str]]:
    """Return the reasons for which a robot does not move, and what else needs attention."""
    reasons = [(one.value, *_text(one, robot, safety.blocked_by)) for one in safety.blocked_by]
    notes = [short(plain(note)) for note in health.notes] if health is not None else []
    if health is not None and not health.realtime:
        notes.append(_text(Reason.NO_REALTIME, robot)[0])
    return reasons, notes


def reasons_in_words() -> dict[str, tuple[str, str]]:
    """Return meaning and cure of each reason; ROBOT stands for the robot's name."""
    return {reason.value: (text.means, _with_buttons(text.cure, "ROBOT")) for reason, text in TEXTS.items()}


def _text(reason: Reason, robot: str, beside: list[Reason] | None = None) -> tuple[str, str]:
    text = text_of(reason, robot, beside or [])
    return text.means, _with_buttons(text.cure, robot)


def _with_buttons(cure: str, robot: str) -> str:
    for command, button in BUTTONS.items():
        cure = cure.replace(cure_of(command, robot), button)
    return cure


def _text_of(report: RobotStatus, word: str, reasons: list[Reason]) -> str:
    state, safety = report.state, report.safety
    if state is None:
        return alarm(report)
    if word == "bus_down":
        return "its CAN bus is down"
    if safety is None:
        return f"mode {state.mode.value}; it takes no commands"
    if word == "stopping" or not reasons:
        return state_line(safety)
    return "; ".join(_text(one, report.robot)[0] for one in reasons)


def _limit_mps(safety: SafetyState) -> float:
    """Return the speed limit in force, including that of the commands' age."""
    travel_mps = safety.travel_speed_limit_mps
    return safety.speed_limit_mps if travel_mps is None else min(safety.speed_limit_mps, travel_mps)


def _count(value: int) -> int:
    """Limit a sum of foreign counts to what browsers represent exactly."""
    return min(value, COUNT_MAX)


def _rounded(value: float | None) -> float | None:
    """Round as shown, so that a row changes only where a person sees it."""
    return None if value is None else round(value, 2)


SHOWN: Final = frozenset({Severity.WARNING, Severity.ERROR})  # the events of which the last is in a robot's row
EVENTS_KEPT: Final = 50  # the last events of a robot, for who begins to look at it
EVENT_MAX_BYTES: Final = 4096  # larger events are dropped: those of a thousand robots would fill the memory
BOUNDS: Final = Bounds(robots=1000, recorders=200)  # the robots and recorders that are shown
FULL_SHOWN_NS: Final = 10_000_000_000  # how long after a refused name the page says that not all are shown

_EVENT: Final = f"/{BY_TYPE[SafetyEvent].name}"


class FleetView:
    """All robots and recorders under a root, up to a limit, and their histories."""

    def __init__(self, root: str) -> None:
        self.histories = Histories()
        self._acknowledged: dict[str, tuple[str, str]] = {}
        self.is_full = False
        self._full_ns: int | None = None
        self._refused = 0
        self._now_ns = 0
        self._names: list[str] = []
        self._recorder_names: list[str] = []
        self._fleet = Fleet(root, BOUNDS)
        self._newest: dict[str, Arrival] = {}
        self._events: dict[str, SafetyEvent] = {}
        self._last_events: dict[str, deque[Received]] = {}
        self._rows: dict[str, RobotRow] = {}
        self._words: dict[str, tuple[str, int]] = {}
        self._recorder_rows: list[RecorderRow] = []
        self._history_ns = 0

    def receive(self, arrival: Arrival) -> None:
        """Store an arrival: the newest sample of each key, read on update, and every event."""
        if isinstance(arrival, Missed) or self._fleet.find(arrival.key, self._now_ns) is None:
            return
        if not isinstance(arrival, Received) or not arrival.key.endswith(_EVENT):
            self._newest[arrival.key] = arrival
        elif len(arrival.payload) + len(arrival.attachment) <= EVENT_MAX_BYTES:
            sample = read_sample(arrival)
            if sample is not None and isinstance(sample.message, SafetyEvent):
                self._receive_event(sample.parts.robot, sample.message, arrival)

    def update(self, now_ns: int, *, linked: bool) -> None:
        """Read the stored samples."""
        self._now_ns, self._fleet.linked = now_ns, linked
        for arrival in self._newest.values():
            self._fleet.receive(arrival, now_ns)
        self._newest.clear()
        # A lost robot stays until it is acknowledged, or its place is needed.
        robots = self._names = self._fleet.robots.names(now_ns, lambda robot: self._seen_to_by(robot, OFFLINE))
        self._recorder_names = self._fleet.recorders.names(now_ns, lambda _recorder: True)
        refused = self._fleet.robots.refused + self._fleet.recorders.refused
        self._full_ns, self._refused = now_ns if refused > self._refused else self._full_ns, refused
        self.is_full = self._full_ns is not None and now_ns - self._full_ns < FULL_SHOWN_NS
        for gone in self._last_events.keys() - set(robots):
            del self._last_events[gone]
            self._events.pop(gone, None)
        for gone in self._rows.keys() - set(robots):
            self._acknowledged.pop(gone, None)
        if now_ns - self._history_ns >= PERIOD_NS:
            self._history_ns = now_ns
            self.histories.keep(robots)
            for robot in robots:
                self.histories.add(self._fleet.report(robot, now_ns), now_ns)

    def changed_rows(self, now_ns: int) -> tuple[dict[str, RobotRow | None], list[RecorderRow] | None]:
        """Return rows that changed since the last call (None: gone), and the recorders if they changed."""
        rows = {robot: self._row(robot, now_ns) for robot in self._names}
        changed: dict[str, RobotRow | None] = {
            name: row for name, row in rows.items() if self._rows.get(name) != row
        }
        changed |= dict.fromkeys(self._rows.keys() - rows.keys())
        self._rows = rows
        before = self._words
        self._words = {
            name: before[name] if name in before and before[name][0] == row.word else (row.word, now_ns)
            for name, row in rows.items()
        }
        healths = (
            (name, self._fleet.recorders[name].fresh(RecorderHealth, now_ns)) for name in self._recorder_names
        )
        recorders = [recorder_row(name, health) for name, health in healths if health is not None]
        is_other, self._recorder_rows = recorders != self._recorder_rows, recorders
        return changed, recorders if is_other else None

    def shows(self, robot: str) -> bool:
        return robot in self._rows

    def all_rows(self) -> tuple[dict[str, RobotRow | None], list[RecorderRow]]:
        """Return all rows of the last update."""
        return dict(self._rows), self._recorder_rows

    def report(self, robot: str, now_ns: int) -> RobotStatus:
        return self._fleet.report(robot, now_ns)

    def why(self, robot: str, now_ns: int) -> DeskWhy | None:
        """Return why a robot does not move; None without a state of its arbiter."""
        report = self.report(robot, now_ns)
        if report.safety is None:
            return None
        since_ns = self._words.get(robot, ("", now_ns))[1]
        return DeskWhy(robot, *why_not(report.safety, report.health, robot), (now_ns - since_ns) / 1e9)

    def events(self, robot: str) -> list[Received]:
        """Return the last events of a robot, oldest first."""
        return list(self._last_events.get(robot, ()))

    def _row(self, robot: str, now_ns: int) -> RobotRow:
        row = row_of(self.report(robot, now_ns), self._events.get(robot))
        return msgspec.structs.replace(row, acknowledged=self._seen_to_by(robot, row.word))

    def acknowledge(self, robot: str, word: str, operator: str) -> None:
        """Note who handles an alarm, until the robot's word changes."""
        self._acknowledged[robot] = word, operator

    def _seen_to_by(self, robot: str, word: str) -> str:
        known, operator = self._acknowledged.get(robot, ("", ""))
        if known == word:
            return operator
        self._acknowledged.pop(robot, None)
        return ""

    def _receive_event(self, robot: str, event: SafetyEvent, arrival: Received) -> None:
        self._last_events.setdefault(robot, deque(maxlen=EVENTS_KEPT)).append(arrival)
        known = self._events.get(robot)
        if event.severity in SHOWN and (known is None or known.time_ns <= event.time_ns):
            self._events[robot] = event
