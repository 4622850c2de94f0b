"""Selection of logs without the incidents that other logs hold completely."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from mcap import records

from recorder.mcap.reader import DamagedError, Fault, Index, MessageBlock, PackedChunk, read_pieces
from recorder.mcap.summary_reader import read_summary
from recorder.reading.log_file import LogFile
from recorder.reading.topics import Declared

Window = tuple[int, int]
"""From the first to the last log time, in nanoseconds since 1970."""

Times = dict[str, "array[int]"]
"""Of each topic the log times of its messages."""

ANY_TIME: Final[Window] = (0, 2**64 - 1)


def without_covered(logs: Sequence[LogFile]) -> list[LogFile]:
    """The logs of a directory but for the incidents whose every message others of them hold.

    A message is known by its topic and the time at which the recorder received it. A file that is damaged, or
    whose recorder lost something, holds less than the incident, which is then kept. What is in question is
    unpacked, and held against its checksums; nothing is decoded.
    """
    incidents = [log for log in logs if log.is_incident and log.end_ns]
    others = [log for log in logs if not log.is_incident]
    held: dict[LogFile, Times] = {incident: {} for incident in incidents}
    for log in others:
        within = [one for one in incidents if log.start_ns <= one.end_ns and one.start_ns <= log.end_ns]
        found = _times_in(log, [(one.start_ns, one.end_ns) for one in within]) if within else []
        for incident, times in zip(within, found, strict=True):
            _add(held[incident], times)
    return [log for log in logs if log not in held or not _is_covered(log, held[log])]


def _add(held: Times, times: Times) -> None:
    """Add the messages of another log. Two copies of a message count as one."""
    for topic, more in times.items():
        known = held.get(topic)
        if known is None:
            held[topic] = more
        elif known != more:
            held[topic] = array("Q", sorted((Counter(known) | Counter(more)).elements()))


def _is_covered(incident: LogFile, held: Times) -> bool:
    [own] = _times_in(incident, [ANY_TIME])
    return bool(own) and all(_holds(held.get(topic, array("Q")), times) for topic, times in own.items())


def _holds(held: array[int], times: array[int]) -> bool:
    return held == times or not Counter(times) - Counter(held)


def _times_in(log: LogFile, windows: Sequence[Window]) -> list[Times]:
    """For each window the log times of what a log holds in it and can be read, in their order."""
    found: list[dict[int, array[int]]] = [{} for _ in windows]
    declared = Declared()
    with suppress(OSError), log.open() as stream:
        declared.take_summary(read_summary(stream))
        for piece in read_pieces(stream, log.bytes, is_verifying=False):
            if isinstance(piece, records.Schema | records.Channel):
                declared.take(piece)
            elif isinstance(piece, PackedChunk | MessageBlock):
                for channel_id, entries in _index(piece, windows, declared).items():
                    _add_inside(found, windows, channel_id, entries[::2])
    return [_by_topic(of_window, declared) for of_window in found]


def _add_inside(
    found: list[dict[int, array[int]]], windows: Sequence[Window], channel_id: int, times: array[int]
) -> None:
    start_ns, end_ns = min(times, default=0), max(times, default=0)
    for (first_ns, last_ns), of_window in zip(windows, found, strict=True):
        is_all = first_ns <= start_ns and end_ns <= last_ns
        inside = times if is_all else [one for one in times if first_ns <= one <= last_ns]
        of_window.setdefault(channel_id, array("Q")).extend(inside)


def _by_topic(found: dict[int, array[int]], declared: Declared) -> Times:
    times: Times = {}
    for channel_id, of_channel in found.items():
        topic = declared.topics.get(channel_id)
        if topic is not None and of_channel:
            times.setdefault(topic.name, array("Q")).extend(of_channel)
    return {topic: array("Q", sorted(unsorted)) for topic, unsorted in times.items()}


def _index(piece: PackedChunk | MessageBlock, windows: Sequence[Window], declared: Declared) -> Index:
    """Return the places of a piece's messages; none for a chunk that lies in no window, or is damaged."""
    if isinstance(piece, PackedChunk):
        if not any(piece.start_ns <= last_ns and first_ns <= piece.end_ns for first_ns, last_ns in windows):
            return {}
        if piece.index is not None and piece.index.keys() <= declared.topics.keys():
            with suppress(DamagedError):
                piece.unpack()
                return piece.index
            return {}
    index, others = piece.read_index()
    for one in others:
        if not isinstance(one, Fault):
            declared.take(one)
    return index
