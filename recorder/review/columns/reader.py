"""The record batches of a log: topic by topic, some megabytes of it at once."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from io import BytesIO
from itertools import groupby
from typing import BinaryIO, Final

import msgspec
import numpy as np
import pyarrow as pa
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from numpy.typing import NDArray

from recorder.mcap.chunk import HEADER_IN_LENGTH, MESSAGE_HEADER, MESSAGE_OPCODE
from recorder.mcap.index import read_summary
from recorder.mcap.records import Fault, LooseMessage, PackedChunk, read_pieces
from recorder.mcap.scan import BROKEN
from recorder.mcap.summary import RECORD_HEADER
from recorder.reading.declared import Declared
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import END_OF_TIME_NS, Progress, Selection
from recorder.reading.topics import Topic
from recorder.review.columns.decoder import Decoder
from recorder.review.columns.places import (
    LOG_AT,
    PADDING,
    PUBLISH_AT,
    SEQUENCE_AT,
    Bytes,
    Indexed,
    Places,
    in_order,
    proven_places,
    words,
)
from recorder.review.columns.tables import Columns, columns_of
from recorder.review.columns.unpacking import Unpacker

BATCH_BYTES: Final = 4_000_000
"""So much is unpacked at once: enough that the work on a batch is more than that around it."""


class Heads(msgspec.Struct, frozen=True):
    """What the records of messages begin with. Times are nanoseconds since 1970."""

    log_ns: NDArray[np.uint64]
    publish_ns: NDArray[np.uint64]
    sequence: NDArray[np.uint32]


_DECLARED: Final = {Opcode.SCHEMA: records.Schema.read, Opcode.CHANNEL: records.Channel.read}
"""What else may stand in a chunk."""

Sift = Callable[[Topic, Heads], NDArray[np.bool_] | None]
"""Says which messages of a topic are to be read; None is all."""


class Batch(msgspec.Struct, frozen=True, eq=False):
    """Messages of one topic.

    Attributes:
        columns: the topic's.
        rows: their columns.
    """

    columns: Columns
    rows: pa.RecordBatch


def read_batches(
    log: LogFile,
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
    sift: Sift | None = None,
    wanted: Collection[str] | None = None,
) -> Iterator[Batch]:
    """The batches of a log, each of one topic in the order of the file.

    Args:
        log: the file.
        selection: topics and time.
        faults: takes what cannot be read; the rest is read all the same.
        progress: is told of bytes that were read or passed over.
        sift: says of each message by its head whether it is read; None reads all.
        wanted: names of the columns that are wanted; None is all.
    """
    try:
        with log.path.open("rb") as stream:
            yield from ColumnReader(stream, log, selection, faults, wanted).batches(progress, sift)
    except OSError as error:
        faults.add(f"{log.path}: {error.strerror or error}")


class _Pending:
    """Chunks that are unpacked, and wait to be read together."""

    def __init__(self) -> None:
        self.contents: list[bytes] = []
        self.chunks: list[Indexed | None] = []
        self.offsets: list[int] = []
        self.size = 0

    def add(self, offset: int, content: bytes, index: Mapping[int, array[int]] | None) -> None:
        """A chunk's records, or one record outside of chunks."""
        base, self.size = self.size, self.size + len(content)
        self.contents.append(content)
        self.chunks.append(None if index is None else Indexed(base, self.size, index))
        self.offsets.append(offset)

    def runs(self) -> Iterator[tuple[int, bytes, Indexed | None]]:
        """Each chunk with an index, and all between two of them at once."""
        for is_indexed, group in groupby(
            zip(self.offsets, self.contents, self.chunks, strict=True), key=lambda one: one[2] is not None
        ):
            if is_indexed:
                yield from group
            else:
                run = list(group)
                yield run[0][0], b"".join([content for _, content, _ in run]), None


