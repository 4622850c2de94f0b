"""Messages of logs as rows in the order of log times, of the wanted topics and time.

Unwanted chunks are not read from the disk, if the file has message indexes. Memory does not grow with a log: one
chunk is held of each open file.

``Contents`` is a file without its messages, read from its summary and the first and last message index of each
channel; or, if that is incomplete, record by record.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from fnmatch import fnmatchcase
from heapq import merge
from operator import attrgetter
from typing import Any, BinaryIO, Final, TypeVar
from urllib.parse import quote

import msgspec
from mcap import records

from recorder.mcap.reader import (
    DamagedError,
    End,
    Fault,
    Index,
    LoggedMessage,
    MessageBlock,
    PackedChunk,
    Piece,
    read_pieces,
    record_at,
)
from recorder.mcap.summary_reader import LogSummary, read_summary
from recorder.mcap.writer import unnumbered
from recorder.reading.logs import Faults, LogFile
from recorder.reading.topics import UNREADABLE, Declared, Topic, key_of
from schemas import keys
from schemas.messages import RawSample

END_OF_TIME_NS: Final = 2**64  # later than every log time

Wants = Callable[[Topic], bool]
Progress = Callable[[int], None]  # takes the number of bytes that a file has been read further


def every_topic(_topic: Topic) -> bool:
    return True


def no_topic(_topic: Topic) -> bool:
    return False


class Selection(msgspec.Struct, frozen=True):
    """A selection of messages by topic and log time.

    Attributes:
        wants: a test of topics.
        from_ns, to_ns: log times, from the first wanted one to the first one beyond.
    """

    wants: Wants = every_topic
    from_ns: int = 0
    to_ns: int = END_OF_TIME_NS


class Row(msgspec.Struct, frozen=True, gc=False):
    """A message of a log. Times are nanoseconds since 1970.

    Attributes:
        log_ns: when the recorder received it.
        publish_ns: when it was published, by its source's clock.
    """

    topic: Topic
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


def read_rows(
    logs: Sequence[LogFile],
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Iterator[Row]:
    """The rows of logs, merged by log time. A file is opened when its time comes."""
    wanted = [log for log in logs if log.start_ns < selection.to_ns and log.end_ns >= selection.from_ns]
    groups: list[list[LogFile]] = []
    ends_ns = -1
    for log in wanted:
        if log.start_ns > ends_ns:
            groups.append([])
        groups[-1].append(log)
        ends_ns = max(ends_ns, log.end_ns)
    for group in groups:
        # Only logs that overlap in time are open at the same time.
        rows = (_rows_from(log, selection, faults, progress) for log in group)
        yield from merge(*rows, key=attrgetter("log_ns"))


def decoded_rows(
    logs: Sequence[LogFile],
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Iterator[tuple[Row, Any]]:
    """Read rows as ``read_rows`` does, each with its message; None without a decoder for it.

    A message that does not match its schema is a fault, and left out.
    """
    for row in read_rows(logs, selection, faults, progress):
        decode = row.topic.decode
        try:
            message = None if decode is None else decode(row.data)
        except UNREADABLE as error:
            faults.add(f"{row.topic.name}: a message that cannot be read: {error}")
        else:
            yield row, message


def _rows_from(log: LogFile, selection: Selection, faults: Faults, progress: Progress) -> Iterator[Row]:
    try:
        with log.open() as stream:
            reader = LogReader(stream, log, selection, faults)
            yield from reader.rows(progress)
    except OSError as error:
        faults.add(f"{log.name}: {error.strerror or error}")


class BlockReader:
    """Reads the blocks of a log that may hold wanted messages: unpacked chunks, and messages outside of chunks.

    Attributes:
        topics: by channel id, as far as the log has been read.
        wanted: those of them that are wanted.
        metadata: name and entries of each record.
    """

    def __init__(self, stream: BinaryIO, log: LogFile, selection: Selection, faults: Faults) -> None:
        self._stream = stream
        self._size = log.bytes
        self._is_being_written = log.is_being_written
        self._faults = faults
        self._declared = Declared(log.namesakes)
        self.name = log.name
        self.selection = selection
        self.topics = self._declared.topics
        self.wanted: dict[int, Topic] = {}
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.attachments: list[records.Attachment] = []
        # Other writers declare channels within chunks; the summary repeats them.
        self._want(self._declared.take_summary(read_summary(stream)))

    def blocks(self, progress: Progress = lambda _: None) -> Iterator[tuple[MessageBlock, Index | None]]:
        """The blocks in the order of the file, each with its index, if it has one."""
        read_to = 0
        for piece in read_pieces(self._stream, self._size, is_verifying=False):
            match piece:
                case PackedChunk():
                    yield from self._unpacked(piece)
                    progress(piece.offset + piece.length - read_to)
                    read_to = piece.offset + piece.length
                case MessageBlock():
                    yield piece, None
                case records.Metadata():
                    self.metadata.append((unnumbered(piece.name), piece.metadata))
                case records.Attachment():
                    self.attachments.append(piece)
                case Fault() if piece.cuts and self._is_being_written:
                    pass
                case Fault() | records.Schema() | records.Channel():
                    self.take(piece)
                case _:
                    pass
        progress(self._size - read_to)

    def take(self, piece: records.Schema | records.Channel | Fault) -> None:
        if isinstance(piece, Fault):
            self.fault(f"byte {piece.offset}: {piece.detail}")
        else:
            self._want(self._declared.take(piece))

    def fault(self, detail: str) -> None:
        self._faults.add(f"{self.name}: {detail}")

    def wrong_index(self, block: MessageBlock) -> None:
        self.take(Fault(block.offset, "the message indexes behind a chunk are wrong"))

    def _unpacked(self, chunk: PackedChunk) -> Iterator[tuple[MessageBlock, Index | None]]:
        index = chunk.index
        if index is not None:
            # Without an index there is only the chunk's head, which may be wrong.
            if chunk.start_ns >= self.selection.to_ns or chunk.end_ns < self.selection.from_ns:
                return
            if not any(channel in self.wanted or channel not in self.topics for channel in index):
                return
        try:
            block = chunk.unpack()
        except DamagedError as error:
            self.take(Fault(chunk.offset, f"a chunk cannot be read: {error}"))
        else:
            yield block, index

    def _want(self, found: list[tuple[int, Topic]]) -> None:
        for channel_id, topic in found:
            if self.selection.wants(topic):
                self.wanted[channel_id] = topic


class LogReader(BlockReader):
    """Reads the rows of one log."""

    def rows(self, progress: Progress = lambda _: None) -> Iterator[Row]:
        from_ns, to_ns = self.selection.from_ns, self.selection.to_ns
        for block, index in self.blocks(progress):
            found = None
            if index is not None and index.keys() <= self.topics.keys():
                found = block.pick(index, self.wanted, Row, from_ns, to_ns)
                if found is None:
                    self.wrong_index(block)
            yield from self._sift(block) if found is None else found

    def _sift(self, block: MessageBlock) -> Iterator[Row]:
        from_ns, to_ns = self.selection.from_ns, self.selection.to_ns
        for one in block.messages():
            if not isinstance(one, LoggedMessage):
                self.take(one)
            elif one.channel_id not in self.topics:
                self.fault(f"a message of channel {one.channel_id}, which the file does not hold")
            elif one.channel_id in self.wanted and from_ns <= one.log_ns < to_ns:
                yield Row(self.wanted[one.channel_id], one.sequence, one.log_ns, one.publish_ns, one.data)


Kind = TypeVar("Kind", records.MessageIndex, records.Metadata)


class Contents(msgspec.Struct):
    """The contents of a file.

    Attributes:
        counts: number of messages by channel id.
        spans: first and last log time by channel id.
        start_ns, end_ns: first and last log time; None without a message.
        metadata: name and entries of each record, in the order of the file.
        attachments: name, media type and size of each.
        has_ended: it was closed properly.
    """

    schemas: dict[int, records.Schema] = msgspec.field(default_factory=dict)
    channels: dict[int, records.Channel] = msgspec.field(default_factory=dict)
    counts: Counter[int] = msgspec.field(default_factory=Counter)
    spans: dict[int, tuple[int, int]] = msgspec.field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int | None = None
    metadata: list[tuple[str, dict[str, str]]] = msgspec.field(default_factory=list)
    attachments: list[tuple[str, str, int]] = msgspec.field(default_factory=list)
    faults: Faults = msgspec.field(default_factory=Faults)
    has_ended: bool = False

    def fault(self, offset: int, detail: str) -> None:
        self.faults.add(f"byte {offset}: {detail}")


def read_contents(stream: BinaryIO) -> Contents | None:
    """The contents by the summary; None without a complete one."""
    summary = read_summary(stream)
    if summary is None or summary.statistics is None or not tells_all(summary, summary.statistics):
        return None
    statistics = summary.statistics
    counts = Counter(
        {channel_id: count for channel_id, count in statistics.channel_message_counts.items() if count}
    )
    try:
        places = _places(stream, summary)
    except DamagedError:
        return None
    if places is None or not counts.keys() <= places[0].keys():
        return None
    contents = Contents(
        schemas=summary.schemas,
        channels=summary.channels,
        counts=counts,
        start_ns=statistics.message_start_time if statistics.message_count else None,
        end_ns=statistics.message_end_time if statistics.message_count else None,
        attachments=[(one.name, one.media_type, one.data_size) for one in summary.attachments],
        has_ended=True,
    )
    for channel_id in counts:
        first = _times(stream, channel_id, places[0][channel_id], contents)
        last = _times(stream, channel_id, places[1][channel_id], contents)
        if first and last:
            contents.spans[channel_id] = min(first), max(last)
    for one in summary.metadata:
        record = _record(stream, one.offset, records.Metadata)
        if record is not None and record.name == one.name:
            contents.metadata.append((unnumbered(record.name), record.metadata))
        else:
            contents.fault(one.offset, f"the metadata {one.name} is not where the summary says")
    return contents


def walk_contents(
    stream: BinaryIO, size: int, progress: Progress = lambda _: None, *, is_being_written: bool = False
) -> Contents:
    """The contents by a scan, record by record. Nothing in the file raises."""
    contents = Contents()
    read_to = 0
    for piece in read_pieces(stream, size, is_verifying=False):
        if not (is_being_written and isinstance(piece, Fault) and piece.cuts):
            _take(contents, piece)
        if isinstance(piece, PackedChunk):
            progress(piece.end - read_to)
            read_to = piece.end
    progress(size - read_to)
    return contents


def tells_all(summary: LogSummary, statistics: records.Statistics) -> bool:
    """True if the summary repeats every schema and channel, and holds every index."""
    return (
        len(summary.schemas) >= statistics.schema_count
        and len(summary.channels) >= statistics.channel_count
        and len(summary.attachments) == statistics.attachment_count
        and len(summary.metadata) == statistics.metadata_count
        and statistics.message_count == sum(statistics.channel_message_counts.values())
    )


def _places(stream: BinaryIO, summary: LogSummary) -> tuple[dict[int, int], dict[int, int]] | None:
    """The offsets of each channel's first and last message index; None if chunks are not in time order."""
    first: dict[int, int] = {}
    last: dict[int, int] = {}
    start_ns = end_ns = 0
    for chunk in summary.chunks(stream):
        places = chunk.place_map()
        if places:
            if chunk.start_ns < start_ns or chunk.end_ns < end_ns:
                return None
            start_ns, end_ns = chunk.start_ns, chunk.end_ns
        last.update(places)
        if len(first) < len(last):
            first = places | first
    return first, last


