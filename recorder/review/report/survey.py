"""Reads logs, and finds what a report says of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final

import msgspec
from mcap import records

from recorder.completeness import KeyReport, total
from recorder.review.faults import Faults
from recorder.review.logs import LogFile
from recorder.review.pieces import Fault, read_pieces
from recorder.review.report.account import TAKEN, Account
from recorder.review.report.findings import Report, ReportedFile
from recorder.review.rows import END_OF_TIME_NS, Progress, Selection, read_rows
from recorder.review.topics import UNREADABLE, Topic
from recorder.robots import METADATA_NAME
from recorder.session import COMPLETENESS_NAME
from schemas.recording import RecordGap

ROBOTS_MAX: Final = 30
TOPICS_MAX: Final = 5000
FACTS_MAX: Final = 100
VALUES_MAX: Final = 5


def read_report(
    logs: Sequence[LogFile],
    from_ns: int,
    to_ns: int,
    faults: Faults,
    progress: Progress = lambda _: None,
    *,
    version: str = "",
) -> Report:
    """What logs say of the robots in them, in one pass and in memory that does not grow with them.

    Args:
        logs: as ``find_logs`` gives them.
        from_ns: the first log time...
        to_ns: ...and the first one that is too late.
        faults: takes what cannot be read; the rest is read all the same.
        progress: is told of bytes that were read.
        version: of the program, which the report names.
    """
    margins = [_Margins.read(log) for log in logs]
    accounts: dict[str, Account] = {}
    others: set[str] = set()
    for row in read_rows(logs, Selection(_is_wanted, from_ns, to_ns), faults, progress):
        try:
            message: Any = None if row.topic.decode is None else row.topic.decode(row.data)
        except UNREADABLE:
            faults.add(f"a message of {row.topic.name} at {row.log_ns} ns that cannot be read")
            continue
        topic = message.key if isinstance(message, RecordGap) else row.topic.name
        key = _robot_key(row.topic) if not isinstance(message, RecordGap) else _known_key(topic, accounts)
        account = accounts.get(key)
        if account is None:
            if len(accounts) >= ROBOTS_MAX or not key:
                if key and len(others) < TOPICS_MAX:
                    others.add(key)
                continue
            account = accounts[key] = Account(_name_of(key, accounts), key)
        if isinstance(message, RecordGap):
            account.lose(topic, message.reason.value, message.count)
        else:
            account.take(message, row.publish_ns, row.log_ns)
    reports = [account.sum_up(*_of_robot(account.key, margins)) for account in accounts.values()]
    return Report(
        files=[_reported(log, margin) for log, margin in zip(logs, margins, strict=True)],
        from_ns=from_ns,
        to_ns=None if to_ns == END_OF_TIME_NS else to_ns,
        robots=sorted((one for one in reports if one is not None), key=lambda one: one.summary.name),
        more_robots=len(others),
        faults=faults.told,
        fault_count=faults.count,
        version=version,
    )


class _Margins(msgspec.Struct):
    """What a file says besides its messages: its metadata, the last of each name."""

    facts: dict[str, str]
    completeness: dict[str, KeyReport]

    @classmethod
    def read(cls, log: LogFile) -> _Margins:
        """Of one file; chunks are passed over. What is wrong with it is told by who reads the rows."""
        metadata: dict[str, dict[str, str]] = {}
        with suppress(OSError), log.path.open("rb") as stream:
            for piece in read_pieces(stream, log.bytes, is_verifying=False):
                if isinstance(piece, records.Metadata) and piece.name in {METADATA_NAME, COMPLETENESS_NAME}:
                    metadata[piece.name] = piece.metadata
                elif isinstance(piece, Fault) and piece.cuts:
                    break
        completeness = {}
        for topic, text in list(metadata.get(COMPLETENESS_NAME, {}).items())[:TOPICS_MAX]:
            with suppress(msgspec.MsgspecError):
                completeness[topic] = msgspec.json.decode(text, type=KeyReport)
        return cls(metadata.get(METADATA_NAME, {}), completeness)


def _is_wanted(topic: Topic) -> bool:
    return topic.kind is RecordGap or (topic.kind in TAKEN and bool(topic.robot))


def _robot_key(topic: Topic) -> str:
    return topic.name.removesuffix(f"/{topic.subject}")


def _known_key(topic: str, accounts: dict[str, Account]) -> str:
    """Whose topic it is; empty if nobody's that is known."""
    return next((key for key in accounts if topic.startswith(f"{key}/")), "")


def _name_of(key: str, accounts: dict[str, Account]) -> str:
    """Two roots may hold a robot of the same name; the second is called by its root too."""
    name = key.rpartition("/")[2]
    return key if any(account.name == name for account in accounts.values()) else name


def _reported(log: LogFile, margins: _Margins) -> ReportedFile:
    is_accounted = log.is_incident or bool(margins.completeness)
    return ReportedFile(log.path.name, log.bytes, log.start_ns, log.end_ns, is_accounted)


def _of_robot(key: str, margins: Sequence[_Margins]) -> tuple[dict[str, KeyReport], dict[str, str]]:
    """The account of its topics, and what is known of it, of all files."""
    reports: dict[str, list[KeyReport]] = {}
    values: dict[str, Counter[str]] = {}
    for margin in margins:
        for topic, report in margin.completeness.items():
            if topic.startswith(f"{key}/"):
                reports.setdefault(topic, []).append(report)
        known = margin.facts.get("robots", "").split(",")
        prefix = f"{key if key in known else key.rpartition('/')[2]}."
        for name, value in margin.facts.items():
            fact = name.removeprefix(prefix)
            if fact != name or name == "recorder_version":
                values.setdefault(fact, Counter())[value] += 1
    completeness = {topic: total(of_topic) for topic, of_topic in sorted(reports.items())}
    facts = {name: ", ".join(list(found)[:VALUES_MAX]) for name, found in list(values.items())[:FACTS_MAX]}
    return completeness, facts
