"""Logs put together into a new one, whole or in part."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec
from mcap import records

from recorder.disk.new_file import new_file
from recorder.encoding.event_digest import DIGEST_NAME, EventDigest
from recorder.encoding.protobuf_schema import schema_name
from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import ChunkBuilder
from recorder.mcap.writer import McapFile
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import END_OF_TIME_NS, Progress
from recorder.record.accounting import COMPLETENESS_NAME, KeyReport, total
from recorder.record.robots import DEVICE_NAME, METADATA_NAME
from recorder.review.joining.ordered import in_order
from recorder.review.joining.source import JoinSource, Row
from schemas.exit_codes import CommandError, ExitCode
from schemas.messages import CanFrame
from schemas.subjects import SUBJECTS

CHUNK_BYTES: Final = 1 << 20

CHANNELS_MAX: Final = 2**16 - 1
"""MCAP's channel ids have 16 bits, and 0 is left out."""

RECENT_MAX: Final = 400_000
"""Messages that are remembered at least; at most twice as many.

A message that two recorders received, or that a log and its incident hold, has nearly the same log time in both.
"""

LATE_MAX: Final = 100_000
"""As many of those that may come late: an hour of a robot's decisions, events and journal.

What a recorder asked for later may be minutes behind, but there is little of it: it is remembered by itself.
"""

_LATE: Final = frozenset(subject.schema_name for subject in SUBJECTS if subject.qos.kept_bytes) - {
    schema_name(CanFrame)
}
"""Schemas of what a recorder may ask for later."""


class JoinRange(msgspec.Struct, frozen=True):
    """The part of the sources that goes into the new file.

    Attributes:
        topic: a test of topics, which one at least has to pass; None takes all.
        from_ns: the first log time, since 1970...
        to_ns: ...and the first one that is too late.
    """

    topic: Callable[[str], bool] | None = None
    from_ns: int = 0
    to_ns: int = END_OF_TIME_NS


class Joined(msgspec.Struct, frozen=True):
    """The result of a merge or a cut.

    Attributes:
        path: the new file.
        sources: the files that it is made of.
        duplicates: messages that were in these more than once, and are in it once.
        start_ns, end_ns: the first and the last log time; None if it holds no message.
    """

    path: str
    sources: list[str]
    bytes: int
    channels: int
    messages: int
    duplicates: int
    start_ns: int | None
    end_ns: int | None


