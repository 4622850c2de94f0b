"""Reads logs for a report, in one pass over the messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any, Final

import msgspec

from recorder.reading.logs import Faults, LogFile, logs_of
from recorder.reading.rows import (
    END_OF_TIME_NS,
    Progress,
    Row,
    Selection,
    decoded_rows,
)
from recorder.reading.topics import Topic
from recorder.record.accounting import KeyReport, total
from recorder.record.robots import METADATA_NAME
from recorder.review.entries import Entry
from recorder.review.events import LEAD_NS, Timeline, is_within
from recorder.review.info import LogInfo, read_info
from recorder.review.report.account import TAKEN, Account, Versions
from recorder.review.report.findings import Report, ReportedFile, RobotReport
from schemas.command_line import CommandError
from schemas.decisions import SafetyState
from schemas.messages import GatewayInfo
from schemas.recording import RecorderEvent, RecordGap

ROBOTS_MAX: Final = 30
OTHERS_MAX: Final = 5000

REMEMBERED: Final = 256  # messages of recorders that are recognised when they come a second time

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
    infos = [_info(log) for log in logs]
    fleet = _Fleet(logs, selection, infos, faults)
    fleet.read(progress)
    return Report(
        files=[_reported(log, info) for log, info in zip(logs, infos, strict=True)],
        from_ns=selection.from_ns,
        to_ns=None if selection.to_ns == END_OF_TIME_NS else selection.to_ns,
        robots=sorted(fleet.end(), key=lambda one: one.summary.name),
        more_robots=len(fleet.others),
        faults=faults.told,
        fault_count=faults.count,
        version=version,
    )


def _info(log: LogFile) -> LogInfo | None:
    """The contents of a file; the reader of the rows reports its faults."""
    with suppress(CommandError):
        return read_info(log.path)
    return None


def _facts_of(key: str, log: LogFile, info: LogInfo | None) -> dict[str, str]:
    """The recorder's last metadata of a robot; a second robot of a name is named with its root."""
    ours = {} if info is None else info.metadata.get(METADATA_NAME, {})
    root, _, name = key.rpartition("/")
    if log.robots and (root, name) not in log.robots:
        return {}
    prefix = f"{key if key in ours.get('robots', '').split(',') else name}."
    return {one.removeprefix(prefix): value for one, value in ours.items() if one.startswith(prefix)}


class _Fleet:
    """The robots of a report.

    Attributes:
        others: keys of robots beyond ``ROBOTS_MAX``.
    """

    def __init__(
        self, logs: Sequence[LogFile], asked: Selection, infos: Sequence[LogInfo | None], faults: Faults
    ) -> None:
        self.others: set[str] = set()
        self._logs = logs
        self._asked = asked
        self._infos = infos
        self._faults = faults
        self._accounts: dict[str, Account] = {}
        self._timeline = Timeline(faults, kept=REMEMBERED)  # The accounts recognise the robots' messages.

    def read(self, progress: Progress) -> None:
        """Read the requested time. The states before show whether the gateway restarted at its start."""
        asked = self._asked
        looked_at = Selection(
            lambda topic: _is_wanted(topic) and asked.wants(topic),
            max(0, asked.from_ns - LEAD_NS),
            asked.to_ns,
        )
        for row, message in decoded_rows(self._logs, looked_at, self._faults, progress):
            if row.log_ns >= asked.from_ns:
                self._take(row, message)
            elif isinstance(message, SafetyState) and self._account(row.topic) is not None:
                self._timeline.take(row, message)

    def _take(self, row: Row, message: Any) -> None:  # noqa: ANN401 - any message that is wanted
        if row.topic.kind in _OF_RECORDERS:
            if isinstance(message, RecorderEvent):
                message = self._known(row.topic, message)
        else:
            account = self._account(row.topic)
            if account is None:
                return
            if isinstance(message, GatewayInfo):
                account.versions.hear(message)
            elif not account.take(message, row.publish_ns, row.log_ns):
                return
        self._timeline.take(row, message)
        self._note(self._timeline.tell())

    def end(self) -> Iterator[RobotReport]:
        asked = self._asked
        for ending in self._timeline.endings(self._logs, asked.to_ns):
            if is_within(ending.entry, asked):
                for account in self._named(ending.entry.robot):
                    account.end(ending)
        self._note(self._timeline.end())
        for key, account in self._accounts.items():
            files = logs_of(key, self._logs)
            begins_before = any(log.start_ns < asked.from_ns for log in files)
            ends_behind = any(log.end_ns > asked.to_ns for log in files)
            account.miss(asked.from_ns if begins_before else None, asked.to_ns if ends_behind else None)
            found = account.sum_up(_completeness(key, self._infos), asked.from_ns, asked.to_ns)
            if found is not None:
                yield found

    def _account(self, topic: Topic) -> Account | None:
        key = _robot_key(topic)
        account = self._accounts.get(key)
        if account is None and len(self._accounts) < ROBOTS_MAX:
            begins_ns = min((log.start_ns for log in logs_of(key, self._logs)), default=0)
            versions = Versions()
            for log, info in zip(self._logs, self._infos, strict=True):
                versions.read(_facts_of(key, log, info))
            account = Account(topic.robot, key, versions, max(self._asked.from_ns, begins_ns))
            self._accounts[key] = account
        elif account is None and len(self.others) < OTHERS_MAX:
            self.others.add(key)
        return account

    def _known(self, topic: Topic, event: RecorderEvent) -> RecorderEvent:
        """The event with the robot's name as used here: a recorder may know only one robot of this name."""
        account = self._accounts.get(f"{topic.name.partition('/@')[0]}/{event.robot}")
        return event if account is None else msgspec.structs.replace(event, robot=account.name)

    def _note(self, entries: Iterable[Entry]) -> None:
        for entry in entries:
            if is_within(entry, self._asked):
                for account in self._named(entry.robot):
                    account.take_entry(entry)

    def _named(self, robot: str) -> list[Account]:
        """The accounts of the robot of this name; all for an empty name."""
        accounts = list(self._accounts.values())
        known = [one for one in accounts if robot in {"", one.name, one.key}]
        # A recorder adds the root only to the second robot of a name.
        return known or [one for one in accounts if one.key.endswith(f"/{robot}")]


def _completeness(key: str, infos: Sequence[LogInfo | None]) -> dict[str, KeyReport]:
    """The recorder's account of a robot's topics over all files."""
    reports: dict[str, list[KeyReport]] = {}
    for info in infos:
        for topic, report in ({} if info is None else info.completeness).items():
            if topic.startswith(f"{key}/"):
                reports.setdefault(topic, []).append(report)
    return {topic: total(of_topic) for topic, of_topic in sorted(reports.items())}


def _is_wanted(topic: Topic) -> bool:
    return topic.kind in _OF_RECORDERS or (topic.kind in _OF_ROBOTS and bool(topic.robot))


def _robot_key(topic: Topic) -> str:
    return topic.name.removesuffix(f"/{topic.subject}")


def _reported(log: LogFile, info: LogInfo | None) -> ReportedFile:
    is_accounted = log.is_incident or (info is not None and bool(info.completeness))
    return ReportedFile(log.path.name, log.bytes, log.start_ns, log.end_ns, is_accounted, log.is_being_written)
