"""The record batches of a log: topic by topic, some megabytes of it at once."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import groupby
from typing import BinaryIO, Final

import msgspec
import numpy as np
import pyarrow as pa

from recorder.mcap.arrays import PADDING, Bytes, Indexed, Places, joined, proven_places, walked_places
from recorder.mcap.reader import Index, MessageBlock
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import END_OF_TIME_NS, BlockReader, Progress, Selection
from recorder.review.columns.decoder import Decoder
from recorder.review.columns.tables import Columns, columns_of

BATCH_BYTES: Final = 4_000_000
"""So much is unpacked at once: enough that the work on a batch is more than that around it."""


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
    wanted: Collection[str] | None = None,
) -> Iterator[Batch]:
    """The batches of a log, each of one topic in the order of the file.

    Args:
        log: the file.
        selection: topics and time.
        faults: takes what cannot be read; the rest is read all the same.
        progress: receives the number of bytes that were read or passed over.
        wanted: names of the columns that are wanted; None is all.
    """
    try:
        with log.path.open("rb") as stream:
            yield from ColumnReader(stream, log, selection, faults, wanted).batches(progress)
    except OSError as error:
        faults.add(f"{log.path}: {error.strerror or error}")


class _Pending:
    """Chunks that are unpacked, and wait to be read together."""

    def __init__(self) -> None:
        self.blocks: list[MessageBlock] = []
        self.chunks: list[Indexed | None] = []
        self.size = 0

    def add(self, block: MessageBlock, index: Index | None = None) -> None:
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
                yield MessageBlock(run[0].offset, b"".join([block.content for block in run]), run[0].room), None


class ColumnReader(BlockReader):
    """Reads the batches of one log.

    Args:
        stream: the file.
        log: the log to read.
        selection: the wanted messages.
        faults: takes what cannot be read.
        columns: names of the columns that are wanted; None is all.
    """

    def __init__(
        self,
        stream: BinaryIO,
        log: LogFile,
        selection: Selection,
        faults: Faults,
        columns: Collection[str] | None = None,
    ) -> None:
        super().__init__(stream, log, selection, faults)
        self._columns = columns
        self._decoders: dict[int, Decoder] = {}

    def batches(self, progress: Progress) -> Iterator[Batch]:
        """The wanted batches."""
        pending = _Pending()
        for block, index in self.blocks(progress):
            pending.add(block, index)
            if pending.size >= BATCH_BYTES:
                yield from self._read(pending)
                pending = _Pending()
        yield from self._read(pending)
        for channel_id, decoder in self._decoders.items():
            if decoder.broken:
                self.fault(f"{decoder.broken} messages of {self.topics[channel_id].name} cannot be read")

    def _read(self, pending: _Pending) -> Iterator[Batch]:
        if not pending.size:
            return
        content = np.frombuffer(pending.content, np.uint8)
        indexed = [chunk for chunk in pending.chunks if chunk is not None]
        places = None
        if len(indexed) == len(pending.chunks):
            places = proven_places(content, pending.size, indexed)
            if places is not None and not places.keys() <= self.topics.keys():
                places = None  # Perhaps the channels are within the chunks.
        if places is None:
            places = self._places_one_by_one(pending)
        for channel, found in places.items():
            if channel in self.wanted:
                yield from self._batch(self._decoder(channel), content, found)

    def _decoder(self, channel: int) -> Decoder:
        if channel not in self._decoders:
            self._decoders[channel] = Decoder(columns_of(self.wanted[channel]), self._columns)
        return self._decoders[channel]

    def _batch(self, decoder: Decoder, content: Bytes, places: Places) -> Iterator[Batch]:
        from_ns, to_ns = self.selection.from_ns, self.selection.to_ns
        if from_ns > 0 or to_ns < END_OF_TIME_NS:
            log_ns = places.log_ns(content)
            first, last = max(from_ns, 0), min(max(to_ns, 0), END_OF_TIME_NS) - 1
            is_within = (log_ns >= np.uint64(min(first, END_OF_TIME_NS - 1))) & (log_ns <= np.uint64(max(last, 0)))
            places = places.only(is_within & (last >= first))
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
                    self.wrong_index(block)
            if places is None or not places.keys() <= self.topics.keys():
                places = self._walk(block)
            for channel, one in places.items():
                found.setdefault(channel, []).append(one.moved(base))
            base += len(block.content)
        return {channel: joined(parts) for channel, parts in found.items()}

    def _walk(self, block: MessageBlock) -> dict[int, Places]:
        """Return the places of each channel's messages, record by record; declares the channels between them."""
        found, others = walked_places(block)
        for one in others:
            self.take(one)
        for channel, places in found.items():
            if channel not in self.topics:
                self.fault(f"{len(places.offsets)} messages of channel {channel}, which the file does not hold")
        return found
