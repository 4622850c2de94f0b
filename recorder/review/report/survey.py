"""Reads logs, and finds what a report says of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile, logs_of
from recorder.reading.rows import END_OF_TIME_NS, Progress, Row, Selection, decoded_rows
from recorder.reading.topics import Topic
from recorder.review.report.account import TAKEN, Account
from recorder.review.report.findings import Report, ReportedFile, RobotReport
from recorder.review.report.margins import Margins, of_robot, read_margins, versions_of
from recorder.review.report.versions import Versions
from recorder.review.timeline.entries import Entry
from recorder.review.timeline.timeline import BEFORE_NS, Timeline, is_within
from schemas.decisions import SafetyState
from schemas.messages import GatewayInfo
from schemas.recording import RecorderEvent, RecordGap

ROBOTS_MAX: Final = 30
OTHERS_MAX: Final = 5000

REMEMBERED: Final = 256
"""Messages of recorders that are known again when they come a second time."""

_OF_ROBOTS: Final = TAKEN | {GatewayInfo}
_OF_RECORDERS: Final = frozenset({RecordGap, RecorderEvent})


def read_report(
    logs: Sequence[LogFile],
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
    *,
    version: str = "",
) -> Report:
    """Read what logs say of their robots, in one pass and in memory that does not grow with them.

    Args:
        logs: as ``find_logs`` gives them.
        selection: the wanted messages; of the time before it the states are read too.
        faults: takes what cannot be read; the rest is read all the same.
        progress: receives the number of bytes that were read.
        version: of the program, which the report names.
    """
    versions: dict[str, Versions] = {}
    margins = [read_margins(log, versions) for log in logs]
    fleet = _Fleet(logs, selection, versions, faults)
    # The states before tell whether the first one is of another gateway.
    looked_at = Selection(
        lambda topic: _is_wanted(topic) and selection.wants(topic),
        max(0, selection.from_ns - BEFORE_NS),
        selection.to_ns,
    )
    for row, message in decoded_rows(logs, looked_at, faults, progress):
        if row.log_ns >= selection.from_ns:
            fleet.take(row, message)
        elif isinstance(message, SafetyState):
            fleet.look_back(row, message)
    return Report(
        files=[_reported(log, margin) for log, margin in zip(logs, margins, strict=True)],
        from_ns=selection.from_ns,
        to_ns=None if selection.to_ns == END_OF_TIME_NS else selection.to_ns,
        robots=sorted(fleet.end(margins), key=lambda one: one.summary.name),
        more_robots=len(fleet.others),
        faults=faults.told,
        fault_count=faults.count,
        version=version,
    )


class _Fleet:
    """The robots of a report.

    Args:
        logs: that are read.
        asked: the time in question.
        versions: the known versions of the robots' gateways, by their keys.
        faults: takes what cannot be read.

    Attributes:
        others: keys of robots for which there was no room.
    """

    def __init__(
        self, logs: Sequence[LogFile], asked: Selection, versions: dict[str, Versions], faults: Faults
    ) -> None:
        self.others: set[str] = set()
        self._logs = logs
        self._asked = asked
        self._versions = versions
        self._accounts: dict[str, Account] = {}
        self._timeline = Timeline(faults, kept=REMEMBERED)  # The accounts remember the robots' messages.

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
            account.set_apart([(log.start_ns, log.end_ns) for log in self._logs if (root, robot) in log.robots])
            found.append(account.sum_up(*of_robot(key, margins), asked.from_ns, asked.to_ns))
        return [one for one in found if one is not None]

    def _account(self, topic: Topic) -> Account | None:
        key = _robot_key(topic)
        account = self._accounts.get(key)
        if account is None and len(self._accounts) < ROBOTS_MAX:
            begins_ns = min((log.start_ns for log in logs_of(key, self._logs)), default=0)
            account = self._accounts[key] = Account(
                topic.robot, key, versions_of(key, self._versions), max(self._asked.from_ns, begins_ns)
            )
        elif account is None and len(self.others) < OTHERS_MAX:
            self.others.add(key)
        return account

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
