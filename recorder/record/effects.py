"""What a recording session asks of the disk and of Zenoh, in this order."""

from __future__ import annotations

import msgspec

from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import Chunk
from schemas.recording import RecorderEvent, RecordGap


class OpenLog(msgspec.Struct, frozen=True):
    """Begin a log file whose name holds these, and which repeats what those before it declared.

    An incident's does not: it is told all that it needs.
    """

    name: str
    wall_ns: int
    is_incident: bool = False


class DeclareChannel(msgspec.Struct, frozen=True):
    """Write the channel, and its schema if that is new."""

    channel: LogChannel


class WriteChunk(msgspec.Struct, frozen=True):
    """Write these messages."""

    chunk: Chunk


class WriteMetadata(msgspec.Struct, frozen=True):
    """Write a metadata record; if it ``lasts``, into the files that continue this one too."""

    name: str
    entries: dict[str, str]
    lasts: bool = False


class WriteAttachment(msgspec.Struct, frozen=True):
    """Write an attachment."""

    name: str
    media_type: str
    data: bytes
    wall_ns: int


class SyncLog(msgspec.Struct, frozen=True):
    """Have all that is written reach the disk."""


class CloseLog(msgspec.Struct, frozen=True):
    """Make the file whole."""


class AskInfo(msgspec.Struct, frozen=True):
    """Query this key; the reply is a sample like any other."""

    key: str


class AskKept(msgspec.Struct, frozen=True):
    """Query a key for the samples that its gateway keeps, from this sequence on; the replies are marked."""

    key: str
    first: int


class Alarm(msgspec.Struct, frozen=True):
    """Something has happened to a robot whose before and after are to be kept."""

    because: str
    wall_ns: int


class OnLog(msgspec.Struct, frozen=True):
    """Carry these out on one of several logs, in this order. The log is no file: its files follow each other."""

    log: str
    effects: tuple[OpenLog | FileEffect, ...]


class Say(msgspec.Struct, frozen=True):
    """Publish this under the recorder's own keys."""

    message: RecorderEvent | RecordGap


Ask = AskInfo | AskKept
FileEffect = DeclareChannel | WriteChunk | WriteMetadata | WriteAttachment | SyncLog | CloseLog
Effect = OpenLog | FileEffect | Ask | Alarm
"""What a session asks for."""

Doing = OnLog | Say | Ask
"""What a whole recording asks for."""
