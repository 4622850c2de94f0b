"""The messages of logs, as rows in the order of their log times, of wanted topics and a wanted time alone.

A chunk that holds nothing wanted is not read from the disk, if the file has message indexes. Memory does not grow
with a log: of each open file one chunk is held.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from heapq import merge
from operator import attrgetter
from typing import BinaryIO, Final

import msgspec
from mcap import records

from recorder.mcap.reader import DamagedError, Fault, LoggedMessage, MessageBlock, PackedChunk, read_pieces
from recorder.mcap.summary_reader import read_summary
from recorder.reading.declared import Declared
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.topics import Topic

END_OF_TIME_NS: Final = 2**64
"""Later than every log time."""

Wants = Callable[[Topic], bool]
Progress = Callable[[int], None]
"""Takes the number of bytes that a file has been read further."""


def every_topic(_topic: Topic) -> bool:
    """Wants all."""
    return True


class Selection(msgspec.Struct, frozen=True):
    """What is wanted of logs.

    Attributes:
        wants: whether a topic is wanted.
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
        selection: what is wanted.
        faults: takes what cannot be read; the rest is read all the same.
        progress: is told of bytes that were read or passed over.
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


def _rows_from(log: LogFile, selection: Selection, faults: Faults, progress: Progress) -> Iterator[Row]:
    try:
        with log.path.open("rb") as stream:
            yield from LogReader(stream, log, selection, faults).rows(progress)
    except OSError as error:
        faults.add(f"{log.path}: {error.strerror or error}")


class LogReader:
    """Reads the rows of one log.

    Args:
        stream: the file.
        log: which it is.
        selection: what is wanted.
        faults: takes what cannot be read.

    Attributes:
        topics: by channel id, those known so far.
        metadata: all metadata records by name, the last of each.
        attachments: those met so far.
    """

    def __init__(self, stream: BinaryIO, log: LogFile, selection: Selection, faults: Faults) -> None:
        self._stream = stream
        self._size = log.bytes
        self._name = str(log.path)
        self._is_being_written = log.is_being_written
        self._selection = selection
        self._faults = faults
        self._declared = Declared(log.namesakes)
        self._wanted: dict[int, Topic] = {}
        self.topics = self._declared.topics
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[records.Attachment] = []

    def rows(self, progress: Progress = lambda _: None) -> Iterator[Row]:
        """The wanted rows, in the order of the file."""
        # Others declare channels within chunks; the summary tells them before.
        self._want(self._declared.take_summary(read_summary(self._stream)))
        told = 0
        for piece in read_pieces(self._stream, self._size, is_verifying=False):
            match piece:
                case PackedChunk():
                    yield from self._rows(piece)
                    progress(piece.offset + piece.length - told)
                    told = piece.offset + piece.length
                case MessageBlock():
                    yield from self._sift(piece.messages())
                case records.Metadata():
                    self.metadata[piece.name] = piece.metadata
                case records.Attachment():
                    self.attachments.append(piece)
                case Fault() if piece.cuts and self._is_being_written:
                    pass
                case Fault():
                    self._fault(piece.offset, piece.detail)
                case records.Schema() | records.Channel():
                    self._take(piece)
                case _:
                    pass
        progress(self._size - told)

    def _rows(self, chunk: PackedChunk) -> Iterator[Row]:
        if not self._may_hold(chunk):
            return
        if chunk.index is None or not chunk.index.keys() <= self.topics.keys():
            yield from self._sift(chunk.messages())
            return
        try:
            block = chunk.unpack()
        except DamagedError as error:
            self._fault(chunk.offset, f"a chunk cannot be read: {error}")
            return
        found = block.pick(chunk.index, self._wanted, Row, self._selection.from_ns, self._selection.to_ns)
        if found is None:
            self._fault(chunk.offset, "the message indexes behind a chunk are wrong")
            yield from self._sift(block.messages())
        else:
            yield from found

    def _may_hold(self, chunk: PackedChunk) -> bool:
        """Whether something wanted may be in it; without an index its head is all there is to go by."""
        if chunk.index is None:
            return True
        if chunk.start_ns >= self._selection.to_ns or chunk.end_ns < self._selection.from_ns:
            return False
        return any(channel in self._wanted or channel not in self.topics for channel in chunk.index)

    def _sift(self, found: Iterator[LoggedMessage | records.Schema | records.Channel | Fault]) -> Iterator[Row]:
        from_ns, to_ns = self._selection.from_ns, self._selection.to_ns
        for one in found:
            if not isinstance(one, LoggedMessage):
                self._take(one)
            elif one.channel_id not in self.topics:
                self._faults.add(
                    f"{self._name}: a message of channel {one.channel_id}, which the file does not hold"
                )
            elif one.channel_id in self._wanted and from_ns <= one.log_ns < to_ns:
                yield Row(self.topics[one.channel_id], one.sequence, one.log_ns, one.publish_ns, one.data)

    def _take(self, piece: records.Schema | records.Channel | Fault) -> None:
        if isinstance(piece, Fault):
            self._fault(piece.offset, piece.detail)
        else:
            self._want(self._declared.take(piece))

    def _want(self, found: list[tuple[int, Topic]]) -> None:
        self._wanted.update((channel_id, topic) for channel_id, topic in found if self._selection.wants(topic))

    def _fault(self, offset: int, detail: str) -> None:
        self._faults.add(f"{self._name}: byte {offset}: {detail}")
