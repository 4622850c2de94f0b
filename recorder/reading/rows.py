"""The messages of logs, as rows in the order of their log times, of wanted topics and a wanted time alone.

A chunk that holds nothing wanted is not read from the disk, if the file has message indexes. Memory does not grow
with a log: of each open file one chunk is held.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from heapq import merge
from operator import attrgetter
from typing import Any, BinaryIO, Final

import msgspec
from mcap import records

from recorder.mcap.reader import (
    DamagedError,
    Fault,
    Index,
    LoggedMessage,
    MessageBlock,
    PackedChunk,
    read_pieces,
)
from recorder.mcap.summary_reader import read_summary
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.topics import UNREADABLE, Declared, Topic

END_OF_TIME_NS: Final = 2**64
"""Later than every log time."""

Wants = Callable[[Topic], bool]
Progress = Callable[[int], None]
"""Takes the number of bytes that a file has been read further."""


def every_topic(_topic: Topic) -> bool:
    """Wants all."""
    return True


def no_topic(_topic: Topic) -> bool:
    """Wants none."""
    return False


class Selection(msgspec.Struct, frozen=True):
    """A selection of messages by topic and log time.

    Attributes:
        wants: a test of topics.
        from_ns: the first log time, in nanoseconds since 1970...
        to_ns: ...and the first one that is too late.
    """

    wants: Wants = every_topic
    from_ns: int = 0
    to_ns: int = END_OF_TIME_NS


class Row(msgspec.Struct, frozen=True, gc=False):
    """A message of a log. Times are nanoseconds since 1970.

    Attributes:
        log_ns: when the recorder received it.
        publish_ns: when its source says that it was.
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
    """The rows of logs, merged by log time. A file is opened when its time has come.

    Args:
        logs: in the order of their beginnings, as ``find_logs`` gives them.
        selection: the wanted messages.
        faults: takes what cannot be read; the rest is read all the same.
        progress: receives the number of bytes that were read or passed over.
    """
    wanted = [log for log in logs if log.start_ns < selection.to_ns and log.end_ns >= selection.from_ns]
    groups: list[list[LogFile]] = []
    ends_ns = -1
    for log in wanted:
        if log.start_ns > ends_ns:
            groups.append([])
        groups[-1].append(log)
        ends_ns = max(ends_ns, log.end_ns)
    for group in groups:
        # Only what overlaps in time needs to be open at the same time.
        rows = (_rows_from(log, selection, faults, progress) for log in group)
        yield from merge(*rows, key=attrgetter("log_ns"))


def decoded_rows(
    logs: Sequence[LogFile],
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Iterator[tuple[Row, Any]]:
    """Read the rows of logs, as ``read_rows`` does, each with its message; None where nobody here can read such.

    What is not of its schema is a fault, and left out.
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
    """Reads what may hold something wanted of one log: chunks, unpacked, and messages outside of chunks.

    Args:
        stream: the file.
        log: the log that the file is.
        selection: the wanted messages.
        faults: takes what cannot be read.

    Attributes:
        name: of the log.
        topics: by channel id, those known so far.
        wanted: those of them that are wanted.
        metadata: all metadata records by name, the last of each.
        attachments: those met so far.
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
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[records.Attachment] = []
        # Others declare channels within chunks; the summary repeats them.
        self._want(self._declared.take_summary(read_summary(stream)))

    def declare_all(self) -> None:
        """Learn the topics of a log whose summary says nothing of them."""
        for block, _ in self.blocks():
            for one in block.messages():
                if isinstance(one, records.Schema | records.Channel):
                    self.take(one)

    def blocks(self, progress: Progress = lambda _: None) -> Iterator[tuple[MessageBlock, Index | None]]:
        """The blocks in the order of the file, each with what its index says, if it has one."""
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
                    self.metadata[piece.name] = piece.metadata
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
        """Take what stands between messages."""
        if isinstance(piece, Fault):
            self.fault(f"byte {piece.offset}: {piece.detail}")
        else:
            self._want(self._declared.take(piece))

    def fault(self, detail: str) -> None:
        """Something of the log cannot be read."""
        self._faults.add(f"{self.name}: {detail}")

    def wrong_index(self, block: MessageBlock) -> None:
        """The message indexes of a block do not fit its messages."""
        self.take(Fault(block.offset, "the message indexes behind a chunk are wrong"))

    def _unpacked(self, chunk: PackedChunk) -> Iterator[tuple[MessageBlock, Index | None]]:
        index = chunk.index
        if index is not None:
            # Without an index its head is all there is to go by, which may be wrong.
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
        """The wanted rows, in the order of the file."""
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
