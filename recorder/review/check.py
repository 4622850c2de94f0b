"""The check of a log, whether it is what it says, and what it lacks: every byte, every checksum, every message.

In one pass, in memory that does not grow with the log but for 16 bytes a chunk and what each gap takes.
"""

from __future__ import annotations

from bisect import bisect_right
from pathlib import Path
from typing import BinaryIO, Final

import msgspec
from mcap import records

from recorder.mcap.arrays import Blocks
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
)
from recorder.reading.logs import is_being_written, open_log
from recorder.reading.rows import Progress
from recorder.review.checking.channel import Channel, ChannelCheck
from recorder.review.checking.findings import About, Finding, Findings
from recorder.review.checking.frames import ClockStep, FrameInfo
from recorder.review.checking.messages import faults_of_schema
from recorder.review.checking.structure import Structure
from schemas import keys

WAITING_BYTES_MAX: Final = 4_000_000
"""Size at which the messages that wait are judged together."""


class LogCheck(msgspec.Struct, frozen=True):
    """The result of checking a log.

    Attributes:
        whole: nothing is wrong with the file itself.
        is_being_written: a recorder has it open; that it has no end yet is no finding.
        messages: that were read.
        missed: samples missed on all channels.
        frames_lost: raw frames that never came, by their alive counters; see ``frames.AliveCount``.
        frames: the alive counters of each identifier.
        findings: the faults, those of the file first; ``untold`` more are about the file, too. Last is what is no
            fault, and worth knowing.
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
        """Nothing is wrong with the file, and nothing is missing in it."""
        return all(one.about is About.ALLOWED for one in self.findings)


def check_log(path: Path, progress: Progress = lambda _: None) -> LogCheck:
    """Check a log.

    Args:
        path: the file.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: there is no such file, or it is no MCAP file.
    """
    with open_log(path) as (stream, size):
        return _Check(stream, size, str(path), is_being_written=is_being_written(stream)).run(progress)


def check_stream(stream: BinaryIO, size: int, path: str, progress: Progress = lambda _: None) -> LogCheck:
    """As ``check_log``, of an open file that begins as MCAP does; ``path`` is what it is called."""
    return _Check(stream, size, path).run(progress)


def _robot_of(topic: str) -> str:
    parts = keys.parse(topic)
    return "" if parts is None else f"{parts.root}/{parts.robot}"


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
        steps: dict[str, list[ClockStep]] = {}
        for channel in by_topic:
            steps.setdefault(_robot_of(channel.topic), []).extend(channel.clock_steps)
        channels = [channel.sum_up(steps[_robot_of(channel.topic)]) for channel in by_topic]
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
            # Without the figures, which differ from chunk to chunk.
            self._findings.file(f"a chunk cannot be read: {why.partition(',')[0]}", piece.offset)
            self._structure.take_broken_chunk(piece)
        else:
            self._findings.file(f"a message cannot be read: {why}", piece.offset)

    def _judge(self) -> None:
        """Judge the messages that wait."""
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
                self._findings.file("messages are not what their schema says", offsets[block], topic=channel.topic)
