"""A first look at logs, without their chunks: topics, metadata, attachments, and the runs' configurations."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import BinaryIO, Final

import msgspec
from mcap import records

from recorder.mcap.reader import DamagedError, record_at
from recorder.mcap.summary_reader import read_summary
from recorder.mcap.writer import unnumbered
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import LogReader, Selection, no_topic, read_rows
from recorder.reading.topics import UNREADABLE, Declared, Topic
from schemas import keys
from schemas.configuration import TomlSource, merge
from schemas.messages import GatewayInfo
from schemas.settings import Settings


class Survey(msgspec.Struct):
    """Topics, metadata and attachments of some logs.

    Attributes:
        metadata: name and entries of each record, in the order of the files.
        attachments: by log time.
    """

    topics: dict[str, Topic]
    metadata: list[tuple[str, dict[str, str]]]
    attachments: list[records.Attachment]

    @property
    def robots(self) -> list[str]:
        return sorted({topic.robot for topic in self.topics.values() if topic.robot}, key=keys.in_order)


def survey(logs: Sequence[LogFile], faults: Faults) -> Survey:
    found = Survey({}, [], [])
    for log in logs:
        try:
            with log.open() as stream:
                if not _by_summary(stream, log, found):
                    _by_records(stream, log, found, faults)
        except OSError as error:
            faults.add(f"{log.name}: {error.strerror or error}")
    found.attachments.sort(key=lambda one: one.log_time)
    return found


def _by_summary(stream: BinaryIO, log: LogFile, found: Survey) -> bool:
    """True if the file's end holds everything."""
    summary = read_summary(stream)
    if summary is None:
        return False
    with suppress(DamagedError):
        attachments = [record_at(stream, one.offset, records.Attachment) for one in summary.attachments]
        metadata = [record_at(stream, one.offset, records.Metadata) for one in summary.metadata]
        if None not in [*attachments, *metadata]:
            for _, topic in Declared(log.namesakes).take_summary(summary):
                found.topics.setdefault(topic.name, topic)
            found.attachments += filter(None, attachments)
            found.metadata += [(unnumbered(one.name), one.metadata) for one in metadata if one is not None]
            return True
    return False


def _by_records(stream: BinaryIO, log: LogFile, found: Survey, faults: Faults) -> None:
    reader = LogReader(stream, log, Selection(no_topic), faults)
    for _ in reader.rows():
        pass
    for topic in reader.topics.values():
        found.topics.setdefault(topic.name, topic)
    found.attachments += reader.attachments
    found.metadata += reader.metadata


CONFIGURATION: Final = "configuration.toml"  # the attachment ``{robot}/configuration.toml``

INFO: Final = "gateway/info"

ANSWERED_NS: Final = 30_000_000_000
"""A running recorder gets the configuration of a starting gateway within this time."""

TEXTS_MAX: Final = 64 * 1024 * 1024
"""Limit of the size of all configurations of a robot; one has two thousand characters."""

STARTED_NS: Final = 1_000_000_000  # from a gateway's start to its first journal


class Configurations(msgspec.Struct, frozen=True):
    """Configurations of one robot, as TOML. Times are nanoseconds since 1970.

    Attributes:
        told: start times of gateways and the configuration that each published, by time.
        attached: times at which a recorder attached a configuration, and the text, by time.
    """

    told: list[tuple[int, str]]
    attached: list[tuple[int, str]]

    def at(self, began_ns: int) -> str | None:
        """The configuration of the run that began then; None if it is not in the log."""
        told = [text for started_ns, text in self.told if started_ns <= began_ns + STARTED_NS]
        if told:
            return told[-1]
        before = [text for time_ns, text in self.attached if time_ns < began_ns]
        soon = [text for time_ns, text in self.attached if began_ns <= time_ns < began_ns + ANSWERED_NS]
        later = [text for time_ns, text in self.attached if time_ns >= began_ns + ANSWERED_NS]
        # A recorder attaches a configuration when it is new to it, which may be long after the gateway's start.
        return next(iter(soon[:1] + before[-1:] + later[:1]), None)


def configurations_of(robot: str, logs: Sequence[LogFile], found: Survey, faults: Faults) -> Configurations:
    told: dict[int, str] = {}
    room = TEXTS_MAX
    selection = Selection(lambda topic: topic.robot == robot and topic.subject == INFO)
    for row in read_rows(logs, selection, faults):
        with suppress(*UNREADABLE):
            info = row.topic.decode(row.data) if row.topic.decode is not None else None
            if isinstance(info, GatewayInfo) and info.configuration and len(info.configuration) <= room:
                room -= len(info.configuration)
                told[info.started_ns] = info.configuration
    return Configurations(sorted(told.items()), attached(robot, found))


def attached(robot: str, found: Survey) -> list[tuple[int, str]]:
    """The configurations of a robot that recorders attached, with their times, by time."""
    texts: dict[str, list[tuple[int, str]]] = {}
    for one in found.attachments:
        texts.setdefault(one.name, []).append((one.log_time, one.data.decode("utf-8", "replace")))
    # A recorder adds the root only to the second robot of a name.
    bare = f"{robot.rpartition('/')[2]}/{CONFIGURATION}"
    return texts.get(f"{robot}/{CONFIGURATION}", texts.get(bare, []))


def settings_from(text: str) -> Settings:
    return merge(TomlSource(CONFIGURATION, text, is_recorded=True), {}, {})
