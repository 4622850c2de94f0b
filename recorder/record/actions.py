"""Actions that a recorder asks of the disk and of Zenoh, and the disk's notices and its own. Pure.

An action on a log is one object all the way: ``RobotLog`` makes it, it waits in the queue of the disk, and its
``write_to`` writes it into the file.
"""

from __future__ import annotations

from typing import Final

import msgspec

from recorder.mcap.writer import Chunk, LogChannel, McapFile
from schemas.command_line import short
from schemas.decisions import Severity
from schemas.recording import RecorderEvent, RecorderEventKind, RecordGap

INCIDENT_MARK: Final = "!"
"""Behind a log's name this makes the name of the log of its incidents. No robot's name holds it."""

ACTION_BYTES: Final = 100  # memory that an action takes besides what it carries


class LogAction(msgspec.Struct, frozen=True):
    """Something to do on the files of one log, in the order of the actions.

    Attributes:
        log: the log's name. A log is no file: its files follow each other.
    """

    log: str

    @property
    def bytes(self) -> int:
        """Memory that it takes while it waits."""
        return ACTION_BYTES

    @property
    def is_repeated(self) -> bool:
        """True if every file that continues the present one begins with it again."""
        return False

    def write_to(self, file: McapFile) -> None:
        """Write the record that it stands for, if it stands for one."""


class OpenLog(LogAction, frozen=True):
    """Begin a file, and repeat in it what the files before it declared.

    Attributes:
        wall_ns: the time in the file's name, since 1970.
        is_incident: the file repeats what the log called ``name`` has declared.
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
    """Write these messages."""

    chunk: Chunk

    @property
    def bytes(self) -> int:
        return ACTION_BYTES + len(self.chunk.records)

    def write_to(self, file: McapFile) -> None:
        file.write_chunk(self.chunk)


class WriteMetadata(LogAction, frozen=True):
    """Write a metadata record.

    Attributes:
        lasts: the files that continue this one repeat it.
    """

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
    """Have all that is written reach the disk."""


class CloseLog(LogAction, frozen=True):
    """Make the file whole."""

    def write_to(self, file: McapFile) -> None:
        file.finish()


QUERIES_PER_TICK: Final = 8
"""Queries in one tick at most, however many robots turn up at once: one takes a router and the recorder as long as
several samples do."""


class Query(msgspec.Struct, frozen=True):
    """Query a key. The replies are samples, and marked as replies.

    Attributes:
        first: of the samples that the gateway keeps, those from this sequence on; None asks for the present one.
    """

    key: str
    first: int | None = None


class Publish(msgspec.Struct, frozen=True):
    """Publish a message under the recorder's own keys."""

    message: RecorderEvent | RecordGap


Action = LogAction | Query | Publish  # whatever a recorder asks for


class Opened(msgspec.Struct, frozen=True):
    """A file of a log was begun; ``file`` is its name without the directory, as it will be when it is whole."""

    log: str
    file: str


class Ended(msgspec.Struct, frozen=True):
    """A file of a log is whole, or as whole as it could be made."""

    log: str
    file: str
    bytes: int


class Lost(msgspec.Struct, frozen=True):
    """Messages of each channel that the disk did not take or keep, received between these times since 1970.

    Attributes:
        file: somebody has removed it with them, while it was written; empty if they were in none.
    """

    log: str
    counts: dict[int, int]
    first_ns: int
    last_ns: int
    file: str = ""


class DiskFault(msgspec.Struct, frozen=True):
    """The disk takes nothing; the recorder tries on."""

    detail: str


class DiskBack(msgspec.Struct, frozen=True):
    """The disk takes the logs again."""


class Deleted(msgspec.Struct, frozen=True):
    """A log was deleted for want of room."""

    file: str
    bytes: int


class Moved(msgspec.Struct, frozen=True):
    """The directory of the logs is not the one any more in which they were begun."""

    path: str


class Recovered(msgspec.Struct, frozen=True):
    """A log that was left unfinished is whole now, as ``file``."""

    file: str
    messages: int


class DiskRoom(msgspec.Struct, frozen=True):
    """A change of what the disk may hold.

    Attributes:
        roll: the logs are to be ended, so that they may be deleted.
    """

    has_room: bool
    has_incident_room: bool
    roll: bool = False


Notice = Opened | Ended | Lost | DiskFault | DiskBack | Deleted | Moved | Recovered | DiskRoom


class Announcement(msgspec.Struct, frozen=True):
    """Something that people are to know; see ``schemas.recording.RecorderEvent``."""

    kind: RecorderEventKind
    severity: Severity
    text: str
    file: str = ""
    operator: str = ""
    robot: str = ""


FULL: Final = Announcement(
    RecorderEventKind.FULL,
    Severity.ERROR,
    "recording has stopped: the disk may hold no more, and nothing that may be deleted would be enough",
)
ROOM: Final = Announcement(RecorderEventKind.FULL, Severity.INFO, "there is room on the disk again")


def incident_begun(file: str, because: str) -> Announcement:
    text = f"{file} keeps what came before and after: {because}"
    return Announcement(RecorderEventKind.INCIDENT, Severity.WARNING, text, file)


def incident_refused(robot: str, because: str) -> Announcement:
    text = f"the disk may hold no more incidents, so none is kept of {robot}: {because}"
    return Announcement(RecorderEventKind.INCIDENT, Severity.ERROR, text)


def incident_cut(robot: str, file: str) -> Announcement:
    text = f"the disk may hold no more incidents, so the one that was being written of {robot} has ended early"
    return Announcement(RecorderEventKind.INCIDENT, Severity.ERROR, text, file)


def other_version(robot: str, subject: str, what: str) -> Announcement:
    return Announcement(RecorderEventKind.GAP, Severity.WARNING, short(f"{subject}: {what}"), robot=robot)


def announcement_of(notice: Notice) -> Announcement | None:
    match notice:
        case DiskFault():
            return Announcement(RecorderEventKind.DISK, Severity.ERROR, f"the disk takes no logs: {notice.detail}")
        case DiskBack():
            return Announcement(RecorderEventKind.DISK, Severity.INFO, "the disk takes the logs again")
        case Lost(file=file) if file:
            count = sum(notice.counts.values())
            text = f"somebody has removed {file} while it was written: {count} messages are gone with it"
            return Announcement(RecorderEventKind.DISK, Severity.ERROR, text, file)
        case Deleted():
            text = f"{notice.file} was deleted for want of room: {notice.bytes} bytes"
            return Announcement(RecorderEventKind.DELETED, Severity.INFO, text, notice.file)
        case Moved():
            text = f"somebody has moved or removed {notice.path}: what was being written ends where it is now"
            return Announcement(RecorderEventKind.DISK, Severity.WARNING, text)
        case Recovered():
            text = f"{notice.file} was left unfinished, and is whole now: {notice.messages} messages"
            return Announcement(RecorderEventKind.RECOVERED, Severity.INFO, text, notice.file)
        case _:
            return None
