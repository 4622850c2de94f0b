"""The fleet as the desk knows it: samples in, rows of what has changed out. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Final

import msgspec

from gateway.client.fleet import Bounds, Fleet, RobotStatus
from gateway.client.payloads import read_sample
from gateway.client.robot_word import OFFLINE
from gateway.desk.history import PERIOD_NS, Histories
from gateway.desk.overview import recorder_row, row_of, why_not
from gateway.desk.words import DeskWhy, RecorderRow, RobotRow
from gateway.telemetry.received import Arrival, Missed, Received
from schemas.decisions import SafetyEvent, Severity
from schemas.recording import RecorderHealth
from schemas.subjects import BY_TYPE

SHOWN: Final = frozenset({Severity.WARNING, Severity.ERROR})
"""The events of which the last is in a robot's row."""

EVENTS_KEPT: Final = 50
"""The last events of a robot, for who begins to look at it."""

EVENT_MAX_BYTES: Final = 4096
"""A larger event is of no gateway, and is passed over: a thousand robots' would fill the memory."""

BOUNDS: Final = Bounds(robots=1000, recorders=200)
"""The robots and recorders that are shown."""

FULL_SHOWN_NS: Final = 10_000_000_000
"""For so long after a name for which there was no room it is said that not all are shown."""

_EVENT: Final = f"/{BY_TYPE[SafetyEvent].name}"


class FleetView:
    """All robots and recorders under a root, and their last minutes; those that came first, if there are too many.

    Attributes:
        histories: the last minutes of each robot.
        is_full: there are more than are shown.
    """

    def __init__(self, root: str, sites: Sequence[tuple[str, str]] = ()) -> None:
        """Look at the keys below a root; a robot belongs to the first site whose pattern its name matches."""
        self.histories = Histories()
        self._acknowledged: dict[str, tuple[str, str]] = {}
        self.is_full = False
        self._sites = sites
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
        """Take in an arrival. Of each key the newest is read, when rows are asked for; every event is."""
        if isinstance(arrival, Missed) or self._fleet.find(arrival.key, self._now_ns) is None:
            return
        if not isinstance(arrival, Received) or not arrival.key.endswith(_EVENT):
            self._newest[arrival.key] = arrival
        elif len(arrival.payload) + len(arrival.attachment) <= EVENT_MAX_BYTES:
            sample = read_sample(arrival)
            if sample is not None and isinstance(sample.message, SafetyEvent):
                self._receive_event(sample.parts.robot, sample.message, arrival)

    def update(self, now_ns: int, *, linked: bool) -> None:
        """Read what has come since the last time."""
        self._now_ns, self._fleet.linked = now_ns, linked
        for arrival in self._newest.values():
            self._fleet.receive(arrival, now_ns)
        self._newest.clear()
        # One that is lost stays until somebody has seen it, or until another robot needs its room.
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
        """Return the rows that have changed since the last call, None for one that has gone; and the recorders."""
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
        """Return True if a robot has a row."""
        return robot in self._rows

    def all_rows(self) -> tuple[dict[str, RobotRow | None], list[RecorderRow]]:
        """Return all rows, as they were returned last."""
        return dict(self._rows), self._recorder_rows

    def report(self, robot: str, now_ns: int) -> RobotStatus:
        """Return a robot as it is now."""
        return self._fleet.report(robot, now_ns)

    def why(self, robot: str, now_ns: int) -> DeskWhy | None:
        """Return why a robot does not move; None where nothing is known of its arbiter."""
        report = self.report(robot, now_ns)
        if report.safety is None:
            return None
        since_ns = self._words.get(robot, ("", now_ns))[1]
        return DeskWhy(robot, *why_not(report.safety, report.health, robot), (now_ns - since_ns) / 1e9)

    def events(self, robot: str) -> list[Received]:
        """Return the last events of a robot as they came, the oldest first."""
        return list(self._last_events.get(robot, ()))

    def _row(self, robot: str, now_ns: int) -> RobotRow:
        row = row_of(self.report(robot, now_ns), self._events.get(robot))
        return msgspec.structs.replace(
            row,
            site=next((site for site, pattern in self._sites if fnmatchcase(robot, pattern)), ""),
            acknowledged=self._seen_to_by(robot, row.word),
        )

    def acknowledge(self, robot: str, word: str, operator: str) -> None:
        """Note who sees to an alarm. It holds for as long as the robot's word is this one."""
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
