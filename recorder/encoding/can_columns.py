"""Batches of raw frames into a chunk, by columns: the common batch, of classic data frames alike in form. Pure.

The records of such frames differ in a few bytes only: times, identifier and data. One record is repeated for all
frames of the batch, and each column of bytes written over it at once, which costs a tenth of one packing a frame.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import msgspec

from recorder.encoding.fast_path import Adder
from recorder.encoding.key_counters import SEQUENCE_SPAN, KeyCounters
from recorder.encoding.transcode import compile_row_encoder
from recorder.mcap.chunk import ChunkBuilder, message_record
from schemas.can_word import ERROR, EXTENDED, IDENTIFIER_MASK, REMOTE
from schemas.messages import CanFrame, CanFrames

DATA_BYTES: Final = 8
"""Length of the frames that go this way."""

FRAMES_MAX: Final = 10_000
"""Frames of a batch: what a saturated bus carries in a second, and a gateway sends each 50 ms."""

TEMPLATES_MAX: Final = 4096
"""Two for each name of a bus; anybody may make up names."""

# Marks that no record holds by chance, to find the places of the columns.
_TIME_MARK: Final = 0x1122334455667788
_IDENTIFIER_MARK: Final = 0x0ABBCCDD
_DATA_MARK: Final = b"\xa1\xa2\xa3\xa4\xa5\xa6\xa7\xa8"

_ENCODE_ROW: Final[Callable[..., bytes]] = compile_row_encoder(CanFrame)
_DECODE: Final = msgspec.msgpack.Decoder(CanFrames).decode


class _Template(msgspec.Struct, frozen=True):
    """The data of a message with marks, and where in its record they stand, and the publish time."""

    data: bytes
    size: int
    publish_at: int
    time_at: int
    identifier_at: int
    data_at: int


@lru_cache(TEMPLATES_MAX)
def _template(bus: str, *, is_extended: bool) -> _Template:
    flags = (is_extended, False, False, False, False, False)
    body = _ENCODE_ROW(_TIME_MARK, bus, _IDENTIFIER_MARK, *flags, DATA_BYTES, _DATA_MARK)
    time_mark = struct.pack("<Q", _TIME_MARK)
    record = message_record(0, 0, 0, _TIME_MARK, body)
    start = len(record) - len(body)
    return _Template(
        data=body,
        size=len(record),
        publish_at=record.index(time_mark),
        time_at=record.index(time_mark, start),
        identifier_at=record.index(struct.pack("<I", _IDENTIFIER_MARK), start),
        # The bus's name, which may be anything, stands before it.
        data_at=record.rindex(_DATA_MARK),
    )


def can_adder(counters: KeyCounters, chunk: ChunkBuilder, channel_id: int) -> Adder:
    """The function of one key of raw frames; see ``fast_path``."""
    limit_bytes = chunk.limit_bytes

    def add(payload: bytes, log_ns: int) -> bool:
        batch = _DECODE(payload)
        if batch.sequence != counters.next or chunk.is_full or not is_common(batch):
            return False
        count = len(batch.can_id)
        if count:
            template = _template(batch.bus, is_extended=batch.can_id[0] & EXTENDED != 0)
            # Of a batch that is a chunk by itself the slow path makes several.
            if count > FRAMES_MAX or count * template.size > limit_bytes:
                return False
            _write(batch, template, log_ns, chunk, channel_id)
        counters.next = (batch.sequence + 1) % SEQUENCE_SPAN
        counters.dropped = max(counters.dropped, batch.dropped)
        counters.samples += 1
        counters.messages += count
        return True

    return add


def is_common(batch: CanFrames) -> bool:
    """True if all frames are classic data frames of eight bytes, with identifiers of one length."""
    words = batch.can_id
    count = len(words)
    if not (
        count
        == len(batch.frame_time_ns)
        == len(batch.data)
        == batch.fd_flags.count(0)
        == len(batch.fd_flags)
        == batch.length.count(DATA_BYTES)
        == len(batch.length)
    ):
        return False
    if not count:
        return True
    # The highest bits are the flags: where the lowest and the highest word have the same, all have.
    flags = min(words) & ~IDENTIFIER_MASK
    return (
        flags == max(words) & ~IDENTIFIER_MASK
        and not flags & (REMOTE | ERROR)
        and set(map(len, batch.data)) == {DATA_BYTES}
    )


def _write(batch: CanFrames, template: _Template, log_ns: int, chunk: ChunkBuilder, channel_id: int) -> None:
    count, size = len(batch.can_id), template.size
    one = message_record(channel_id, batch.sequence, log_ns, 0, template.data)
    records: Any = bytearray(one) * count
    times = struct.pack(f"<{count}Q", *batch.frame_time_ns)
    for byte in range(8):
        column = times[byte::8]
        records[template.publish_at + byte :: size] = column
        records[template.time_at + byte :: size] = column
    words = struct.pack(f"<{count}I", *[word & IDENTIFIER_MASK for word in batch.can_id])
    for byte in range(4):
        records[template.identifier_at + byte :: size] = words[byte::4]
    data = b"".join(batch.data)
    for byte in range(DATA_BYTES):
        records[template.data_at + byte :: size] = data[byte::DATA_BYTES]
    start = len(chunk.records)
    chunk.records += records
    places = array("Q", [log_ns]) * (2 * count)
    places[1::2] = array("Q", range(start, start + count * size, size))
    chunk.index[channel_id].extend(places)
