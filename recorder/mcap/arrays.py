"""The places of the messages of many chunks at once, as numpy arrays, by the message indexes behind the chunks.

An index is accepted if its messages, with schemas and channels between them, fill the chunk from its first byte to
its last: then none is missing, duplicated, or anything but a message. Else the chunk is walked record by record.
"""

from __future__ import annotations

from array import array
from collections.abc import Container, Iterator, Mapping, Sequence
from itertools import pairwise
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
from recorder.mcap.pieces import Declared, Fault, Index, MessageBlock, has_too_many, split

Numbers = NDArray[np.int64]
Bytes = NDArray[np.uint8]

PADDING: Final = 8  # bytes behind the records, so that whole words can be read at the end

_OFFSET_MAX: Final = np.uint64(1 << 40)

_GAPS_MAX: Final = 10_000


class Indexed(msgspec.Struct, frozen=True):
    """The index of a chunk whose records are the bytes from ``base`` to ``end`` of a row of chunks."""

    base: int
    end: int
    index: Mapping[int, array[int]]


class Places(msgspec.Struct, frozen=True):
    """The messages of one channel in a row of chunks."""

    offsets: Numbers
    lengths: Numbers

    def only(self, which: NDArray[Any]) -> Places:
        return Places(self.offsets[which], self.lengths[which])

    @property
    def starts(self) -> Numbers:
        return self.offsets - DATA_AT

    @property
    def size(self) -> int:
        return len(self.offsets) * DATA_AT + int(self.lengths.sum())

    def moved(self, base: int) -> Places:
        """The places in a row with ``base`` more bytes before them."""
        return Places(self.offsets + base, self.lengths)

    def log_ns(self, content: Bytes) -> NDArray[np.uint64]:
        return _words(content, "<u8", LOG_AT)[self.starts]

    def publish_ns(self, content: Bytes) -> NDArray[np.uint64]:
        return _words(content, "<u8", PUBLISH_AT)[self.starts]

    def sequences(self, content: Bytes) -> NDArray[np.uint32]:
        return _words(content, "<u4", SEQUENCE_AT)[self.starts]


def proven_places(content: Bytes, size: int, chunks: Sequence[Indexed]) -> dict[int, Places] | None:
    """The places by channel, from the chunks' indexes; None if anything is wrong.

    Args:
        content: the records of all chunks, and PADDING bytes.
    """
    parts = [
        (channel, entries, chunk) for chunk in chunks for channel, entries in chunk.index.items() if len(entries)
    ]
    parts.sort(key=lambda part: part[0])
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


class Read(msgspec.Struct, frozen=True):
    """The messages of many blocks.

    Attributes:
        content: the records of all blocks, and PADDING bytes.
        places: of the messages in ``content``, by channel.
        others: other records of walked blocks, with the block's number.
        wrong: numbers of the blocks whose index is wrong.
    """

    content: Bytes
    places: dict[int, Places]
    others: list[tuple[int, Declared | Fault]]
    wrong: list[int]


