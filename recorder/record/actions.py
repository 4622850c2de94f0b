"""Actions of a recorder for the disk and Zenoh, the disk's notices, and the recorder's announcements. Pure.

``RobotLog`` makes an action on a log, the disk's queue holds it, and its ``write_to`` writes it into the file.
"""

from __future__ import annotations

from typing import Final

import msgspec

from recorder.mcap.writer import Chunk, LogChannel, McapFile
from schemas.command_line import short
from schemas.decisions import Severity
from schemas.recording import RecorderEvent, RecorderEventKind, RecordGap

INCIDENT_MARK: Final = "!"
"""Suffix of a log's name that names the log of its incidents. No robot's name holds it."""

ACTION_BYTES: Final = 100  # memory of an action besides its content


class LogAction(msgspec.Struct, frozen=True):
    """An operation on the files of the log called ``log``, in order."""

    log: str

    @property
    def bytes(self) -> int:
        """Memory while it waits."""
        return ACTION_BYTES

    @property
    def is_repeated(self) -> bool:
        """True if every later file of the log begins with it again."""
        return False

    def write_to(self, file: McapFile) -> None:
        """Write its record, if it has one."""


class OpenLog(LogAction, frozen=True):
    """Begin a file, and repeat the declarations of earlier files.

    Attributes:
        wall_ns: the time in the file's name, since 1970.
        is_incident: the file repeats the declarations of the log called ``name``.
    """

    name: str
    wall_ns: int
    is_incident: bool = False


class DeclareChannel(LogAction, frozen=True):
    """Write the channel, and its schema if that is new."""

    channel: LogChannel

    @property
    def bytes(self) -> int:
        return ACTION_BYTES + len(self.channel.topic)

    @property
    def is_repeated(self) -> bool:
        return True

    def write_to(self, file: McapFile) -> None:
        file.add_channel(self.channel)


class WriteChunk(LogAction, frozen=True):
    """Write a chunk of messages."""

    chunk: Chunk

    @property
    def bytes(self) -> int:
        return ACTION_BYTES + len(self.chunk.records)

    def write_to(self, file: McapFile) -> None:
        file.write_chunk(self.chunk)


class WriteMetadata(LogAction, frozen=True):
    """Write a metadata record; if it ``lasts``, later files of the log repeat it."""

    name: str
    entries: dict[str, str]
    lasts: bool = False

    @property
    def bytes(self) -> int:
        return ACTION_BYTES + sum(len(name) + len(entry) for name, entry in self.entries.items())

    @property
    def is_repeated(self) -> bool:
        return self.lasts

    def write_to(self, file: McapFile) -> None:
        file.add_metadata(self.name, self.entries)


class WriteAttachment(LogAction, frozen=True):
    """Write an attachment."""

    name: str
    media_type: str
    data: bytes
    wall_ns: int

    @property
    def bytes(self) -> int:
        return ACTION_BYTES + len(self.data)

    @property
    def is_repeated(self) -> bool:
        return True

    def write_to(self, file: McapFile) -> None:
        file.add_attachment(self.name, self.media_type, self.data, self.wall_ns)


class SyncLog(LogAction, frozen=True):
    """Sync the file to the disk."""


class CloseLog(LogAction, frozen=True):
    """Finish the file."""

    def write_to(self, file: McapFile) -> None:
        file.finish()


QUERIES_PER_TICK: Final = 8
"""Most queries in one tick: each costs the router and the recorder as much time as several samples."""


class Query(msgspec.Struct, frozen=True):
    """Query a key; the replies come as samples.

    Attributes:
        first: query the gateway's stored samples from this sequence on; None queries the current one.
    """

    key: str
    first: int | None = None


class Publish(msgspec.Struct, frozen=True):
    """Publish a message under the recorder's own keys."""

    message: RecorderEvent | RecordGap


Action = LogAction | Query | Publish


class Opened(msgspec.Struct, frozen=True):
    """A file of a log was begun; ``file`` is its final name without the directory."""

    log: str
    file: str


