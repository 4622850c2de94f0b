"""The summary at the end of an MCAP file, read without the mcap package's object for each chunk.

Most of it is the index of chunks: about 300 bytes a chunk, 200 MB for a log of 10 GB. It is read in blocks, on
demand.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from io import SEEK_END
from typing import BinaryIO, Final

import msgspec
from mcap import records
from mcap.opcode import Opcode

from recorder.mcap.framing import BROKEN, FOOTER, MAGIC, RECORD_HEADER, RecordFile, parse, parsing

_CHUNK_PLACE: Final = struct.Struct("<QQQQI")
_CHUNK_REST: Final = struct.Struct("<QI")
_CHUNK_SIZES: Final = struct.Struct("<QQ")
_MAP_ENTRY: Final = struct.Struct("<HQ")
_BLOCK_BYTES: Final = 1 << 20

_REPEATED: Final = frozenset(
    {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX}
)


class IndexedChunk(msgspec.Struct, frozen=True, gc=False):
    """The entry of a chunk in the index.

    Attributes:
        start_ns, end_ns: log times of its first and last message.
        places: offsets of each channel's message index, as MCAP's map: ``place_map`` reads it.
        indexes_length: bytes of the message indexes.
        packed, unpacked: bytes of its records.
    """

    start_ns: int
    end_ns: int
    offset: int
    length: int
    places: bytes
    indexes_length: int
    compression: bytes
    packed: int
    unpacked: int

    def place_map(self) -> dict[int, int]:
        """Return the file offset of each channel's message index, by channel."""
        return dict(_MAP_ENTRY.iter_unpack(self.places))

    def digest(self) -> int:
        """A hash of the whole description."""
        facts = (self.start_ns, self.end_ns, self.offset, self.length, self.indexes_length)
        sizes = (self.compression, self.packed, self.unpacked)
        return hash((facts, sizes, frozenset(self.place_map().items())))


def place_entries(places: Mapping[int, int]) -> bytes:
    """Encode the file offset of each channel's message index as MCAP's map."""
    return b"".join(_MAP_ENTRY.pack(*entry) for entry in places.items())


class LogSummary(msgspec.Struct):
    """The summary section.

    Attributes:
        start, end: its place in the file; the footer begins at its end.
        offset_start: the beginning of its summary offsets; 0 if it has none.
        crc: its checksum in the footer; 0 if it has none.
        groups: its summary offsets: the stated place of each kind of record.
        chunks_at: start and end of each part of the index of chunks.
    """

    start: int
    end: int
    offset_start: int
    crc: int
    schemas: dict[int, records.Schema] = msgspec.field(default_factory=dict)
    channels: dict[int, records.Channel] = msgspec.field(default_factory=dict)
    statistics: records.Statistics | None = None
    attachments: list[records.AttachmentIndex] = msgspec.field(default_factory=list)
    metadata: list[records.MetadataIndex] = msgspec.field(default_factory=list)
    groups: list[records.SummaryOffset] = msgspec.field(default_factory=list)
    chunks_at: list[tuple[int, int]] = msgspec.field(default_factory=list)

    def chunks(self, stream: BinaryIO) -> Iterator[IndexedChunk]:
        """Return the index entry of each chunk, in the order of the index."""
        with parsing():
            for start, end in self.chunks_at:
                for opcode, _, body in _read_records(stream, start, end):
                    if opcode == Opcode.CHUNK_INDEX:
                        yield _indexed_chunk(body)

    def wrong_groups(self, stream: BinaryIO) -> Iterator[records.SummaryOffset]:
        """The groups that are not at their stated place, or contain other records."""
        with parsing():
            for group in self.groups:
                end = group.group_start + group.group_length
                is_inside = self.start <= group.group_start <= end <= (self.offset_start or self.end)
                found = _read_records(stream, group.group_start, end) if is_inside else iter([(0, 0, b"")])
                # Some writers list empty groups.
                if {opcode for opcode, _, _ in found} != ({group.group_opcode} if group.group_length else set()):
                    yield group


