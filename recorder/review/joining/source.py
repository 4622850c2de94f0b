"""One log that is copied from: where its chunks stand, and its messages chunk by chunk, in the order of time."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from operator import itemgetter
from typing import BinaryIO, Final, TypeVar

from mcap import records

from recorder.mcap.channel import LogChannel
from recorder.mcap.reader import (
    FIRST_RECORD,
    DamagedError,
    DeclaredRoom,
    Fault,
    LoggedMessage,
    MessageBlock,
    PackedChunk,
    messages_at,
    read_pieces,
    record_at,
)
from recorder.mcap.summary_reader import read_summary
from recorder.reading.contents import tells_all
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile

STRETCH_BYTES: Final = 1 << 20
"""Messages outside of chunks are read so much at a time."""

Row = tuple[int, int, int, int, bytes]
"""Log time, channel of the new file, sequence, publish time, data."""

Choose = Callable[[LogChannel], int | None]
"""The id that a channel has in the new file; None if its messages are not wanted. Its own id says nothing."""

Kind = TypeVar("Kind", records.Header, records.Metadata, records.Attachment)


class JoinSource:
    """A log. Its file is open only while it is read: there may be more of them than files that may be open.

    Args:
        log: the file.
        choose: is asked once for each channel, in the order of the log.
        faults: takes what cannot be read.

    Attributes:
        profile: the header's promise.
        metadata: the metadata records, or where they stand in the file...
        attachments: ...and the attachments.
        starts, ends: the first and the last log time of each chunk, or stretch of messages outside of chunks.

    Raises:
        OSError: it cannot be read.
    """

    def __init__(self, log: LogFile, choose: Choose, faults: Faults) -> None:
        self._log = log
        self._size = log.bytes if log.stored is None else log.stored.size
        self._is_being_written = log.is_being_written
        self._choose = choose
        self._faults = faults
        self._room = DeclaredRoom()
        self._schemas: dict[int, records.Schema] = {}
        self._ids: dict[int, int | None] = {}
        self._lost: set[int] = set()
        self.metadata: list[int | records.Metadata] = []
        self.attachments: list[int | records.Attachment] = []
        self.starts, self.ends = array("Q"), array("Q")
        self._offsets, self._lengths = array("Q"), array("Q")
        self._loose: set[int] = set()
        with self._log.open() as stream:
            header = self._read(stream, FIRST_RECORD, records.Header)
            self.profile = "" if header is None else str(header.profile)
            if not self._look_at_summary(stream):
                self._look_at_records(stream)

    def length(self, number: int) -> int:
        """Bytes of a chunk or stretch in the file."""
        return self._lengths[number]

    def rows(self, number: int, from_ns: int, to_ns: int) -> list[Row]:
        """The wanted messages of a chunk or stretch, by their log times; unreadable ones are reported."""
        offset, length = self._offsets[number], self._lengths[number]
        try:
            with self._log.open() as stream:
                if number in self._loose:
                    stream.seek(offset)
                    messages = MessageBlock(offset, stream.read(length)).messages()
                else:
                    messages = messages_at(stream, offset, length, self._room)
                found = list(self._sift(offset, messages, from_ns, to_ns))
        except OSError as error:
            self._fault(offset, f"a chunk cannot be read: {error}")
            return []
        found.sort(key=itemgetter(0))
        return found

    def read_metadata(self) -> Iterator[records.Metadata]:
        """The metadata records that can be read."""
        return self._each(self.metadata, records.Metadata)

    def read_attachments(self) -> Iterator[records.Attachment]:
        """The attachments that can be read."""
        return self._each(self.attachments, records.Attachment)

    def _each(self, places: Sequence[int | Kind], kind: type[Kind]) -> Iterator[Kind]:
        for one in places:
            record = self._read_at(one, kind) if isinstance(one, int) else one
            if record is not None:
                yield record

    def _sift(self, offset: int, messages: Iterator[object], from_ns: int, to_ns: int) -> Iterator[Row]:
        ids = self._ids
        for one in messages:
            if isinstance(one, LoggedMessage):
                chosen = ids.get(one.channel_id)
                if chosen is not None and from_ns <= one.log_ns < to_ns:
                    yield one.log_ns, chosen, one.sequence, one.publish_ns, one.data
                elif one.channel_id not in ids and one.channel_id not in self._lost:
                    self._lost.add(one.channel_id)
                    self._fault(offset, f"messages of channel {one.channel_id}, which the file does not hold")
            else:
                self._take(one)

    def _look_at_summary(self, stream: BinaryIO) -> bool:
        """Return True if the end of the file gave all."""
        summary = read_summary(stream)
        statistics = None if summary is None else summary.statistics
        if summary is None or statistics is None or not tells_all(summary, statistics):
            return False
        if statistics.message_count and statistics.chunk_count == 0:
            return False
        with suppress(DamagedError):
            for chunk in summary.chunks(stream):
                self._add(chunk.offset, chunk.length, chunk.start_ns, chunk.end_ns)
        if len(self.starts) != statistics.chunk_count or any(
            not FIRST_RECORD <= offset < self._size for offset in self._offsets
        ):
            for column in (self.starts, self.ends, self._offsets, self._lengths):
                del column[:]
            return False
        for schema in summary.schemas.values():
            self._take(schema)
        for channel in summary.channels.values():
            self._take(channel)
        self.metadata = [one.offset for one in summary.metadata]
        self.attachments = [one.offset for one in summary.attachments]
        return True

    def _look_at_records(self, stream: BinaryIO) -> None:
        for piece in read_pieces(stream, self._size, is_verifying=False):
            match piece:
                case PackedChunk():
                    self._add(piece.offset, piece.length, piece.start_ns, piece.end_ns)
                case MessageBlock():
                    self._add_loose(piece)
                case records.Metadata():
                    self.metadata.append(piece)
                case records.Attachment():
                    self.attachments.append(piece)
                case Fault() if piece.cuts and self._is_being_written:
                    pass
                case _:
                    self._take(piece)

    def _add(self, offset: int, length: int, start_ns: int, end_ns: int) -> None:
        self._offsets.append(offset)
        self._lengths.append(length)
        self.starts.append(start_ns)
        self.ends.append(end_ns)

    def _add_loose(self, piece: MessageBlock) -> None:
        """A message outside of chunks, which lengthens the stretch before it or begins another."""
        found = next(piece.messages(), None)
        if not isinstance(found, LoggedMessage):
            return
        last = len(self.starts) - 1
        length = piece.offset + len(piece.content) - (self._offsets[last] if last >= 0 else 0)
        if last in self._loose and length <= STRETCH_BYTES:
            self._lengths[last] = length
            self.starts[last] = min(self.starts[last], found.log_ns)
            self.ends[last] = max(self.ends[last], found.log_ns)
        else:
            self._loose.add(last + 1)
            self._add(piece.offset, len(piece.content), found.log_ns, found.log_ns)

    def _take(self, record: object) -> None:
        match record:
            case Fault():
                self._fault(record.offset, record.detail)
            case records.Schema():
                self._schemas.setdefault(record.id, record)
            case records.Channel() if record.id not in self._ids:
                schema = self._schemas.get(record.schema_id)
                self._ids[record.id] = self._choose(
                    LogChannel(
                        channel_id=record.id,
                        topic=record.topic,
                        schema_name="" if schema is None else schema.name,
                        schema_data=b"" if schema is None else schema.data,
                        schema_encoding="" if schema is None else schema.encoding,
                        message_encoding=record.message_encoding,
                        metadata=record.metadata,
                    )
                )
            case _:
                pass

    def _read_at(self, offset: int, kind: type[Kind]) -> Kind | None:
        try:
            with self._log.open() as stream:
                return self._read(stream, offset, kind)
        except OSError as error:
            self._fault(offset, error.strerror or str(error))
            return None

    def _read(self, stream: BinaryIO, offset: int, kind: type[Kind]) -> Kind | None:
        found = None
        with suppress(DamagedError):
            found = record_at(stream, offset, kind)
        if found is None:
            self._fault(offset, "a record cannot be read")
        return found

    def _fault(self, offset: int, detail: str) -> None:
        self._faults.add(f"{self._log.name}: byte {offset}: {detail}")
