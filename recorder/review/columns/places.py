"""Where the messages of chunks are, by the message indexes behind them, which are proven first.

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

from recorder.mcap.chunk import HEADER_IN_LENGTH, MESSAGE_HEADER, MESSAGE_OPCODE
from recorder.mcap.summary import RECORD_HEADER

Numbers = NDArray[np.int64]
Bytes = NDArray[np.uint8]

_LENGTH_AT, _CHANNEL_AT = 1, 9
SEQUENCE_AT, LOG_AT, PUBLISH_AT = 11, 15, 23
"""Where in a message's record its numbers stand."""

PADDING: Final = 8
"""Bytes behind the records, so that whole words can be read of the last one."""

_OFFSET_MAX: Final = np.uint64(1 << 40)

_GAPS_MAX: Final = 10_000


class Indexed(msgspec.Struct, frozen=True):
    """What the message indexes behind a chunk say.

    Attributes:
        base: where the chunk's records begin in a row of chunks...
        end: ...and where they end.
        index: as ``pieces.PackedChunk.index``.
    """

    base: int
    end: int
    index: Mapping[int, array[int]]


class Places(msgspec.Struct, frozen=True):
    """The messages of one channel in a row of chunks.

    Attributes:
        offsets: of each record.
        lengths: of each record, opcode and length included.
    """

    offsets: Numbers
    lengths: Numbers

    def only(self, which: NDArray[Any]) -> Places:
        """Some of them."""
        return Places(self.offsets[which], self.lengths[which])


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
    if (places + MESSAGE_HEADER.size > ends).any():
        return None
    raw_lengths = words(content, "<u8", _LENGTH_AT)[places]
    if raw_lengths.max() > np.uint64(size) or raw_lengths.min() < np.uint64(HEADER_IN_LENGTH):
        return None
    lengths = raw_lengths.astype(np.int64) + RECORD_HEADER.size
    channels = np.array([channel for channel, _, _ in parts])
    if (
        (content[places] != MESSAGE_OPCODE).any()
        or (words(content, "<u2", _CHANNEL_AT)[places] != np.repeat(channels, counts)).any()
        or (words(content, "<u8", LOG_AT)[places] != times).any()
        or (places + lengths > ends).any()
        or not _fills(content, size, places, lengths)
    ):
        return None
    return _by_channel(channels, counts, places, lengths)


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
        found[int(channel)] = in_order(Places(offsets[start:end], lengths[start:end]))
    return found


def in_order(places: Places) -> Places:
    """The same in the order of the file; others sort their indexes by time."""
    if (np.diff(places.offsets) > 0).all():
        return places
    return places.only(np.argsort(places.offsets, kind="stable"))


def words(content: Bytes, kind: str, shift: int) -> NDArray[np.unsignedinteger]:
    """What stands so far behind each byte, as a number."""
    words: NDArray[np.unsignedinteger] = np.ndarray(
        (len(content) - MESSAGE_HEADER.size + 1,), kind, content, shift, (1,)
    )
    return words


def _fills(content: Bytes, size: int, offsets: Numbers, lengths: Numbers) -> bool:
    """Whether the records, and schemas and channels between them, fill the content without a gap or an overlap."""
    order = np.argsort(offsets, kind="stable")
    starts = np.append(offsets[order], size)
    ends = np.concatenate([[0], offsets[order] + lengths[order]])
    if (ends > starts).any():
        return False
    gaps = np.flatnonzero(ends != starts)
    if len(gaps) > _GAPS_MAX:
        return False
    return all(_holds_no_message(content, int(ends[gap]), int(starts[gap])) for gap in gaps)


def _holds_no_message(content: Bytes, at: int, end: int) -> bool:
    while at < end:
        if end - at < RECORD_HEADER.size:
            return False
        opcode, length = RECORD_HEADER.unpack(content[at : at + RECORD_HEADER.size].tobytes())
        if opcode in {MESSAGE_OPCODE, Opcode.CHUNK, 0}:
            return False
        at += RECORD_HEADER.size + length
    return at == end
