"""The places of the messages of many chunks at once, as numpy's arrays, by the message indexes behind the chunks.

An index is believed if its messages, with the schemas and channels that others put between them, fill the chunk
from its first byte to its last: then none is missing, none is there twice, and none is anything but a message.
Else the chunk is walked, record by record.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from recorder.mcap.framing import (
    BROKEN,
    CHANNEL_AT,
    DATA_AT,
    HEADER_IN_LENGTH,
    LENGTH_AT,
    LOG_AT,
    MESSAGE_OPCODE,
    PUBLISH_AT,
    RECORD_HEADER,
    SEQUENCE_AT,
)
from recorder.mcap.pieces import Declared, Fault, MessageBlock, split

Numbers = NDArray[np.int64]
Bytes = NDArray[np.uint8]

PADDING: Final = 8
"""Bytes behind the records, so that whole words can be read of the last one."""

_OFFSET_MAX: Final = np.uint64(1 << 40)

_GAPS_MAX: Final = 10_000


class Indexed(msgspec.Struct, frozen=True):
    """The content of the message indexes behind a chunk.

    Attributes:
        base: the start of the chunk's records in a row of chunks...
        end: ...and where they end.
        index: as ``PackedChunk.index``.
    """

    base: int
    end: int
    index: Mapping[int, array[int]]


class Places(msgspec.Struct, frozen=True):
    """The messages of one channel in a row of chunks.

    Attributes:
        offsets: of the data of each.
        lengths: of the data of each.
    """

    offsets: Numbers
    lengths: Numbers

    def only(self, which: NDArray[Any]) -> Places:
        """Some of them."""
        return Places(self.offsets[which], self.lengths[which])

    def moved(self, base: int) -> Places:
        """The same in a row in which so many bytes stand before."""
        return Places(self.offsets + base, self.lengths)

    def log_ns(self, content: Bytes) -> NDArray[np.uint64]:
        """Log times, in nanoseconds since 1970."""
        return _words(content, "<u8", LOG_AT)[self.offsets - DATA_AT]

    def publish_ns(self, content: Bytes) -> NDArray[np.uint64]:
        """Publish times, in nanoseconds since 1970."""
        return _words(content, "<u8", PUBLISH_AT)[self.offsets - DATA_AT]

    def sequences(self, content: Bytes) -> NDArray[np.uint32]:
        """Sequence numbers."""
        return _words(content, "<u4", SEQUENCE_AT)[self.offsets - DATA_AT]


def proven_places(content: Bytes, size: int, chunks: Sequence[Indexed]) -> dict[int, Places] | None:
    """The places that the indexes of chunks say, by channel; None if anything is wrong.

    Args:
        content: the records of the chunks, one chunk after the other, and PADDING bytes.
        size: without the padding.
        chunks: of each its index, in turns log time and offset.
    """
    parts = [
        (channel, entries, chunk) for chunk in chunks for channel, entries in chunk.index.items() if len(entries)
    ]
    parts.sort(key=_channel_of)
    if not parts:
        return {} if not size else None
    counts = [len(entries) // 2 for _, entries, _ in parts]
    entries = np.frombuffer(b"".join([entries for _, entries, _ in parts]), "<u8")
    times, offsets = entries[0::2], entries[1::2]
    if offsets.max() > _OFFSET_MAX:
        return None
    bases, ends = (np.repeat(np.array(bound), counts) for bound in _bounds(parts))
    places = offsets.astype(np.int64) + bases
    if (places + DATA_AT > ends).any():
        return None
    raw_lengths = _words(content, "<u8", LENGTH_AT)[places]
    if raw_lengths.max() > np.uint64(size) or raw_lengths.min() < np.uint64(HEADER_IN_LENGTH):
        return None
    lengths = raw_lengths.astype(np.int64) + RECORD_HEADER.size
    channels = np.array([channel for channel, _, _ in parts])
    if (
        (content[places] != MESSAGE_OPCODE).any()
        or (_words(content, "<u2", CHANNEL_AT)[places] != np.repeat(channels, counts)).any()
        or (_words(content, "<u8", LOG_AT)[places] != times).any()
        or (places + lengths > ends).any()
        or not _fills(content, size, places, lengths)
    ):
        return None
    return _by_channel(channels, counts, places + DATA_AT, lengths - DATA_AT)


def walked_places(block: MessageBlock) -> tuple[dict[int, Places], list[Declared | Fault]]:
    """The places of the messages of each channel, record by record; and all else that is there."""
    index, others = block.read_index()
    content = np.frombuffer(block.content + bytes(PADDING), np.uint8)
    found = {}
    for channel, entries in index.items():
        starts = np.frombuffer(entries[1::2], np.uint64).astype(np.int64)
        lengths = _words(content, "<u8", LENGTH_AT)[starts].astype(np.int64) - HEADER_IN_LENGTH
        found[channel] = Places(starts + DATA_AT, lengths)
    return found, others


def joined(parts: Sequence[Places]) -> Places:
    """The messages of all parts, in the order of the file."""
    offsets = np.concatenate([one.offsets for one in parts])
    lengths = np.concatenate([one.lengths for one in parts])
    return _in_order(Places(offsets, lengths))


def _channel_of(part: tuple[int, array[int], Indexed]) -> int:
    return part[0]


def _bounds(parts: Sequence[tuple[int, array[int], Indexed]]) -> tuple[list[int], list[int]]:
    return [chunk.base for _, _, chunk in parts], [chunk.end for _, _, chunk in parts]


def _by_channel(channels: Numbers, counts: list[int], offsets: Numbers, lengths: Numbers) -> dict[int, Places]:
    found = {}
    sums = np.cumsum(counts)
    unique, first = np.unique(channels, return_index=True)
    starts = [int(sums[place - 1]) if place else 0 for place in first] + [len(offsets)]
    for channel, start, end in zip(unique, starts[:-1], starts[1:], strict=True):
        found[int(channel)] = _in_order(Places(offsets[start:end], lengths[start:end]))
    return found


def _in_order(places: Places) -> Places:
    """The same in the order of the file; others sort their indexes by time."""
    if (np.diff(places.offsets) > 0).all():
        return places
    return places.only(np.argsort(places.offsets, kind="stable"))


def _words(content: Bytes, kind: str, shift: int) -> NDArray[Any]:
    """Return the word at a fixed distance behind each byte, as an array of numbers of this kind."""
    words: NDArray[Any] = np.ndarray((len(content) - DATA_AT + 1,), kind, content, shift, (1,))
    return words


def _fills(content: Bytes, size: int, offsets: Numbers, lengths: Numbers) -> bool:
    """Return True if messages, schemas and channels fill the content without a gap or an overlap."""
    order = np.argsort(offsets, kind="stable")
    starts = np.append(offsets[order], size)
    ends = np.concatenate([[0], offsets[order] + lengths[order]])
    if (ends > starts).any():
        return False
    gaps = np.flatnonzero(ends != starts)
    if len(gaps) > _GAPS_MAX:
        return False
    return not any(_holds_message(content[ends[gap] : starts[gap]].tobytes()) for gap in gaps)


def _holds_message(gap: bytes) -> bool:
    try:
        return any(opcode in {MESSAGE_OPCODE, Opcode.CHUNK} for opcode, _, _ in split(gap))
    except BROKEN:
        return True
