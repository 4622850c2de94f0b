"""Topics, metadata and attachments of logs, read without any chunk."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import BinaryIO, Final

import msgspec
from mcap import records

from recorder.mcap.reader import DamagedError, record_at
from recorder.mcap.summary_reader import read_summary
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import LogReader, Selection, no_topic
from recorder.reading.topics import Declared, Topic
from schemas import keys

FORMER_DIGEST: Final = "cruiser.events"
"""The attachment in which logs of earlier versions repeat their events; nothing reads it any more."""


class Survey(msgspec.Struct):
    """Topics, metadata and attachments of some logs.

    Attributes:
        topics: by name.
        metadata: by name, the last of each.
        attachments: all of them by their log time, but for the digest of events.
    """

    topics: dict[str, Topic]
    metadata: dict[str, dict[str, str]]
    attachments: list[records.Attachment]

    @property
    def robots(self) -> list[str]:
        """The robots whose topics are there."""
        return sorted({topic.robot for topic in self.topics.values() if topic.robot}, key=keys.in_order)


def survey(logs: Sequence[LogFile], faults: Faults) -> Survey:
    """Return the topics, metadata and attachments of logs.

    Args:
        logs: in the order of their beginnings.
        faults: collects what cannot be read.
    """
    found = Survey({}, {}, [])
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
    """Return True if the file's end gave all."""
    summary = read_summary(stream)
    if summary is None:
        return False
    with suppress(DamagedError):
        attachments = [
            record_at(stream, one.offset, records.Attachment)
            for one in summary.attachments
            if one.name != FORMER_DIGEST
        ]
        metadata = [record_at(stream, one.offset, records.Metadata) for one in summary.metadata]
        if None not in [*attachments, *metadata]:
            for _, topic in Declared(log.namesakes).take_summary(summary):
                found.topics.setdefault(topic.name, topic)
            found.attachments += filter(None, attachments)
            found.metadata.update((one.name, one.metadata) for one in metadata if one is not None)
            return True
    return False


def _by_records(stream: BinaryIO, log: LogFile, found: Survey, faults: Faults) -> None:
    reader = LogReader(stream, log, Selection(no_topic), faults)
    for _ in reader.rows():
        pass
    for topic in reader.topics.values():
        found.topics.setdefault(topic.name, topic)
    found.attachments += [one for one in reader.attachments if one.name != FORMER_DIGEST]
    found.metadata.update(reader.metadata)