def _times(stream: BinaryIO, channel_id: int, offset: int, contents: Contents) -> list[int]:
    record = _record(stream, offset, records.MessageIndex)
    if record is not None and record.channel_id == channel_id and record.records:
        return [time_ns for time_ns, _ in record.records]
    contents.fault(offset, f"the message index of channel {channel_id} is not where the summary says")
    return []


def _record(stream: BinaryIO, offset: int, kind: type[Kind]) -> Kind | None:
    try:
        return record_at(stream, offset, kind)
    except DamagedError:
        return None


def _take(contents: Contents, piece: Piece) -> None:
    match piece:
        case PackedChunk() if piece.index is not None and piece.index.keys() <= contents.channels.keys():
            _count(contents, piece.index, piece.offset)
        case PackedChunk() | MessageBlock():
            # Other writers declare channels within chunks.
            index, others = piece.read_index()
            for one in others:
                _take(contents, one)
            _count(contents, index, piece.offset)
        case records.Schema():
            contents.schemas.setdefault(piece.id, piece)
        case records.Channel():
            contents.channels.setdefault(piece.id, piece)
        case records.Attachment():
            contents.attachments.append((piece.name, piece.media_type, len(piece.data)))
        case records.Metadata():
            contents.metadata.append((unnumbered(piece.name), piece.metadata))
        case End():
            contents.has_ended = True
        case Fault():
            contents.fault(piece.offset, piece.detail)
        case _:
            pass


