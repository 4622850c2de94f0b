"""The check of a log: every byte, every checksum, every message, and the data it lacks.

One pass, in memory that grows with the log only by 16 bytes a chunk (about 10 MB for a log of 10 GB) and by its
gaps.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Final

import msgspec
import numpy as np
from mcap import records

from recorder.mcap.arrays import Blocks, Read
from recorder.mcap.reader import (
    FIRST_RECORD,
    DamagedError,
    End,
    Fault,
    Index,
    MessageBlock,
    PackedChunk,
    PassedOver,
    Piece,
    SummaryStart,
    read_pieces,
    record_at,
)
from recorder.mcap.summary_reader import LogSummary, read_summary
from recorder.reading.logs import is_being_written, open_log
from recorder.reading.rows import Progress
from recorder.review.checking import Channel, ChannelCheck, FrameInfo, faults_of_schema
from recorder.review.flaws import About, Finding, Findings
from schemas.subjects import RECORDER_CHUNK


class Structure:
    """Follows a file through its data, and then compares its summary."""

    def __init__(self, findings: Findings) -> None:
        self.messages: Counter[int] = Counter()
        self._findings = findings
        self._counts: Counter[type] = Counter()
        self._start_ns: int | None = None
        self._end_ns = 0
        self._newest_ns = 0
        self._offsets = array("Q")
        self._digests = array("q")
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._own: set[int] = set()

    def take_schema(self, schema: records.Schema, *, is_repeated: bool = False) -> bool:
        """Take a schema of the data or the summary. True if it is the first of its id."""
        before = self._schemas.get(schema.id)
        if is_repeated:
            if before is None or vars(before) != vars(schema):
                self._findings.file(f"the summary's schema {schema.name} is not in the data")
            return False
        if before is not None and vars(before) != vars(schema):
            self._findings.file(f"the schema {schema.name} has the id of another one")
        if schema.id == 0:
            self._findings.file(f"the schema {schema.name} has the id 0, which means none")
        self._schemas.setdefault(schema.id, schema)
        return before is None

    def take_channel(self, channel: records.Channel, *, is_repeated: bool = False) -> bool:
        """Take a channel of the data or the summary. True if it is the first of its id."""
        before = self._channels.get(channel.id)
        if is_repeated:
            if before is None or vars(before) != vars(channel):
                self._findings.file("the summary's channel is not in the data", topic=channel.topic)
            return False
        if before is not None and vars(before) != vars(channel):
            self._findings.file("the channel has the id of another one", topic=channel.topic)
        elif before is None and channel.schema_id not in self._schemas:
            if channel.schema_id:
                self._findings.file("its schema is missing", topic=channel.topic)
            else:
                self._findings.allowed("the channel has no schema", topic=channel.topic)
        self._channels.setdefault(channel.id, channel)
        if RECORDER_CHUNK in channel.topic.split("/"):
            self._own.add(channel.id)
        return before is None

    def count(self, kind: type) -> None:
        self._counts[kind] += 1

    def take_messages(
        self, read: Read, bases: Sequence[int], offsets: Sequence[int]
    ) -> list[tuple[int, int] | None]:
        """Take the messages of blocks. Returns the first and the last log time of each; None without messages.

        ``bases`` are the blocks' starts in ``read.content``, then its end; ``offsets`` are in the file.
        """
        for channel, places in read.places.items():
            self.messages[channel] += len(places.offsets)
        spans: list[tuple[int, int] | None] = [None] * len(offsets)
        if not read.places:
            return spans
        starts = np.concatenate([places.starts for places in read.places.values()])
        order = np.argsort(starts, kind="stable")
        log_ns = np.concatenate([places.log_ns(read.content) for places in read.places.values()])[order]
        self._start_ns = min(int(log_ns.min()), int(log_ns[0]) if self._start_ns is None else self._start_ns)
        self._end_ns = max(self._end_ns, int(log_ns.max()))
        # Without the recorder's own messages, which may have waited for a file.
        is_own = np.concatenate([np.full(len(one.offsets), key in self._own) for key, one in read.places.items()])
        received = ~is_own[order]
        times = np.concatenate([[np.uint64(self._newest_ns)], log_ns[received]])
        self._newest_ns = int(times[-1])
        block_of = np.searchsorted(bases, starts[order], "right") - 1
        for block, count in Counter(block_of[received][times[1:] < times[:-1]].tolist()).items():
            self._findings.allowed("the log time goes backwards", offsets[block], count=count)
        filled, first = np.unique(block_of, return_index=True)
        lowest, highest = np.minimum.reduceat(log_ns, first), np.maximum.reduceat(log_ns, first)
        for block, start_ns, end_ns in zip(filled.tolist(), lowest.tolist(), highest.tolist(), strict=True):
            spans[block] = start_ns, end_ns
        return spans

    def take_chunk(self, piece: PackedChunk, size: int, span: tuple[int, int] | None, *, is_indexed: bool) -> None:
        """Take a readable chunk: the size of its records, and its first and last log time."""
        chunk = piece.described()
        if chunk.unpacked != size:
            self._findings.file("a chunk states a wrong size", piece.offset)
        if (chunk.start_ns, chunk.end_ns) != (span or (0, 0)):
            self._findings.file("a chunk states wrong times", piece.offset)
        if span is not None and not piece.places:
            self._findings.allowed("a chunk has no message indexes", piece.offset)
        if not is_indexed:
            self._findings.file("the message indexes behind a chunk are wrong", piece.offset)
        self._offsets.append(piece.offset)
        self._digests.append(chunk.digest())

    def take_broken_chunk(self, piece: PackedChunk) -> None:
        """Take an unreadable chunk, of which only the place can be compared."""
        self._offsets.append(piece.offset)
        self._digests.append(0)

    def compare_statistics(self, statistics: records.Statistics) -> None:
        counted = {
            "messages": (statistics.message_count, self.messages.total()),
            "schemas": (statistics.schema_count, len(self._schemas)),
            "channels": (statistics.channel_count, len(self._channels)),
            "chunks": (statistics.chunk_count, len(self._offsets)),
            "attachments": (statistics.attachment_count, self._counts[records.Attachment]),
            "metadata records": (statistics.metadata_count, self._counts[records.Metadata]),
        }
        for name, (stated, found) in counted.items():
            if stated != found:
                self._findings.file(f"the file states {stated} {name}; {found} were found")
        times = (self._start_ns or 0, self._end_ns)
        if (statistics.message_start_time, statistics.message_end_time) != times:
            self._findings.file("the file states wrong first and last times")
        by_channel = statistics.channel_message_counts
        if statistics.message_count and not by_channel:
            self._findings.allowed("the file does not state the number of messages of each channel")
            return
        for channel_id in sorted(by_channel.keys() | self.messages.keys()):
            stated, found = by_channel.get(channel_id, 0), self.messages[channel_id]
            if stated != found:
                topic = self._channels[channel_id].topic if channel_id in self._channels else str(channel_id)
                self._findings.file(f"the file states {stated} messages; {found} were found", topic=topic)

    def compare_summary(self, stream: BinaryIO) -> None:
        """Compare the indexes of the summary; a wrong checksum has been reported."""
        summary = read_summary(stream)
        if summary is None:
            return
        try:
            for _ in summary.wrong_groups(stream):
                self._findings.file("the summary's own offsets are wrong", summary.offset_start)
            self._compare_chunks(stream, summary)
            for attachment in summary.attachments:
                self._compare_record(stream, attachment)
            for metadata in summary.metadata:
                self._compare_record(stream, metadata)
        except DamagedError as error:
            self._findings.file(f"the summary cannot be read: {error}", summary.start)

    def _compare_chunks(self, stream: BinaryIO, summary: LogSummary) -> None:
        at = {offset: place for place, offset in enumerate(self._offsets)} if summary.chunks_at else {}
        indexed = 0
        for chunk in summary.chunks(stream):
            indexed += 1
            place = at.get(chunk.offset)
            if place is None:
                self._findings.file("the summary's index has a chunk that does not exist", summary.start)
            elif self._digests[place] not in {0, chunk.digest()}:
                self._findings.file("the summary's index of a chunk is wrong", chunk.offset)
        if summary.chunks_at and indexed != len(self._offsets):
            self._findings.file(
                f"the summary's index holds {indexed} chunks; {len(self._offsets)} were found", summary.start
            )

    def _compare_record(self, stream: BinaryIO, index: records.AttachmentIndex | records.MetadataIndex) -> None:
        is_attachment = isinstance(index, records.AttachmentIndex)
        found = (
            record_at(stream, index.offset, records.Attachment, index.length)
            if is_attachment
            else record_at(stream, index.offset, records.Metadata, index.length)
        )
        if found is None or _facts(found) != _facts(index):
            what = "attachment" if is_attachment else "metadata"
            self._findings.file(f"the summary's index of the {what} {index.name} is wrong", index.offset)


def _facts(
    record: records.Attachment | records.AttachmentIndex | records.Metadata | records.MetadataIndex,
) -> tuple[object, ...]:
    match record:
        case records.Attachment():
            size = len(record.data)
        case records.AttachmentIndex():
            size = record.data_size
        case _:
            return (record.name,)
    return record.name, record.media_type, record.log_time, record.create_time, size


WAITING_BYTES_MAX: Final = 4_000_000  # messages checked together


class LogCheck(msgspec.Struct, frozen=True):
    """The result of checking a log.

    Attributes:
        is_being_written: a recorder has it open; its missing end is no finding.
        frames_lost: raw frames that never arrived, by their alive counters; see ``AliveCount``.
        findings: about the file, about the data, then what is allowed; ``untold`` more are about the file.
    """

    path: str
    bytes: int
    whole: bool
    is_being_written: bool
    messages: int
    missed: int
    frames_lost: int
    channels: list[ChannelCheck]
    frames: list[FrameInfo]
    findings: list[Finding]
    untold: int

    @property
    def is_sound(self) -> bool:
        """True without faults of the file and losses of data."""
        return all(one.about is About.ALLOWED for one in self.findings)


def check_log(path: Path, progress: Progress = lambda _: None) -> LogCheck:
    """Check a log; CommandError if there is no such file, or it is no MCAP file."""
    with open_log(path) as (stream, size):
        return _Check(stream, size, str(path), is_being_written=is_being_written(stream)).run(progress)


def check_stream(stream: BinaryIO, size: int, path: str, progress: Progress = lambda _: None) -> LogCheck:
    """As ``check_log``, for an open MCAP file; ``path`` is its name in findings."""
    return _Check(stream, size, path).run(progress)


class _Check:
    def __init__(self, stream: BinaryIO, size: int, path: str, *, is_being_written: bool = False) -> None:
        self._is_being_written = is_being_written
        self._stream = stream
        self._size = size
        self._path = path
        self._findings = Findings(path)
        self._structure = Structure(self._findings)
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._pending = Blocks()
        self._pieces: list[PackedChunk | MessageBlock] = []
        self._statistics: records.Statistics | None = None
        self._has_header = self._is_in_summary = self._has_ended = False
        self._read_to = 0

    def run(self, progress: Progress) -> LogCheck:
        for piece in read_pieces(self._stream, self._size):
            self._take(piece)
            if isinstance(piece, PackedChunk):
                progress(piece.end - self._read_to)
                self._read_to = piece.end
        self._judge()
        progress(self._size - self._read_to)
        if not self._has_header:
            self._findings.file("the file has no header", FIRST_RECORD)
        if self._statistics is not None:
            self._structure.compare_statistics(self._statistics)
        if self._has_ended:
            self._structure.compare_summary(self._stream)
        return self._sum_up()

    def _sum_up(self) -> LogCheck:
        findings = self._findings
        by_topic = sorted(self._channels.values(), key=lambda one: one.topic)
        channels = [channel.sum_up() for channel in by_topic]
        frames = [info for channel in by_topic if channel.frames for info in channel.frames.info(channel.topic)]
        return LogCheck(
            path=self._path,
            bytes=self._size,
            whole=self._has_ended and not findings.has(About.FILE),
            is_being_written=self._is_being_written,
            messages=self._structure.messages.total(),
            missed=sum(channel.missed or 0 for channel in channels),
            frames_lost=sum(frame.lost + frame.unseen for frame in frames),
            channels=channels,
            frames=frames,
            findings=findings.told,
            untold=findings.untold,
        )

    def _take(self, piece: Piece) -> None:
        match piece:
            case PackedChunk():
                self._unpack(piece)
            case MessageBlock():
                self._add(piece, piece)
            case records.Schema() | records.Channel():
                self._judge()
                self._declare(piece)
            case records.Statistics():
                self._statistics = piece
            case PassedOver():
                what = f"a record of a later version of MCAP (opcode {piece.opcode:#04x}) is not read"
                self._findings.allowed(what, piece.offset)
            case SummaryStart():
                self._judge()
                self._is_in_summary = True
            case End():
                self._has_ended = True
            case Fault():
                if not (piece.cuts and self._is_being_written):
                    self._findings.file(piece.detail, piece.offset)
            case _:
                self._has_header = self._has_header or isinstance(piece, records.Header)
                self._structure.count(type(piece))

    def _declare(self, record: records.Schema | records.Channel) -> None:
        if isinstance(record, records.Schema):
            if self._structure.take_schema(record, is_repeated=self._is_in_summary):
                self._schemas[record.id] = record
                for fault in faults_of_schema(record):
                    self._findings.file(fault)
        elif self._structure.take_channel(record, is_repeated=self._is_in_summary):
            self._channels[record.id] = Channel(record, self._schemas.get(record.schema_id), self._findings)

    def _unpack(self, piece: PackedChunk) -> None:
        try:
            block = piece.unpack()
        except DamagedError as error:
            self._broken(piece, str(error))
        else:
            self._add(piece, block, piece.index)

    def _add(self, piece: PackedChunk | MessageBlock, block: MessageBlock, index: Index | None = None) -> None:
        self._pieces.append(piece)
        self._pending.add(block, index)
        if self._pending.size > WAITING_BYTES_MAX:
            self._judge()

    def _broken(self, piece: PackedChunk | MessageBlock, why: str) -> None:
        if isinstance(piece, PackedChunk):
            # Without figures, which differ between chunks.
            self._findings.file(f"a chunk cannot be read: {why.partition(',')[0]}", piece.offset)
            self._structure.take_broken_chunk(piece)
        else:
            self._findings.file(f"a message cannot be read: {why}", piece.offset)

    def _judge(self) -> None:
        """Check the waiting messages."""
        pieces, pending = self._pieces, self._pending
        if not pieces:
            return
        self._pieces, self._pending = [], Blocks()
        read = pending.read()
        broken = set()
        for place, one in read.others:
            if isinstance(one, Fault):
                broken.add(place)
                self._broken(pieces[place], one.detail)
            else:
                self._declare(one)
        offsets = [piece.offset for piece in pieces]
        spans = self._structure.take_messages(read, pending.bases, offsets)
        for place, (piece, span) in enumerate(zip(pieces, spans, strict=True)):
            if isinstance(piece, PackedChunk) and place not in broken:
                size = len(pending.blocks[place].content)
                self._structure.take_chunk(piece, size, span, is_indexed=place not in read.wrong)
        for channel_id, places in sorted(read.places.items()):
            channel = self._channels.get(channel_id)
            if channel is None:
                what = f"messages of channel {channel_id}, which the file does not hold"
                block = bisect_right(pending.bases, int(places.starts[0])) - 1
                self._findings.file(what, offsets[block], count=len(places.offsets))
                continue
            for number in channel.take(read.content, places):
                block = bisect_right(pending.bases, int(places.starts[number])) - 1
                self._findings.file("messages do not match their schema", offsets[block], topic=channel.topic)
