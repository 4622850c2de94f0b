"""Raw frames of logs in the order of time, for the tools of CAN: received and sent, of all buses of a robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from heapq import heappop, heappush
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress, Row, Selection, read_rows
from recorder.reading.topics import UNREADABLE, Topic, typed_decoder
from schemas.messages import CanFrame

HORIZON_NS: Final = 3_000_000_000
"""Frames come in batches, each topic's for itself: so long is waited for those that belong before."""

HELD_MAX: Final = 200_000
"""So many frames wait at most, whatever their times are."""

_SUBJECTS: Final = {"can/{bus}/rx": False, "can/{bus}/tx": True}


class LoggedFrame(msgspec.Struct, frozen=True, gc=False):
    """A frame of a log.

    Attributes:
        is_sent: the gateway has sent it.
    """

    robot: str
    is_sent: bool
    frame: CanFrame


def is_frames(topic: Topic) -> bool:
    """Report whether the topic holds raw frames of a robot."""
    return topic.kind is CanFrame and topic.subject in _SUBJECTS


def read_frames(
    logs: Sequence[LogFile], selection: Selection, faults: Faults, progress: Progress = lambda _: None
) -> Iterator[LoggedFrame]:
    """The frames of logs by their own times, each once.

    Args:
        logs: in the order of their beginnings.
        selection: the wanted messages; of its topics only those of raw frames count.
        faults: takes what cannot be read.
        progress: receives the number of bytes that were read.
    """
    wants = selection.wants
    only_frames = msgspec.structs.replace(selection, wants=lambda topic: is_frames(topic) and wants(topic))
    broken: dict[str, int] = {}
    order = _Order()
    for row in read_rows(logs, only_frames, faults, progress):
        try:
            logged = _logged(row)
        except UNREADABLE:
            broken[row.topic.name] = broken.get(row.topic.name, 0) + 1
            continue
        yield from order.take(row, logged)
    yield from order.rest()
    for name, count in broken.items():
        faults.add(f"{count} messages of {name} cannot be read")


class _Order:
    """Puts frames in order, and leaves out what two logs have."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, tuple[object, ...], LoggedFrame]] = []
        # The log that a frame came from, as its topic is one object for each log: in one log two frames of a
        # batch may be the same in every bit.
        self._sources: dict[tuple[object, ...], Topic] = {}
        self._number = 0
        self._newest_ns = 0

    def take(self, row: Row, logged: LoggedFrame) -> Iterator[LoggedFrame]:
        time_ns = logged.frame.time_ns
        key = row.topic.name, row.publish_ns, row.sequence, row.data
        if self._sources.setdefault(key, row.topic) is not row.topic:
            return
        self._number += 1
        heappush(self._waiting, (time_ns, self._number, key, logged))
        self._newest_ns = max(self._newest_ns, time_ns)
        while self._waiting and (
            self._waiting[0][0] < self._newest_ns - HORIZON_NS or len(self._waiting) > HELD_MAX
        ):
            yield self._pop()

    def rest(self) -> Iterator[LoggedFrame]:
        while self._waiting:
            yield self._pop()

    def _pop(self) -> LoggedFrame:
        _, _, key, logged = heappop(self._waiting)
        self._sources.pop(key, None)
        return logged


def _logged(row: Row) -> LoggedFrame:
    frame: CanFrame = typed_decoder(CanFrame)(row.data)
    return LoggedFrame(row.topic.robot, _SUBJECTS[row.topic.subject], frame)
