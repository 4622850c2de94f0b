"""Whether an incident can be left out: all of it is in other logs too, and can be read there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import BinaryIO, Final

from mcap import records

from recorder.mcap_scan import BROKEN
from recorder.review.declared import Declared
from recorder.review.log_file import LogFile
from recorder.review.pieces import Fault, LooseMessage, PackedChunk, read_pieces
from recorder.review.summary import read_summary
from recorder.review.walk import LoggedMessage, messages

Window = tuple[int, int]
"""From the first to the last log time, in nanoseconds since 1970."""

ANY_TIME: Final[Window] = (0, 2**64)


def without_covered(logs: Sequence[LogFile]) -> list[LogFile]:
    """The logs of a directory but for the incidents whose every message others of them hold.

    A file that is damaged, or whose recorder lost something, holds less than the incident, which is then kept.
    What is in question is unpacked, and held against its checksums; nothing is decoded.
    """
    incidents = [log for log in logs if log.is_incident and log.end_ns]
    others = [log for log in logs if not log.is_incident]
    held: dict[LogFile, Counter[str]] = {incident: Counter() for incident in incidents}
    for log in others:
        within = [one for one in incidents if log.start_ns <= one.end_ns and one.start_ns <= log.end_ns]
        if within:
            for place, counts in enumerate(_counts(log, [(one.start_ns, one.end_ns) for one in within])):
                held[within[place]] += counts
    return [log for log in logs if log not in held or not _is_covered(log, held[log])]


def _is_covered(incident: LogFile, held: Counter[str]) -> bool:
    [own] = _counts(incident, [ANY_TIME])
    return bool(own) and not own - held


def _counts(log: LogFile, windows: Sequence[Window]) -> list[Counter[str]]:
    """For each window how many messages of each topic a log holds in it, of those that can be read."""
    counts = [Counter[str]() for _ in windows]
    with suppress(OSError), log.path.open("rb") as stream:
        declared = Declared()
        declared.take_summary(read_summary(stream))
        for channel_id, times in _times(stream, log.bytes, windows, declared):
            topic = declared.topics.get(channel_id)
            for count, (first_ns, last_ns) in zip(counts, windows, strict=True):
                if topic is not None and (found := sum(first_ns <= time_ns <= last_ns for time_ns in times)):
                    count[topic.name] += found
    return counts


def _times(
    stream: BinaryIO, size: int, windows: Sequence[Window], declared: Declared
) -> Iterator[tuple[int, Sequence[int]]]:
    """Channel ids and log times of messages; chunks that lie in no window are passed over."""
    for piece in read_pieces(stream, size, is_verifying=False):
        if isinstance(piece, PackedChunk):
            if any(piece.start_ns <= last_ns and first_ns <= piece.end_ns for first_ns, last_ns in windows):
                yield from _of_chunk(stream, piece, declared)
        elif isinstance(piece, LooseMessage):
            yield from _one_by_one(piece.offset, piece.raw, declared)
        elif isinstance(piece, records.Schema | records.Channel):
            declared.take(piece)


def _of_chunk(stream: BinaryIO, chunk: PackedChunk, declared: Declared) -> Iterator[tuple[int, Sequence[int]]]:
    with suppress(*BROKEN):
        content = chunk.unpack(stream)
        if chunk.index is None or not chunk.index.keys() <= declared.topics.keys():
            yield from _one_by_one(chunk.offset, content, declared)
        else:
            yield from ((channel_id, entries[::2]) for channel_id, entries in chunk.index.items())


def _one_by_one(offset: int, content: bytes, declared: Declared) -> Iterator[tuple[int, Sequence[int]]]:
    for one in messages(offset, content):
        if isinstance(one, LoggedMessage):
            yield one.channel_id, (one.log_ns,)
        elif not isinstance(one, Fault):
            declared.take(one)
