"""A part of a log, as a log."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec
from mcap import records

from recorder.disk.files import new_file
from recorder.mcap.reader import FIRST_RECORD, DamagedError, record_at
from recorder.mcap.writer import ChunkBuilder, LogChannel, McapFile
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Progress, Row, Selection, read_rows
from recorder.reading.survey import survey
from recorder.reading.topics import Topic
from recorder.review.info import CUT_NAME
from schemas.command_line import CommandError, ExitCode

CHUNK_BYTES: Final = 1 << 20


class CutLog(msgspec.Struct, frozen=True):
    """The new file; its first and last log time are None if it holds no message."""

    path: str
    bytes: int
    channels: int
    messages: int
    start_ns: int | None
    end_ns: int | None


def cut(
    log: LogFile,
    path: Path,
    selection: Selection,
    topics: Sequence[str],
    faults: Faults,
    progress: Progress = lambda _: None,
) -> CutLog:
    """Write the messages of a period and of some topics into a new file, with all metadata and attachments.

    Raises:
        CommandError: the file exists or cannot be written, or no topic matches.
    """
    about = {
        "files": log.path.name,
        "from_ns": str(selection.from_ns),
        "to_ns": str(selection.to_ns),
        "topics": " ".join(topics),
    }

    def wants(topic: Topic) -> bool:
        return not topics or any(fnmatchcase(topic.name, pattern) for pattern in topics)

    found = survey([log], faults)
    wanted = [topic for topic in found.topics.values() if wants(topic)]
    if topics and not wanted:
        raise CommandError("no topic matches these patterns", ExitCode.USAGE)
    with new_file(path) as out:
        part = _Part(McapFile(out, f"cruiser-gateway {version('cruiser-gateway')}", _profile(log)))
        selection = Selection(wants, selection.from_ns, selection.to_ns)
        for row in read_rows([log], selection, faults, progress):
            part.add(row)
        part.seal()
        named = {topic.name for topic in part.declared}
        for topic in wanted:
            if topic.name not in named:
                part.declare(topic)
        file = part.file
        for one in found.attachments:
            file.add_attachment(one.name, one.media_type, one.data, one.log_time, one.create_time)
        for name, entries in [*found.metadata, (CUT_NAME, about)]:
            file.add_metadata(name, entries)
        file.finish()
    return CutLog(
        path=str(path),
        bytes=file.size,
        channels=len(part.declared),
        messages=file.messages,
        start_ns=min(part.times, default=None),
        end_ns=max(part.times, default=None),
    )


def _profile(log: LogFile) -> str:
    """The profile in the file's header; empty if it cannot be read."""
    with suppress(OSError, DamagedError), log.open() as stream:
        header = record_at(stream, FIRST_RECORD, records.Header)
        return "" if header is None else str(header.profile)
    return ""


class _Part:
    """The new file, chunk by chunk; ``times`` are the first and the last log time of each chunk."""

    def __init__(self, file: McapFile) -> None:
        self.file = file
        self.declared: dict[Topic, int] = {}
        self.times: list[int] = []
        self._builder = ChunkBuilder(CHUNK_BYTES)

    def declare(self, topic: Topic) -> int:
        """The id of a topic's channel, which is declared if it is new."""
        if topic not in self.declared:
            self.declared[topic] = len(self.declared) + 1
            self.file.add_channel(_channel(self.declared[topic], topic))
        return self.declared[topic]

    def add(self, row: Row) -> None:
        self._builder.add(self.declare(row.topic), row.sequence, row.log_ns, row.publish_ns, row.data)
        if self._builder.is_full:
            self.seal()

    def seal(self) -> None:
        """Write the waiting messages."""
        chunk = self._builder.seal()
        if chunk is not None:
            self.file.write_chunk(chunk)
            self.times += [chunk.start_ns, chunk.end_ns]


def _channel(number: int, topic: Topic) -> LogChannel:
    return LogChannel(
        channel_id=number,
        topic=topic.name,
        schema_name=topic.schema,
        schema_data=topic.schema_data,
        schema_encoding=topic.schema_encoding,
        message_encoding=topic.encoding,
        metadata=topic.metadata,
    )
