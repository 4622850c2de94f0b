"""Reads logs, and finds what a report says of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile, logs_of
from recorder.reading.rows import END_OF_TIME_NS, Progress, Row, Selection, decoded_rows
from recorder.reading.topics import Topic
from recorder.review.entries import Entry
from recorder.review.events import BEFORE_NS, Timeline, is_within
from recorder.review.report.account import TAKEN, Account
from recorder.review.report.drives import MARGIN_NS
from recorder.review.report.event_log import CLOCKS_APART_NS
from recorder.review.report.findings import Report, ReportedDrive, ReportedFile, RobotReport
from recorder.review.report.margins import Margins, of_robot, read_margins, versions_of
from recorder.review.report.versions import Versions
from schemas.decisions import SafetyState
from schemas.messages import GatewayInfo
from schemas.recording import RecorderEvent, RecordGap

ROBOTS_MAX: Final = 30

DRAWN_MAX: Final = 30
"""Drives that are drawn; of the others a line says how it went."""

WHOLE_SHARES: Final = 4
"""Drives that are drawn with all points that a chart can show; more of them share as many."""

OTHERS_MAX: Final = 5000

REMEMBERED: Final = 256
"""Messages of recorders that are known again when they come a second time."""

_OF_ROBOTS: Final = TAKEN | {GatewayInfo}
_RANKS: Final = {"warning": 1, "error": 2}
_OF_RECORDERS: Final = frozenset({RecordGap, RecorderEvent})


def read_report(
    logs: Sequence[LogFile],
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
    *,
    version: str = "",
    is_drawing: bool = True,
) -> Report:
    """Read what logs say of their robots, in memory that does not grow with them; drives drawn apart once more.

    Args:
        logs: as ``find_logs`` gives them.
        selection: the wanted messages; of the time before it the states are read too.
        faults: takes what cannot be read; the rest is read all the same.
        progress: receives the number of bytes that were read.
        version: of the program, which the report names.
        is_drawing: read drives that are apart once more, for their charts.
    """
    versions: dict[str, Versions] = {}
    margins = [read_margins(log, versions) for log in logs]
    fleet = _Fleet(logs, selection, versions, faults)
    fleet.read(progress)
    robots = sorted(fleet.end(margins), key=lambda one: one.summary.name)
    return Report(
        files=[_reported(log, margin) for log, margin in zip(logs, margins, strict=True)],
        from_ns=selection.from_ns,
        to_ns=None if selection.to_ns == END_OF_TIME_NS else selection.to_ns,
        robots=_drawn(robots, logs, selection, progress) if is_drawing else robots,
        more_robots=len(fleet.others),
        faults=faults.told,
        fault_count=faults.count,
        version=version,
    )


def _drawn(
    robots: Sequence[RobotReport], logs: Sequence[LogFile], selection: Selection, progress: Progress
) -> list[RobotReport]:
    """The same robots, with the drives that are drawn: the worst ones, and of these the last ones."""
    whole = sum(not robot.is_apart for robot in robots)
    apart = [
        (_RANKS.get(drive.severity, 0), drive.stops, drive.start_ns, robot.summary.key)
        for robot in robots
        if robot.is_apart
        for drive in robot.drives
    ]
    chosen = sorted(apart, reverse=True)[: max(0, DRAWN_MAX - whole)]
    places = {(key, start_ns) for _, _, start_ns, key in chosen}
    share = min(1.0, WHOLE_SHARES / max(1, len(chosen) + whole))

    def drawn(robot: RobotReport, drive: ReportedDrive) -> ReportedDrive:
        if (robot.summary.key, drive.start_ns) not in places:
            return drive
        report = _of_drive(robot, drive, logs, selection, share, progress)
        return msgspec.structs.replace(drive, report=report)

    return [
        msgspec.structs.replace(robot, drives=[drawn(robot, drive) for drive in robot.drives])
        if robot.is_apart
        else robot
        for robot in robots
    ]


def _of_drive(
    robot: RobotReport,
    drive: ReportedDrive,
    logs: Sequence[LogFile],
    selection: Selection,
    share: float,
    progress: Progress,
) -> RobotReport | None:
    """Read a drive once more. What cannot be read of it has been reported by the reading before."""
    from_ns, to_ns = drive.log_start_ns - MARGIN_NS, drive.log_end_ns + MARGIN_NS

    def wants(topic: Topic) -> bool:
        return selection.wants(topic) and (topic.kind in _OF_RECORDERS or _robot_key(topic) == robot.summary.key)

    part = Selection(wants, max(selection.from_ns, from_ns, 0), min(selection.to_ns, to_ns))
    within = [log for log in logs if log.start_ns < part.to_ns and log.end_ns >= part.from_ns]
    fleet = _Fleet(within, part, {}, Faults(), drive, share)
    fleet.read(lambda _: progress(0))
    return next((one for one in fleet.end([]) if one.summary.key == robot.summary.key), None)


class _Fleet:
    """The robots of a report.

    Args:
        logs: that are read.
        asked: the time in question.
        versions: the known versions of the robots' gateways, by their keys.
        faults: takes what cannot be read.
        drive: the drive that is drawn; all of the time in question if there is none.
        share: the part of the points that a chart usually has.

    Attributes:
        others: keys of robots for which there was no room.
    """

    def __init__(
        self,
        logs: Sequence[LogFile],
        asked: Selection,
        versions: dict[str, Versions],
        faults: Faults,
        drive: ReportedDrive | None = None,
        share: float = 1.0,
    ) -> None:
        self.others: set[str] = set()
        self._logs = logs
        self._asked = asked
        self._versions = versions
        self._faults = faults
        self._drive = drive
        self._share = share
        self._accounts: dict[str, Account] = {}
        self._timeline = Timeline(faults, kept=REMEMBERED)  # The accounts remember the robots' messages.

    def read(self, progress: Progress) -> None:
        """Read what is asked about."""
        asked = self._asked
        # The states before tell whether the first one is of another gateway.
        looked_at = Selection(
            lambda topic: _is_wanted(topic) and asked.wants(topic),
            max(0, asked.from_ns - BEFORE_NS),
            asked.to_ns,
        )
        for row, message in decoded_rows(self._logs, looked_at, self._faults, progress):
            if row.log_ns >= asked.from_ns:
                self.take(row, message)
            elif isinstance(message, SafetyState):
                self.look_back(row, message)

    def look_back(self, row: Row, message: SafetyState) -> None:
        """A state of the time before."""
        if self._account(row.topic) is not None:
            self._timeline.take(row, message)

    def take(self, row: Row, message: Any) -> None:  # noqa: ANN401 - any message that is wanted
        """The next row."""
        if row.topic.kind in _OF_RECORDERS:
            if isinstance(message, RecordGap):
                self._lose(message)
            else:
                message = self._known(row.topic, message)
        else:
            account = self._account(row.topic)
            if account is None:
                return
            if isinstance(message, GatewayInfo):
                account.versions.hear(message, row.log_ns)
            elif not account.take(message, row.publish_ns, row.log_ns):
                return
        self._timeline.take(row, message)
        self._note(self._timeline.tell())

    def end(self, margins: Sequence[Margins]) -> list[RobotReport]:
        """Return all robots of which something is known. After the last row."""
        for ending in self._timeline.endings(self._logs, self._asked.to_ns):
            if is_within(ending.entry, self._asked):
                for account in self._named(ending.entry.robot):
                    account.end(ending)
        self._note(self._timeline.end())
        asked = self._asked
        found = []
        for key, account in self._accounts.items():
            root, _, robot = key.rpartition("/")
            files = [log for log in self._logs if (root, robot) in log.robots]
            account.set_apart([(log.start_ns, log.end_ns) for log in files])
            found.append(account.sum_up(*of_robot(key, margins), asked.from_ns, asked.to_ns))
        return [one for one in found if one is not None]

    def _account(self, topic: Topic) -> Account | None:
        key = _robot_key(topic)
        account = self._accounts.get(key)
        if account is None and len(self._accounts) < ROBOTS_MAX:
            begins_ns, ends_ns = self._period(key)
            versions = versions_of(key, self._versions)
            account = self._accounts[key] = Account(
                topic.robot, key, versions, begins_ns, ends_ns=ends_ns, share=self._share
            )
        elif account is None and len(self.others) < OTHERS_MAX:
            self.others.add(key)
        return account

    def _period(self, key: str) -> tuple[int, int]:
        """The times by a robot's clock between which its messages count."""
        if self._drive is not None:
            # An account reaches further back than it is told, by as much as two clocks may differ.
            return self._drive.start_ns - MARGIN_NS + CLOCKS_APART_NS, self._drive.end_ns + MARGIN_NS
        begins_ns = min((log.start_ns for log in logs_of(key, self._logs)), default=0)
        return max(self._asked.from_ns, begins_ns), END_OF_TIME_NS

    def _lose(self, gap: RecordGap) -> None:
        for key, account in self._accounts.items():
            if gap.key.startswith(f"{key}/"):
                account.lose(gap.key, gap.reason.value, gap.count)
                return

    def _known(self, topic: Topic, event: RecorderEvent) -> RecorderEvent:
        """The same, with the robot called as it is here: a recorder may know no other of this name."""
        account = self._accounts.get(f"{topic.name.partition('/@')[0]}/{event.robot}")
        return event if account is None else msgspec.structs.replace(event, robot=account.name)

    def _note(self, entries: Iterable[Entry]) -> None:
        for entry in entries:
            if is_within(entry, self._asked):
                for account in self._named(entry.robot):
                    account.take_entry(entry)

    def _named(self, robot: str) -> list[Account]:
        """The accounts of the robot of this name; all where it has none."""
        accounts = list(self._accounts.values())
        known = [one for one in accounts if robot in {"", one.name, one.key}]
        # A recorder calls by its root only the second robot of a name.
        return known or [one for one in accounts if one.key.endswith(f"/{robot}")]


def _is_wanted(topic: Topic) -> bool:
    return topic.kind in _OF_RECORDERS or (topic.kind in _OF_ROBOTS and bool(topic.robot))


def _robot_key(topic: Topic) -> str:
    return topic.name.removesuffix(f"/{topic.subject}")


def _reported(log: LogFile, margins: Margins) -> ReportedFile:
    is_accounted = log.is_incident or bool(margins.completeness)
    return ReportedFile(
        name=log.path.name,
        bytes=log.bytes,
        start_ns=log.start_ns,
        end_ns=log.end_ns,
        is_accounted=is_accounted,
        is_being_written=log.is_being_written,
    )