def _count(contents: Contents, index: Index, offset: int) -> None:
    """Count messages by their index, which alternates log times and offsets."""
    for channel_id, entries in index.items():
        if not entries:
            continue
        if channel_id not in contents.channels:
            contents.fault(
                offset, f"{len(entries) // 2} messages of channel {channel_id}, which the file does not hold"
            )
        times = entries[::2]
        first_ns, last_ns = min(times), max(times)
        before = contents.spans.get(channel_id, (first_ns, last_ns))
        contents.spans[channel_id] = min(before[0], first_ns), max(before[1], last_ns)
        contents.counts[channel_id] += len(times)
        contents.start_ns = first_ns if contents.start_ns is None else min(contents.start_ns, first_ns)
        contents.end_ns = last_ns if contents.end_ns is None else max(contents.end_ns, last_ns)


def place_of(topic: Topic) -> tuple[str, str]:
    """The topic without root and robot, and the robot."""
    key, side = key_of(topic.name)
    parts = keys.parse(key)
    if parts is None:
        return topic.name, ""
    if parts.recorder:
        return f"@recorder/{parts.recorder}/{parts.subject.name}{side}", ""
    return f"{parts.subject.name.format(bus=parts.bus)}{side}", topic.owner


def table_of(topic: Topic) -> str:
    """The name of a topic's table, without the bus, which is a column: ``can/can0/rx`` is ``can_rx``."""
    if topic.kind is RawSample:
        return "raw_sample"
    name = topic.name
    key, side = key_of(topic.name)
    parts = keys.parse(key)
    if parts is not None:
        name = parts.subject.name.replace("{bus}/", "") + side
        if parts.recorder:
            name = f"recorder/{name}"
    words = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").lower()
    return words if words and not words[0].isdigit() else f"topic_{words}"


def wants_of(patterns: Sequence[str]) -> Wants:
    """A test of topics by name, by the part after the robot, or by table; without patterns all pass."""

    def wants(topic: Topic) -> bool:
        names = (topic.name, place_of(topic)[0], table_of(topic))
        return not patterns or any(fnmatchcase(name, pattern) for pattern in patterns for name in names)

    return wants


def file_name(topic: str) -> str:
    """The file name of a topic: ``fleet/cruiser-1/state`` is ``fleet.cruiser-1.state``, escaped as in a URL."""
    chunks = [quote(chunk, safe="@ ", errors="replace").replace(".", "%2E") for chunk in topic.split("/")]
    name = ".".join(chunks)
    # A leading slash (ROS) would give a hidden file; a leading dash looks like an option.
    first = {".": "%2F", "-": "%2D"}.get(name[:1], name[:1])
    return f"{first}{name[1:]}"[:200] or "%"