class Ended(msgspec.Struct, frozen=True):
    """A file of a log was ended."""

    log: str
    file: str
    bytes: int


class Lost(msgspec.Struct, frozen=True):
    """Messages of each channel that the disk lost, received between these times since 1970.

    Attributes:
        file: the file removed with them while it was written; empty if they were in none.
    """

    log: str
    counts: dict[int, int]
    first_ns: int
    last_ns: int
    file: str = ""


class DiskFault(msgspec.Struct, frozen=True):
    """The disk cannot be written; the recorder retries."""

    detail: str


class DiskBack(msgspec.Struct, frozen=True):
    """The disk can be written again."""


class Deleted(msgspec.Struct, frozen=True):
    """A log was deleted to free disk space."""

    file: str
    bytes: int


class Moved(msgspec.Struct, frozen=True):
    """The directory in which the logs were begun was moved or removed."""

    path: str


class Recovered(msgspec.Struct, frozen=True):
    """An unfinished log was recovered as ``file``."""

    file: str
    messages: int


class DiskRoom(msgspec.Struct, frozen=True):
    """A change of the disk's free space; ``roll`` asks to end the open logs, so that they may be deleted."""

    has_room: bool
    has_incident_room: bool
    roll: bool = False


Notice = Opened | Ended | Lost | DiskFault | DiskBack | Deleted | Moved | Recovered | DiskRoom


class Announcement(msgspec.Struct, frozen=True):
    """News for people; see ``schemas.recording.RecorderEvent``."""

    kind: RecorderEventKind
    severity: Severity
    text: str
    file: str = ""
    operator: str = ""
    robot: str = ""


FULL: Final = Announcement(
    RecorderEventKind.FULL,
    Severity.ERROR,
    "recording stopped: the disk is full, and deleting old logs would not free enough space",
)
ROOM: Final = Announcement(RecorderEventKind.FULL, Severity.INFO, "recording resumed: there is free disk space")


def incident_begun(file: str, because: str) -> Announcement:
    text = f"incident recorded in {file}: {because}"
    return Announcement(RecorderEventKind.INCIDENT, Severity.WARNING, text, file)


def incident_refused(robot: str, because: str) -> Announcement:
    text = f"incident of {robot} not recorded, the disk space for incidents is used up: {because}"
    return Announcement(RecorderEventKind.INCIDENT, Severity.ERROR, text)


def incident_cut(robot: str, file: str) -> Announcement:
    text = f"incident of {robot} ended early: the disk space for incidents is used up"
    return Announcement(RecorderEventKind.INCIDENT, Severity.ERROR, text, file)


def other_version(robot: str, subject: str, what: str) -> Announcement:
    return Announcement(RecorderEventKind.GAP, Severity.WARNING, short(f"{subject}: {what}"), robot=robot)


def announcement_of(notice: Notice) -> Announcement | None:
    match notice:
        case DiskFault():
            return Announcement(RecorderEventKind.DISK, Severity.ERROR, f"logs cannot be written: {notice.detail}")
        case DiskBack():
            return Announcement(RecorderEventKind.DISK, Severity.INFO, "logs can be written again")
        case Lost(file=file) if file:
            count = sum(notice.counts.values())
            text = f"{file} was removed while it was written: {count} messages lost"
            return Announcement(RecorderEventKind.DISK, Severity.ERROR, text, file)
        case Deleted():
            text = f"{notice.file} was deleted to free disk space: {notice.bytes} bytes"
            return Announcement(RecorderEventKind.DELETED, Severity.INFO, text, notice.file)
        case Moved():
            text = f"{notice.path} was moved or removed: the open logs are ended, and new ones begun"
            return Announcement(RecorderEventKind.DISK, Severity.WARNING, text)
        case Recovered():
            text = f"unfinished log recovered as {notice.file}: {notice.messages} messages"
            return Announcement(RecorderEventKind.RECOVERED, Severity.INFO, text, notice.file)
        case _:
            return None
