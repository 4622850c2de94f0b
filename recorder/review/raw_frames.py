"""Raw frames of logs in the order of time, sent and received, and files of them for the tools of CAN.

Files are written by python-can, one a robot: candump log, ASC, BLF. A candump log has no class of an error frame
and no length of a remote frame, ASC neither class nor direction of an error frame. Times are to the microsecond;
ASC and BLF name no time zone, and have UTC here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from datetime import UTC, datetime
from heapq import heappop, heappush
from pathlib import Path
from typing import Any, Final

import can
import msgspec

from recorder.disk.files import give_name, new_path, staging
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Progress, Row, Selection, file_name, read_rows
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
    """The frames of logs by their own times, each once."""
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


WRITERS: Final = {
    "candump": (can.CanutilsLogWriter, ".log"),
    "asc": (can.ASCWriter, ".asc"),
    "blf": (can.BLFWriter, ".blf"),
}
"""The writer of each form, and the end of its files' names."""


class FramesOf(msgspec.Struct):
    """The file that was written for a robot.

    Attributes:
        late: frames that came after later ones had been written.
    """

    robot: str
    path: str
    frames: int = 0
    late: int = 0


def write_frames(frames: Iterable[LoggedFrame], directory: Path, form: str = "candump") -> list[FramesOf]:
    """Write frames in the order of time, each robot's to a file of its own.

    Raises:
        CommandError: one of the files is there already.
        OSError: the disk does not take one; nothing is left of any.
    """
    files: dict[str, FramesOf] = {}
    writers: dict[str, Any] = {}
    newest_ns: dict[str, int] = {}
    make, suffix = WRITERS[form]
    with staging(directory) as hidden:
        with ExitStack() as opened:
            for logged in frames:
                robot, frame = logged.robot, logged.frame
                if robot not in files:
                    path = new_path(directory, file_name(robot), suffix)
                    files[robot] = FramesOf(robot, str(path))
                    writers[robot] = opened.enter_context(make(hidden / path.name))
                    if form == "asc":
                        _begin(writers[robot], hidden / path.name, frame.time_ns)
                file = files[robot]
                file.frames += 1
                file.late += frame.time_ns < newest_ns.get(robot, 0)
                newest_ns[robot] = max(newest_ns.get(robot, 0), frame.time_ns)
                channel = _name_of(frame.bus) if form == "candump" else _number_of(frame.bus)
                writers[robot](_message(frame, channel, is_sent=logged.is_sent))
        for file in files.values():
            give_name(hidden / Path(file.path).name, Path(file.path))
    return list(files.values())


def _begin(writer: can.ASCWriter, path: Path, time_ns: int) -> None:
    """Date the file by its frames, in UTC; python-can's writer has put today's date, in local time.

    All times count from the first event, which it tells to the millisecond, and 5 of them as .5: let it be a whole
    second.
    """
    writer.file.flush()
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    began = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC)
    writer.file.seek(0)
    writer.file.truncate()
    writer.file.writelines([f"date {began:%a %b %d %H:%M:%S}.0 {began:%Y}\n", *lines[1:]])
    writer.log_event("cruiser review export", time_ns // 1_000_000_000)


def _name_of(bus: str) -> str:
    return re.sub(r"\s", "_", bus) or "can"


def _number_of(bus: str) -> int:
    """The number of a bus, by its name; one without any is the first."""
    found = re.search(r"\d{1,2}\Z", bus)
    return int(found[0]) if found else 0


def _message(frame: CanFrame, channel: str | int, *, is_sent: bool) -> can.Message:
    return can.Message(
        timestamp=frame.time_ns / 1e9,
        arbitration_id=frame.identifier,
        is_extended_id=frame.is_extended,
        is_remote_frame=frame.is_remote,
        is_error_frame=frame.is_error,
        is_fd=frame.is_fd,
        bitrate_switch=frame.bitrate_switch,
        error_state_indicator=frame.error_state_indicator,
        dlc=frame.dlc,
        data=None if frame.is_remote else frame.data,
        channel=channel,
        is_rx=not is_sent,
    )