class Blocks:
    """Blocks to read together; ``bases`` are their offsets in the whole, then its size."""

    def __init__(self) -> None:
        self.blocks: list[MessageBlock] = []
        self.bases = [0]
        self._indexes: list[Index | None] = []

    @property
    def size(self) -> int:
        return self.bases[-1]

    def add(self, block: MessageBlock, index: Index | None = None) -> None:
        """Add a chunk's records with its index, or a message outside of chunks."""
        self.blocks.append(block)
        self.bases.append(self.size + len(block.content))
        self._indexes.append(index)

    def read(self, known: Container[int] | None = None) -> Read:
        """Find all messages.

        Args:
            known: channels that need not be searched for in chunks with an index. None: return all schemas and
                channels, and no message of a faulty block.
        """
        content = np.frombuffer(b"".join([*(one.content for one in self.blocks), bytes(PADDING)]), np.uint8)
        read = Read(content, {}, [], [])
        found = self._proven(content, 0, len(self.blocks), known)
        if found is not None:
            read.places.update(found)
            return read
        parts: dict[int, list[Places]] = {}
        for first, behind in self._runs():
            found = self._proven(content, first, behind, known)
            if found is None:
                found = self._walked(first, read, is_strict=known is None)
            for channel, places in found.items():
                parts.setdefault(channel, []).append(places.moved(self.bases[first]))
        read.places.update((channel, _joined(of_channel)) for channel, of_channel in parts.items())
        return read

    def _runs(self) -> Iterator[tuple[int, int]]:
        """Ranges of blocks: each chunk alone, and successive messages outside of chunks together."""
        single = [
            index is None and block.is_single for block, index in zip(self.blocks, self._indexes, strict=True)
        ]
        first = 0
        for place, is_single in enumerate(single, start=1):
            if not (is_single and place < len(single) and single[place]):
                yield first, place
                first = place

    def _proven(
        self, content: Bytes, first: int, behind: int, known: Container[int] | None
    ) -> dict[int, Places] | None:
        """The places in these blocks; None if they have to be walked."""
        base, size = self.bases[first], self.bases[behind] - self.bases[first]
        within = content[base : base + size + PADDING]
        indexed = [
            Indexed(start - base, end - base, index)
            for index, (start, end) in zip(
                self._indexes[first:behind], pairwise(self.bases[first : behind + 1]), strict=True
            )
            if index is not None and not has_too_many(index)
        ]
        if len(indexed) == behind - first:
            found = proven_places(within, size, indexed)
        elif not indexed and all(block.is_single for block in self.blocks[first:behind]):
            found = _singles(within, np.array(self.bases[first : behind + 1]) - base)
        else:
            return None
        if found is None or (known is None and sum(one.size for one in found.values()) != size):
            return None
        return found if known is None or all(channel in known for channel in found) else None

    def _walked(self, place: int, read: Read, *, is_strict: bool) -> dict[int, Places]:
        """The places in a block, record by record; other records go to ``read``."""
        said = self._indexes[place]
        index, others = self.blocks[place].read_index()
        read.others.extend((place, one) for one in others)
        if said is not None and not _is_same(index, said):
            read.wrong.append(place)
        if is_strict and any(isinstance(one, Fault) for one in others):
            return {}
        content = read.content[self.bases[place] :]
        found = {}
        for channel, entries in index.items():
            starts = np.frombuffer(entries, "<u8")[1::2].astype(np.int64)
            lengths = _words(content, "<u8", LENGTH_AT)[starts].astype(np.int64) - HEADER_IN_LENGTH
            found[channel] = Places(starts + DATA_AT, lengths)
        return found


def _is_same(index: Index, other: Index) -> bool:
    """Report whether two indexes have the same entries, in any order."""
    return index.keys() == {channel for channel, entries in other.items() if entries} and all(
        np.array_equal(_in_place_order(entries), _in_place_order(other[channel]))
        for channel, entries in index.items()
    )


def _in_place_order(entries: array[int]) -> NDArray[np.uint64]:
    pairs = np.frombuffer(entries, np.uint64).reshape(-1, 2)
    return pairs[np.lexsort((pairs[:, 0], pairs[:, 1]))]


def _singles(content: Bytes, bounds: Numbers) -> dict[int, Places]:
    """The places of adjacent messages."""
    channels = _words(content, "<u2", CHANNEL_AT)[bounds[:-1]].astype(np.int64)
    order = np.argsort(channels, kind="stable")
    offsets, lengths = bounds[:-1] + DATA_AT, np.diff(bounds) - DATA_AT
    return _by_channel(channels[order], [1] * len(order), offsets[order], lengths[order])


def _joined(parts: Sequence[Places]) -> Places:
    """The messages of all parts, in the order of the file."""
    offsets = np.concatenate([one.offsets for one in parts])
    lengths = np.concatenate([one.lengths for one in parts])
    return _in_order(Places(offsets, lengths))


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
    """The places in the order of the file; other applications sort their indexes by time."""
    if (np.diff(places.offsets) > 0).all():
        return places
    return places.only(np.argsort(places.offsets, kind="stable"))


def _words(content: Bytes, kind: str, shift: int) -> NDArray[Any]:
    """Return the number of this kind at a fixed distance behind each byte."""
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