def join(
    logs: Sequence[LogFile],
    path: Path,
    wanted: JoinRange,
    about: tuple[str, dict[str, str]],
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Joined:
    """Write a file with what is wanted of logs, in the order of log times.

    Args:
        logs: in the order of their beginnings.
        path: the new file.
        wanted: the part that goes into it. Metadata and attachments all do.
        about: name and entries of a metadata record that says what it is.
        faults: takes what cannot be read; all the rest is in the file.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: the file is there already, or cannot be written, or no topic is wanted.
    """
    with new_file(path) as out:
        joining = _Joining(wanted)
        sources = []
        for log in logs:
            try:
                sources.append(JoinSource(log, joining.choose, faults))
            except OSError as error:
                faults.add(f"{log.path}: {error.strerror or error}")
        profiles = {source.profile for source in sources}
        profile = profiles.pop() if len(profiles) == 1 else ""
        file = McapFile(out, f"cruiser-gateway {version('cruiser-gateway')}", profile, EventDigest())
        joining.begin(file, drops_duplicates=len(sources) > 1)
        _copy_metadata(file, sources, about)
        _copy_attachments(file, sources)
        for row in in_order(sources, wanted.from_ns, wanted.to_ns, faults, progress):
            joining.add(row)
        joining.end()
        if wanted.topic is not None and not joining.channels:
            raise CommandError("no topic is of these patterns", ExitCode.USAGE)
    return Joined(
        path=str(path),
        sources=[str(log.path) for log in logs],
        bytes=file.size,
        channels=joining.channels,
        messages=file.messages,
        duplicates=joining.duplicates,
        start_ns=joining.start_ns,
        end_ns=joining.end_ns,
    )


class Recent:
    """Messages that came by before, in memory that does not grow with the logs.

    Args:
        limit: so many at least, twice as many at most.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._newer: set[int] = set()
        self._older: set[int] = set()

    def is_new(self, channel_id: int, sequence: int, publish_ns: int, data: bytes) -> bool:
        """Report whether no such message came by before; it is remembered."""
        # One number takes less memory than a tuple of four.
        identity = ((hash(data) << 16 | channel_id) << 64 | publish_ns) << 32 | sequence
        if identity in self._newer or identity in self._older:
            return False
        self._newer.add(identity)
        if len(self._newer) >= self._limit:
            self._newer, self._older = set(), self._newer
        return True


class _Joining:
    """Gives channels their ids, and messages their place in the new file."""

    def __init__(self, wanted: JoinRange) -> None:
        self._wanted = wanted
        self._file: McapFile | None = None
        self._ids: dict[tuple[str, str, str, bytes, str, tuple[tuple[str, str], ...]], int] = {}
        self._declared: list[LogChannel] = []
        self._late: set[int] = set()
        self._builder = ChunkBuilder(CHUNK_BYTES)
        self._recent: Recent | None = None
        self._recent_late = Recent(LATE_MAX)
        self.duplicates = 0
        self.start_ns: int | None = None
        self.end_ns: int | None = None

    @property
    def channels(self) -> int:
        """Channels of the new file."""
        return len(self._ids)

    def choose(self, channel: LogChannel) -> int | None:
        """The id of a channel of any source; see ``source.Choose``."""
        if self._wanted.topic is not None and not self._wanted.topic(channel.topic):
            return None
        identity = (
            channel.topic,
            channel.schema_name,
            channel.schema_encoding,
            channel.schema_data,
            channel.message_encoding,
            tuple(sorted(channel.metadata.items())),
        )
        found = self._ids.get(identity)
        if found is None:
            if len(self._ids) >= CHANNELS_MAX:
                raise CommandError(f"the logs have more than {CHANNELS_MAX} channels together")
            found = self._ids[identity] = len(self._ids) + 1
            if channel.schema_name in _LATE:
                self._late.add(found)
            self._declare(msgspec.structs.replace(channel, channel_id=found))
        return found

    def begin(self, file: McapFile, *, drops_duplicates: bool) -> None:
        """From here on messages may come."""
        self._file = file
        self._recent = Recent(RECENT_MAX) if drops_duplicates else None
        for channel in self._declared:
            file.add_channel(channel)
        self._declared.clear()

    def add(self, row: Row) -> None:
        """The next message."""
        log_ns, channel_id, sequence, publish_ns, data = row
        if self._recent is not None:
            recent = self._recent_late if channel_id in self._late else self._recent
            if not recent.is_new(channel_id, sequence, publish_ns, data):
                self.duplicates += 1
                return
        self._builder.add(channel_id, sequence, log_ns, publish_ns, data)
        if self.start_ns is None or log_ns < self.start_ns:
            self.start_ns = log_ns
        if self.end_ns is None or log_ns > self.end_ns:
            self.end_ns = log_ns
        if self._builder.is_full:
            self._flush()

    def end(self) -> None:
        """Make the file whole."""
        self._flush()
        if self._file is not None:
            self._file.finish()

    def _declare(self, channel: LogChannel) -> None:
        if self._file is None:
            self._declared.append(channel)
        else:
            self._file.add_channel(channel)

    def _flush(self) -> None:
        chunk = self._builder.seal()
        if chunk is not None and self._file is not None:
            self._file.write_chunk(chunk)


def _copy_metadata(file: McapFile, sources: Sequence[JoinSource], about: tuple[str, dict[str, str]]) -> None:
    """All records once; and of those of which the last one of a file counts, one that is true of all files."""
    seen: set[tuple[str, tuple[tuple[str, str], ...]]] = set()
    last: dict[str, list[dict[str, str]]] = {METADATA_NAME: [], COMPLETENESS_NAME: []}
    for source in sources:
        of_source: dict[str, dict[str, str]] = {}
        for record in source.read_metadata():
            of_source[record.name] = record.metadata
            identity = record.name, tuple(sorted(record.metadata.items()))
            if identity not in seen:
                seen.add(identity)
                file.add_metadata(record.name, record.metadata)
        for name, several in last.items():
            if name in of_source and of_source[name] not in several:
                several.append(of_source[name])
    if len(last[METADATA_NAME]) > 1:
        file.add_metadata(METADATA_NAME, _one_account(last[METADATA_NAME]))
    if len(_robots_in(last[METADATA_NAME])) > 1 and DEVICE_NAME in (name for name, _ in seen):
        # What was one robot's log is part of several robots' now.
        file.add_metadata(DEVICE_NAME, {})
    if len(last[COMPLETENESS_NAME]) > 1:
        file.add_metadata(COMPLETENESS_NAME, _one_completeness(last[COMPLETENESS_NAME]))
    file.add_metadata(*about)


def _one_account(several: Sequence[dict[str, str]]) -> dict[str, str]:
    """Merge the recording metadata of several logs: all robots; where two logs differ, the later one counts."""
    robots = ",".join(sorted(_robots_in(several)))
    return {key: value for one in several for key, value in one.items()} | {"robots": robots}


def _robots_in(several: Sequence[dict[str, str]]) -> set[str]:
    """The robots that these recording metadata name."""
    return {name for one in several for name in one.get("robots", "").split(",") if name}


def _one_completeness(several: Sequence[dict[str, str]]) -> dict[str, str]:
    """The sums of what was sent, received, written and lost."""
    reports: dict[str, list[KeyReport]] = {}
    for one in several:
        for topic, text in one.items():
            with suppress(msgspec.MsgspecError):
                reports.setdefault(topic, []).append(msgspec.json.decode(text, type=KeyReport))
    return {topic: msgspec.json.encode(total(of_topic)).decode() for topic, of_topic in sorted(reports.items())}


def _copy_attachments(file: McapFile, sources: Sequence[JoinSource]) -> None:
    """Each once, by name, type and content. Digests are of one file alone: this one gets its own."""
    seen: set[tuple[str, str, int, int]] = set()
    for one in _attachments(sources):
        identity = one.name, one.media_type, len(one.data), hash(one.data)
        if identity not in seen and one.name != DIGEST_NAME:
            seen.add(identity)
            file.add_attachment(one.name, one.media_type, one.data, one.log_time, one.create_time)


def _attachments(sources: Sequence[JoinSource]) -> Iterator[records.Attachment]:
    for source in sources:
        yield from source.read_attachments()
