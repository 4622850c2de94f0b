"""The fleet as the desk knows it: samples in, rows of what has changed out. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Final

import msgspec

from gateway.client.fleet import HEALTH_STALE_NS, Fleet, RobotStatus
from gateway.client.payloads import read_sample
from gateway.client.robot_word import OFFLINE
from gateway.desk.history import PERIOD_NS, Histories
from gateway.desk.overview import recorder_row, row_of, why_not
from gateway.desk.words import DeskWhy, RecorderRow, RobotRow
from gateway.telemetry.received import Arrival, Missed, Received
from schemas.decisions import SafetyEvent, Severity
from schemas.recording import RecorderHealth
from schemas.subjects import BY_TYPE, RECORDER_CHUNK

SHOWN: Final = frozenset({Severity.WARNING, Severity.ERROR})
"""The events of which the last is in a robot's row."""

EVENTS_KEPT: Final = 50
"""The last events of a robot, for who begins to look at it."""

EVENT_MAX_BYTES: Final = 4096
"""A larger event is of no gateway, and is passed over: a thousand robots' would fill the memory."""

ROBOTS_MAX: Final = 1000
"""The robots that are shown. Names are chosen by whoever publishes: a stranger could make any number of them."""

RECORDERS_MAX: Final = 200

FULL_SHOWN_NS: Final = 10_000_000_000
"""For so long after a name for which there was no room it is said that not all are shown."""

KEYS_MAX: Final = 16_384
"""Keys of which samples are kept until they are read: three and a token of each robot, one of each recorder."""

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
        self._root = f"{root}/"
        self._full_ns: int | None = None
        self._is_refused = False
        self._robots: set[str] = set()
        self._names: list[str] = []
        self._recorder_names: set[str] = set()
        self._of_recorders = f"{root}/{RECORDER_CHUNK}/"
        self._fleet = Fleet(root)
        self._linked = False
        self._newest: dict[str, Arrival] = {}
        self._events: dict[str, SafetyEvent] = {}
        self._last_events: dict[str, deque[Received]] = {}
        self._recorders: dict[str, tuple[RecorderHealth, int]] = {}
        self._rows: dict[str, RobotRow] = {}
        self._words: dict[str, tuple[str, int]] = {}
        self._recorder_rows: list[RecorderRow] = []
        self._history_ns = 0

    def receive(self, arrival: Arrival) -> None:
        """Take in an arrival. Of each key the newest is read, when rows are asked for; every event is."""
        if isinstance(arrival, Missed):
            return
        if not self._has_room(arrival.key):
            self._is_refused = True
            return
        if isinstance(arrival, Received) and arrival.key.endswith(_EVENT):
            if len(arrival.payload) + len(arrival.attachment) > EVENT_MAX_BYTES:
                return
            sample = read_sample(arrival)
            if sample is not None and isinstance(sample.message, SafetyEvent):
                self._receive_event(sample.parts.robot, sample.message, arrival)
            return
        if arrival.key in self._newest or len(self._newest) < KEYS_MAX:
            self._newest[arrival.key] = arrival

    def update(self, now_ns: int, *, linked: bool) -> None:
        """Read what has come since the last time."""
        self._linked = linked
        self._fleet.link(connected=linked)
        for key, arrival in self._newest.items():
            if isinstance(arrival, Received) and key.startswith(self._of_recorders):
                self._receive_recorder(arrival, now_ns)
            else:
                self._fleet.receive(arrival, now_ns)
        self._newest.clear()
        # One that is lost stays until somebody has seen it, or until another robot needs its room.
        robots = self._names = self._fleet.robots(
            now_ns, lambda robot: self._is_refused or self._seen_to_by(robot, OFFLINE)
        )
        # A name of which nothing could be read takes no room.
        self._robots, self._recorder_names = set(robots), set(self._recorders)
        self._full_ns, self._is_refused = now_ns if self._is_refused else self._full_ns, False
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
        self._recorders = {
            name: known for name, known in self._recorders.items() if now_ns - known[1] < HEALTH_STALE_NS
        }
        recorders = [recorder_row(name, health) for name, (health, _) in sorted(self._recorders.items())]
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

    def _has_room(self, key: str) -> bool:
        """A sender that is known already, or for which there is room: those that came first stay."""
        is_recorder = key.startswith(self._of_recorders)
        names = self._recorder_names if is_recorder else self._robots
        name = key[len(self._of_recorders if is_recorder else self._root) :].partition("/")[0]
        if name not in names and len(names) >= (RECORDERS_MAX if is_recorder else ROBOTS_MAX):
            return False
        names.add(name)
        return True

    def _receive_event(self, robot: str, event: SafetyEvent, arrival: Received) -> None:
        self._last_events.setdefault(robot, deque(maxlen=EVENTS_KEPT)).append(arrival)
        known = self._events.get(robot)
        if event.severity in SHOWN and (known is None or known.time_ns <= event.time_ns):
            self._events[robot] = event

    def _receive_recorder(self, arrival: Received, now_ns: int) -> None:
        sample = read_sample(arrival)
        if sample is not None and isinstance(sample.message, RecorderHealth):
            self._recorders[sample.parts.recorder] = sample.message, now_ns
