"""The record batches of a log: topic by topic, some megabytes of it at once."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from itertools import groupby
from typing import BinaryIO, Final

import msgspec
import numpy as np
import pyarrow as pa
from mcap import records
from numpy.typing import NDArray

from recorder.mcap.arrays import PADDING, Bytes, Indexed, Places, joined, proven_places, walked_places
from recorder.mcap.reader import DamagedError, Fault, MessageBlock, PackedChunk, read_pieces
from recorder.mcap.summary_reader import read_summary
from recorder.reading.declared import Declared
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import END_OF_TIME_NS, Progress, Selection
from recorder.reading.topics import Topic
from recorder.review.columns.decoder import Decoder
from recorder.review.columns.tables import Columns, columns_of

BATCH_BYTES: Final = 4_000_000
"""So much is unpacked at once: enough that the work on a batch is more than that around it."""


class Heads(msgspec.Struct, frozen=True):
    """What the records of messages begin with. Times are nanoseconds since 1970."""

    log_ns: NDArray[np.uint64]
    publish_ns: NDArray[np.uint64]
    sequence: NDArray[np.uint32]


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
        self.blocks: list[MessageBlock] = []
        self.chunks: list[Indexed | None] = []
        self.size = 0

    def add(self, block: MessageBlock, index: Mapping[int, array[int]] | None = None) -> None:
        """A chunk's records, or one record outside of chunks."""
        base, self.size = self.size, self.size + len(block.content)
        self.blocks.append(block)
        self.chunks.append(None if index is None else Indexed(base, self.size, index))

    @property
    def content(self) -> bytes:
        """All records, and padding behind."""
        return b"".join([*(block.content for block in self.blocks), bytes(PADDING)])

    def runs(self) -> Iterator[tuple[MessageBlock, Indexed | None]]:
        """Each chunk with an index, and all between two of them at once."""
        for is_indexed, group in groupby(
            zip(self.blocks, self.chunks, strict=True), key=lambda one: one[1] is not None
        ):
            if is_indexed:
                yield from group
            else:
                run = [block for block, _ in group]
                yield MessageBlock(run[0].offset, b"".join([block.content for block in run])), None


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
                case MessageBlock():
                    pending.add(piece)
                case Fault() if piece.cuts and self._is_being_written:
                    pass
                case Fault() | records.Schema() | records.Channel():
                    self._take(piece)
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
            pending.add(chunk.unpack(), index)
        except DamagedError as error:
            self._fault(chunk.offset, f"a chunk cannot be read: {error}")

    def _read(self, pending: _Pending, sift: Sift | None) -> Iterator[Batch]:
        if not pending.size:
            return
        content = np.frombuffer(pending.content, np.uint8)
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
            log_ns = places.log_ns(content)
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
        for block, chunk in pending.runs():
            places = None
            if chunk is not None:
                size = len(block.content)
                padded = np.frombuffer(block.content + bytes(PADDING), np.uint8)
                places = proven_places(padded, size, [Indexed(0, size, chunk.index)])
                if places is None:
                    self._fault(block.offset, "the message indexes behind a chunk are wrong")
                elif any(channel not in self._topics for channel in places):
                    places = None
            if places is None:
                places = self._walk(block)
            for channel, one in places.items():
                found.setdefault(channel, []).append(one.moved(base))
            base += len(block.content)
        return {channel: joined(parts) for channel, parts in found.items()}

    def _walk(self, block: MessageBlock) -> dict[int, Places]:
        """Where the messages of each channel are, record by record; declares the channels between them."""
        found, others = walked_places(block)
        for one in others:
            self._take(one)
        for channel, places in found.items():
            if channel not in self._topics:
                what = f"{len(places.offsets)} messages of channel {channel}, which the file does not hold"
                self._faults.add(f"{self._name}: {what}")
        return found

    def _take(self, piece: records.Schema | records.Channel | Fault) -> None:
        if isinstance(piece, Fault):
            self._fault(piece.offset, piece.detail)
        else:
            self._want(self._declared.take(piece))

    def _want(self, found: list[tuple[int, Topic]]) -> None:
        for channel_id, topic in found:
            if self._selection.wants(topic):
                self._decoders[channel_id] = Decoder(columns_of(topic), self._wanted_columns)

    def _fault(self, offset: int, detail: str) -> None:
        self._faults.add(f"{self._name}: byte {offset}: {detail}")


def _heads(content: Bytes, places: Places) -> Heads:
    return Heads(places.log_ns(content), places.publish_ns(content), places.sequences(content))
