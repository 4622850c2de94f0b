"""Notices of the disk to the recorder, and announcements of the recorder to people. Pure."""

from __future__ import annotations

from typing import Final

import msgspec

from schemas.command_line import short
from schemas.decisions import Severity
from schemas.recording import RecorderEventKind


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
        has_room: whether logs may be written.
        has_incident_room: whether incidents may be written.
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
    """Announce an incident that is being written."""
    text = f"{file} keeps what came before and after: {because}"
    return Announcement(RecorderEventKind.INCIDENT, Severity.WARNING, text, file)


def incident_refused(robot: str, because: str) -> Announcement:
    """Announce an incident for which there is no room."""
    text = f"the disk may hold no more incidents, so none is kept of {robot}: {because}"
    return Announcement(RecorderEventKind.INCIDENT, Severity.ERROR, text)


def incident_cut(robot: str, file: str) -> Announcement:
    """Announce an incident that was ended for want of room."""
    text = f"the disk may hold no more incidents, so the one that was being written of {robot} has ended early"
    return Announcement(RecorderEventKind.INCIDENT, Severity.ERROR, text, file)


def other_version(robot: str, subject: str, what: str) -> Announcement:
    """Announce samples of another version, which the recorder records as far as it knows them."""
    return Announcement(RecorderEventKind.GAP, Severity.WARNING, short(f"{subject}: {what}"), robot=robot)


def announcement_of(notice: Notice) -> Announcement | None:
    """Announce what people should know of a notice; None if there is nothing."""
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
