"""The record batches of a log: topic by topic, some megabytes of it at once."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import BinaryIO, Final

import msgspec
import numpy as np
import pyarrow as pa

from recorder.mcap.arrays import Blocks, Bytes, Places
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
        pending = Blocks()
        for block, index in self.blocks(progress):
            pending.add(block, index)
            if pending.size >= BATCH_BYTES:
                yield from self._read(pending)
                pending = Blocks()
        yield from self._read(pending)
        for channel_id, decoder in self._decoders.items():
            if decoder.broken:
                self.fault(f"{decoder.broken} messages of {self.topics[channel_id].name} cannot be read")

    def _read(self, pending: Blocks) -> Iterator[Batch]:
        if not pending.size:
            return
        read = pending.read(known=self.topics)
        for place in read.wrong:
            self.wrong_index(pending.blocks[place])
        for _, one in read.others:
            self.take(one)
        for channel, found in read.places.items():
            if channel in self.wanted:
                yield from self._batch(self._decoder(channel), read.content, found)
            elif channel not in self.topics:
                self.fault(f"{len(found.offsets)} messages of channel {channel}, which the file does not hold")

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
