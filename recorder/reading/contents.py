"""Channels, counts, times, metadata and attachments of a file, without its messages.

Either from the summary at its end, with a look at the first and the last message index of each channel; or, where
that does not tell all, record by record, with a look into those chunks alone that have no message indexes.
"""

from __future__ import annotations

from collections import Counter
from typing import BinaryIO, TypeVar

import msgspec
from mcap import records

from recorder.mcap.reader import (
    DamagedError,
    End,
    Fault,
    Index,
    MessageBlock,
    PackedChunk,
    Piece,
    read_pieces,
    record_at,
)
from recorder.mcap.summary_reader import LogSummary, read_summary
from recorder.reading.faults import Faults
from recorder.reading.rows import Progress

Kind = TypeVar("Kind", records.MessageIndex, records.Metadata)


class Contents(msgspec.Struct):
    """The contents of a file.

    Attributes:
        schemas, channels: by id.
        counts: messages of each channel.
        spans: the first and the last log time of each channel.
        start_ns, end_ns: the first and the last log time of all; None if there is no message.
        metadata: name and entries of each record, in the order of the file.
        attachments: name, media type and length of each.
        faults: those of the file.
        has_ended: it was closed properly.
    """

    schemas: dict[int, records.Schema] = msgspec.field(default_factory=dict)
    channels: dict[int, records.Channel] = msgspec.field(default_factory=dict)
    counts: Counter[int] = msgspec.field(default_factory=Counter)
    spans: dict[int, tuple[int, int]] = msgspec.field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int | None = None
    metadata: list[tuple[str, dict[str, str]]] = msgspec.field(default_factory=list)
    attachments: list[tuple[str, str, int]] = msgspec.field(default_factory=list)
    faults: Faults = msgspec.field(default_factory=Faults)
    has_ended: bool = False

    def fault(self, offset: int, detail: str) -> None:
        """Something is wrong there."""
        self.faults.add(f"byte {offset}: {detail}")


def read_contents(stream: BinaryIO) -> Contents | None:
    """Return the contents by the summary; None if there is none, or it is not complete."""
    summary = read_summary(stream)
    if summary is None or summary.statistics is None or not tells_all(summary, summary.statistics):
        return None
    statistics = summary.statistics
    counts = Counter(
        {channel_id: count for channel_id, count in statistics.channel_message_counts.items() if count}
    )
    try:
        places = _places(stream, summary)
    except DamagedError:
        return None
    if places is None or not counts.keys() <= places[0].keys():
        return None
    contents = Contents(
        schemas=summary.schemas,
        channels=summary.channels,
        counts=counts,
        start_ns=statistics.message_start_time if statistics.message_count else None,
        end_ns=statistics.message_end_time if statistics.message_count else None,
        attachments=[(one.name, one.media_type, one.data_size) for one in summary.attachments],
        has_ended=True,
    )
    for channel_id in counts:
        first = _times(stream, channel_id, places[0][channel_id], contents)
        last = _times(stream, channel_id, places[1][channel_id], contents)
        if first and last:
            contents.spans[channel_id] = min(first), max(last)
    for one in summary.metadata:
        record = _record(stream, one.offset, records.Metadata)
        if record is not None and record.name == one.name:
            contents.metadata.append((record.name, record.metadata))
        else:
            contents.fault(one.offset, f"the metadata {one.name} is not where the summary says")
    return contents


def walk_contents(
    stream: BinaryIO, size: int, progress: Progress = lambda _: None, *, is_being_written: bool = False
) -> Contents:
    """Return the contents by a scan, record by record. Nothing in the file raises.

    Args:
        stream: the file.
        size: its length in bytes.
        progress: receives the number of bytes that were read.
        is_being_written: that it has no end yet is no fault.
    """
    contents = Contents()
    read_to = 0
    for piece in read_pieces(stream, size, is_verifying=False):
        if not (is_being_written and isinstance(piece, Fault) and piece.cuts):
            _take(contents, piece)
        if isinstance(piece, PackedChunk):
            progress(piece.end - read_to)
            read_to = piece.end
    progress(size - read_to)
    return contents


def tells_all(summary: LogSummary, statistics: records.Statistics) -> bool:
    """Report whether it repeats every schema and channel, and holds every index."""
    return (
        len(summary.schemas) >= statistics.schema_count
        and len(summary.channels) >= statistics.channel_count
        and len(summary.attachments) == statistics.attachment_count
        and len(summary.metadata) == statistics.metadata_count
        and statistics.message_count == sum(statistics.channel_message_counts.values())
    )


def _places(stream: BinaryIO, summary: LogSummary) -> tuple[dict[int, int], dict[int, int]] | None:
    """Return the offsets of each channel's first and last message index; None if chunks are not in time order."""
    first: dict[int, int] = {}
    last: dict[int, int] = {}
    start_ns = end_ns = 0
    for chunk in summary.chunks(stream):
        places = chunk.place_map()
        if places:
            if chunk.start_ns < start_ns or chunk.end_ns < end_ns:
                return None
            start_ns, end_ns = chunk.start_ns, chunk.end_ns
        last.update(places)
        if len(first) < len(last):
            first = places | first
    return first, last


def _times(stream: BinaryIO, channel_id: int, offset: int, contents: Contents) -> list[int]:
    """The log times of a message index; none if it is not there."""
    record = _record(stream, offset, records.MessageIndex)
    if record is not None and record.channel_id == channel_id and record.records:
        return [time_ns for time_ns, _ in record.records]
    contents.fault(offset, f"the message index of channel {channel_id} is not where the summary says")
    return []


def _record(stream: BinaryIO, offset: int, kind: type[Kind]) -> Kind | None:
    """The record there; None if it is no such record."""
    try:
        return record_at(stream, offset, kind)
    except DamagedError:
        return None


def _take(contents: Contents, piece: Piece) -> None:
    match piece:
        case PackedChunk() if piece.index is not None and piece.index.keys() <= contents.channels.keys():
            _count(contents, piece.index, piece.offset)
        case PackedChunk() | MessageBlock():
            # Others declare channels within chunks.
            index, others = piece.read_index()
            for one in others:
                _take(contents, one)
            _count(contents, index, piece.offset)
        case records.Schema():
            contents.schemas.setdefault(piece.id, piece)
        case records.Channel():
            # The summary repeats them.
            contents.channels.setdefault(piece.id, piece)
        case records.Attachment():
            contents.attachments.append((piece.name, piece.media_type, len(piece.data)))
        case records.Metadata():
            contents.metadata.append((piece.name, piece.metadata))
        case End():
            contents.has_ended = True
        case Fault():
            contents.fault(piece.offset, piece.detail)
        case _:
            pass


def _count(contents: Contents, index: Index, offset: int) -> None:
    """Takes messages by their index: log times and offsets in turns."""
    for channel_id, entries in index.items():
        if not entries:
            continue
        if channel_id not in contents.channels:
            contents.fault(
                offset, f"{len(entries) // 2} messages of channel {channel_id}, which the file does not hold"
            )
        times = entries[::2]
        first_ns, last_ns = min(times), max(times)
        before = contents.spans.get(channel_id, (first_ns, last_ns))
        contents.spans[channel_id] = min(before[0], first_ns), max(before[1], last_ns)
        contents.counts[channel_id] += len(times)
        contents.start_ns = first_ns if contents.start_ns is None else min(contents.start_ns, first_ns)
        contents.end_ns = last_ns if contents.end_ns is None else max(contents.end_ns, last_ns)