class ColumnReader:
    """Reads the batches of one log.

    Args:
        stream: the file.
        log: which it is.
        selection: what is wanted.
        faults: takes what cannot be read.
        wanted: names of the columns that are wanted; None is all.

    Attributes:
        columns: by channel id, of the topics known so far.
    """

    def __init__(
        self,
        stream: BinaryIO,
        log: LogFile,
        selection: Selection,
        faults: Faults,
        wanted: Collection[str] | None = None,
    ) -> None:
        self._stream = stream
        self._unpacker = Unpacker(stream)
        self._size = log.bytes
        self._name = str(log.path)
        self._is_being_written = log.is_being_written
        self._selection = selection
        self._faults = faults
        self._wanted_columns = wanted
        self._declared = Declared(log.namesakes)
        self._decoders: dict[int, Decoder] = {}
        self._topics = self._declared.topics

    @property
    def columns(self) -> dict[int, Columns]:
        """Of the wanted topics, by channel id."""
        return {channel: decoder.columns for channel, decoder in self._decoders.items()}

    def batches(self, progress: Progress, sift: Sift | None) -> Iterator[Batch]:
        """The wanted batches."""
        # Others declare channels within chunks; the summary tells them before.
        self._want(self._declared.take_summary(read_summary(self._stream)))
        pending = _Pending()
        told = 0
        for piece in read_pieces(self._stream, self._size, is_verifying=False):
            match piece:
                case PackedChunk():
                    self._unpack(piece, pending)
                    progress(piece.offset + piece.length - told)
                    told = piece.offset + piece.length
                case LooseMessage():
                    pending.add(piece.offset, piece.raw, None)
                case Fault() if piece.cuts and self._is_being_written:
                    pass
                case Fault():
                    self._fault(piece.offset, piece.detail)
                case records.Schema() | records.Channel():
                    self._want(self._declared.take(piece))
                case _:
                    pass
            if pending.size >= BATCH_BYTES:
                yield from self._read(pending, sift)
                pending = _Pending()
        yield from self._read(pending, sift)
        for channel_id, decoder in self._decoders.items():
            if decoder.broken:
                self._faults.add(
                    f"{self._name}: {decoder.broken} messages of {self._topics[channel_id].name} cannot be read"
                )
        progress(self._size - told)

    def _unpack(self, chunk: PackedChunk, pending: _Pending) -> None:
        index = chunk.index
        if index is not None:
            if chunk.start_ns >= self._selection.to_ns or chunk.end_ns < self._selection.from_ns:
                return
            if not any(channel in self._decoders or channel not in self._topics for channel in index):
                return
        try:
            pending.add(chunk.offset, self._unpacker.unpack(chunk), index)
        except BROKEN as error:
            self._fault(chunk.offset, f"a chunk cannot be read: {error}")

    def _read(self, pending: _Pending, sift: Sift | None) -> Iterator[Batch]:
        if not pending.size:
            return
        content = np.frombuffer(b"".join([*pending.contents, bytes(PADDING)]), np.uint8)
        indexed = [chunk for chunk in pending.chunks if chunk is not None]
        places = None
        if len(indexed) == len(pending.chunks):
            places = proven_places(content, pending.size, indexed)
            if places is not None and any(channel not in self._topics for channel in places):
                places = None  # Perhaps the channels are within the chunks.
        if places is None:
            places = self._places_one_by_one(pending)
        for channel, found in places.items():
            decoder = self._decoders.get(channel)
            if decoder is not None:
                yield from self._batch(decoder, content, found, sift)

    def _batch(self, decoder: Decoder, content: Bytes, places: Places, sift: Sift | None) -> Iterator[Batch]:
        from_ns, to_ns = self._selection.from_ns, self._selection.to_ns
        if from_ns > 0 or to_ns < END_OF_TIME_NS:
            log_ns = words(content, "<u8", LOG_AT)[places.offsets]
            first, last = max(from_ns, 0), min(max(to_ns, 0), END_OF_TIME_NS) - 1
            is_within = (log_ns >= np.uint64(min(first, END_OF_TIME_NS - 1))) & (log_ns <= np.uint64(max(last, 0)))
            places = places.only(is_within & (last >= first))
        if sift is not None:
            is_new = sift(decoder.columns.topic, _heads(content, places))
            places = places if is_new is None else places.only(is_new)
        if len(places.offsets):
            batch = decoder.batch(content, places)
            if batch.num_rows:
                yield Batch(decoder.columns, batch)

    def _places_one_by_one(self, pending: _Pending) -> dict[int, Places]:
        """Each chunk by its own index, or where that is missing or wrong, record by record."""
        found: dict[int, list[Places]] = {}
        base = 0
        for offset, content, chunk in pending.runs():
            places = None
            if chunk is not None:
                padded = np.frombuffer(content + bytes(PADDING), np.uint8)
                places = proven_places(padded, len(content), [Indexed(0, len(content), chunk.index)])
                if places is None:
                    self._fault(offset, "the message indexes behind a chunk are wrong")
                elif any(channel not in self._topics for channel in places):
                    places = None
            if places is None:
                places = self._walk(offset, content)
            for channel, one in places.items():
                found.setdefault(channel, []).append(Places(one.offsets + base, one.lengths))
            base += len(content)
        return {
            channel: in_order(
                Places(
                    np.concatenate([one.offsets for one in parts]), np.concatenate([one.lengths for one in parts])
                )
            )
            for channel, parts in found.items()
        }

    def _walk(self, offset: int, content: bytes) -> dict[int, Places]:
        """Where the messages of each channel are, record by record; declares the channels between them."""
        found: dict[int, tuple[list[int], list[int]]] = {}
        at, end = 0, len(content)
        try:
            while at < end:
                opcode, length = RECORD_HEADER.unpack_from(content, at)
                behind = at + RECORD_HEADER.size + length
                if behind > end or (opcode == MESSAGE_OPCODE and length < HEADER_IN_LENGTH):
                    self._fault(offset, "a chunk holds half a record")
                    break
                if opcode == MESSAGE_OPCODE:
                    channel = MESSAGE_HEADER.unpack_from(content, at)[2]
                    offsets, lengths = found.setdefault(channel, ([], []))
                    offsets.append(at)
                    lengths.append(behind - at)
                elif opcode in _DECLARED:
                    body = content[at + RECORD_HEADER.size : behind]
                    self._want(self._declared.take(_DECLARED[Opcode(opcode)](ReadDataStream(BytesIO(body)))))
                at = behind
        except BROKEN as error:
            self._fault(offset, f"a record cannot be read: {error}")
        for channel, (offsets, _) in found.items():
            if channel not in self._topics:
                self._faults.add(
                    f"{self._name}: {len(offsets)} messages of channel {channel}, which the file does not hold"
                )
        return {
            channel: Places(np.array(offsets, np.int64), np.array(lengths, np.int64))
            for channel, (offsets, lengths) in found.items()
        }

    def _want(self, found: list[tuple[int, Topic]]) -> None:
        for channel_id, topic in found:
            if self._selection.wants(topic):
                self._decoders[channel_id] = Decoder(columns_of(topic), self._wanted_columns)

    def _fault(self, offset: int, detail: str) -> None:
        self._faults.add(f"{self._name}: byte {offset}: {detail}")


def _heads(content: Bytes, places: Places) -> Heads:
    return Heads(
        log_ns=words(content, "<u8", LOG_AT)[places.offsets],
        publish_ns=words(content, "<u8", PUBLISH_AT)[places.offsets],
        sequence=words(content, "<u4", SEQUENCE_AT)[places.offsets],
    )