def read_summary(stream: BinaryIO) -> LogSummary | None:
    """Return the summary of a file; None if there is none, it cannot be read, or its checksum is wrong."""
    try:
        summary = _find(stream)
        if summary is None or not _is_intact(stream, summary):
            return None
        _read_groups(stream, summary)
    except BROKEN:
        return None
    return summary


def _find(stream: BinaryIO) -> LogSummary | None:
    size = stream.seek(0, SEEK_END)
    end = size - FOOTER.size - len(MAGIC)
    if end < len(MAGIC):
        return None
    stream.seek(end)
    tail = stream.read()
    opcode, length, start, offset_start, crc = FOOTER.unpack_from(tail)
    if tail[FOOTER.size :] != MAGIC or (opcode, length) != (Opcode.FOOTER, FOOTER.size - RECORD_HEADER.size):
        return None
    if not len(MAGIC) <= start <= end or (offset_start and not start <= offset_start <= end):
        return None
    return LogSummary(start, end, offset_start, crc)


def _is_intact(stream: BinaryIO, summary: LogSummary) -> bool:
    if not summary.crc:
        return True
    crc, end = 0, summary.end + FOOTER.size - 4
    stream.seek(summary.start)
    for at in range(summary.start, end, _BLOCK_BYTES):
        crc = zlib.crc32(stream.read(min(_BLOCK_BYTES, end - at)), crc)
    return crc == summary.crc


def _read_groups(stream: BinaryIO, summary: LogSummary) -> None:
    """Read all but the index of chunks, which is skipped where its length is stated."""
    if summary.offset_start:
        for opcode, _, body in _read_records(stream, summary.offset_start, summary.end):
            if opcode == Opcode.SUMMARY_OFFSET:
                summary.groups.append(parse(opcode, body))
    chunks = {
        one.group_start: one.group_length for one in summary.groups if one.group_opcode == Opcode.CHUNK_INDEX
    }
    at, end = summary.start, summary.offset_start or summary.end
    while at < end:
        if 0 < chunks.get(at, 0) <= end - at:
            summary.chunks_at.append((at, at + chunks[at]))
            at += chunks[at]
            continue
        next_at = min((start for start in chunks if start > at), default=end)
        _take_records(stream, summary, at, min(next_at, end))
        at = min(next_at, end)


def _take_records(stream: BinaryIO, summary: LogSummary, start: int, end: int) -> None:
    for opcode, at, body in _read_records(stream, start, end):
        if opcode == Opcode.CHUNK_INDEX:
            stretch = at, at + RECORD_HEADER.size + len(body)
            if summary.chunks_at and summary.chunks_at[-1][1] == stretch[0]:
                stretch = summary.chunks_at.pop()[0], stretch[1]
            summary.chunks_at.append(stretch)
        if opcode not in _REPEATED:
            continue
        record = parse(opcode, body)
        match record:
            case records.Schema():
                summary.schemas.setdefault(record.id, record)
            case records.Channel():
                summary.channels.setdefault(record.id, record)
            case records.Statistics():
                summary.statistics = record
            case records.AttachmentIndex():
                summary.attachments.append(record)
            case records.MetadataIndex():
                summary.metadata.append(record)
            case _:
                pass


def _read_records(stream: BinaryIO, start: int, end: int) -> Iterator[tuple[int, int, bytes]]:
    return RecordFile(stream, end, _BLOCK_BYTES).records(start, end)


def _indexed_chunk(body: bytes) -> IndexedChunk:
    start_ns, end_ns, offset, length, places_length = _CHUNK_PLACE.unpack_from(body)
    at = _CHUNK_PLACE.size + places_length
    indexes_length, name_length = _CHUNK_REST.unpack_from(body, at)
    name_at = at + _CHUNK_REST.size
    packed, unpacked = _CHUNK_SIZES.unpack_from(body, name_at + name_length)
    if places_length % _MAP_ENTRY.size:
        raise ValueError("an index of chunks cannot be read")
    return IndexedChunk(
        start_ns=start_ns,
        end_ns=end_ns,
        offset=offset,
        length=length,
        places=body[_CHUNK_PLACE.size : at],
        indexes_length=indexes_length,
        compression=body[name_at : name_at + name_length],
        packed=packed,
        unpacked=unpacked,
    )
