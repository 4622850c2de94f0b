"""Raw frames of logs in the order of time, sent and received, and files of them for the tools of CAN.

Files are written by python-can, one a robot: candump log, ASC, BLF. Not every format holds everything: a candump
log has no class of an error frame and no length of a remote frame, ASC neither the class nor the direction of an
error frame. Times are to the microsecond; ASC and BLF name no time zone, and have UTC here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from datetime import UTC, datetime
from enum import Enum
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


CHANNEL_MAX: Final = 255
"""ASC and BLF number the buses from 1."""

STARTED: Final = "cruiser review export"
"""The first event of an ASC file."""


class FrameFormat(Enum):
    """A format; the value is the files' suffix."""

    CANDUMP = "log"
    ASC = "asc"
    BLF = "blf"


_WRITERS: Final[dict[FrameFormat, Callable[[Path], Any]]] = {
    FrameFormat.CANDUMP: can.CanutilsLogWriter,
    FrameFormat.ASC: can.ASCWriter,
    FrameFormat.BLF: can.BLFWriter,
}


class FramesOf(msgspec.Struct, frozen=True):
    """The file that was written for a robot.

    Attributes:
        late: frames that came after later ones had been written.
    """

    robot: str
    path: str
    frames: int
    late: int


def write_frames(frames: Iterable[LoggedFrame], directory: Path, form: FrameFormat) -> list[FramesOf]:
    """Write frames in the order of time, each robot's to a file of its own.

    Raises:
        CommandError: one of the files is there already.
        OSError: the disk does not take one; nothing is left of any.
    """
    files: dict[str, FrameFile] = {}
    paths: dict[str, Path] = {}
    with staging(directory) as hidden:
        with ExitStack() as writers:
            for logged in frames:
                robot = logged.robot
                if robot not in files:
                    paths[robot] = new_path(directory, file_name(robot), f".{form.value}")
                    files[robot] = FrameFile(hidden / paths[robot].name, form)
                    writers.enter_context(files[robot].writer)
                files[robot].write(logged)
        for path in paths.values():
            give_name(hidden / path.name, path)
    return [FramesOf(robot, str(paths[robot]), file.frames, file.late) for robot, file in files.items()]


class FrameFile:
    """One file of the frames of one robot.

    Attributes:
        writer: python-can's, which ends the file.
        channels: the number of each bus, from 0; the file's own begin at 1. ``can0`` is 0 if nobody else is.
        frames: that were written...
        late: ...and those of them that came after later ones.
    """

    def __init__(self, path: Path, form: FrameFormat) -> None:
        self._path = path
        self._form = form
        self.channels: dict[str, int] = {}
        self.frames = self.late = 0
        self._last_ns = 0
        self.writer = _WRITERS[form](path)

    def write(self, logged: LoggedFrame) -> None:
        """The next frame."""
        frame = logged.frame
        if not self.frames:
            self._begin(frame.time_ns)
        self.frames += 1
        self.late += frame.time_ns < self._last_ns
        self._last_ns = max(self._last_ns, frame.time_ns)
        channel = self._channel(frame.bus)
        self.writer(_message(frame, channel, is_sent=logged.is_sent))

    def _begin(self, time_ns: int) -> None:
        if self._form is FrameFormat.ASC:
            self._date(time_ns)
            # All times count from the file's beginning, which python-can tells to the millisecond, and 5 of them
            # as .5: let it be a whole second.
            self.writer.log_event(STARTED, time_ns // 1_000_000_000)

    def _date(self, time_ns: int) -> None:
        """The day of the frames, in UTC as in a BLF file; python-can's writer has put today's, in local time."""
        file = self.writer.file
        file.flush()
        lines = self._path.read_text(encoding="utf-8").splitlines(keepends=True)
        began = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC)
        lines[0] = f"date {began:%a %b %d %H:%M:%S}.0 {began:%Y}\n"
        file.seek(0)
        file.truncate()
        file.writelines(lines)

    def _channel(self, bus: str) -> str | int:
        if self._form is FrameFormat.CANDUMP:
            return re.sub(r"\s", "_", bus) or "can"
        number = self.channels.get(bus)
        if number is None:
            wanted = re.search(r"(\d{1,3})\Z", bus)
            taken = set(self.channels.values())
            number = int(wanted[1]) if wanted and int(wanted[1]) < CHANNEL_MAX else 0
            while number in taken and len(taken) <= CHANNEL_MAX:
                number = (number + 1) % (CHANNEL_MAX + 1)
            self.channels[bus] = number
        return number


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
