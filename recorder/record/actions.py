"""The actions that a recorder asks of the disk and of Zenoh. Pure.

An action on a log is the same object from ``RobotLog``, which makes it, through the queue of the disk, where it
waits, into the file, where ``write_to`` puts it.
"""

from __future__ import annotations

from typing import Final

import msgspec

from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import Chunk
from recorder.mcap.writer import McapFile
from schemas.recording import RecorderEvent, RecordGap

INCIDENT_MARK: Final = "!"
"""Behind a log's name this makes the name of the log of its incidents. No robot's name holds it."""

ACTION_BYTES: Final = 100
"""Memory that an action takes besides what it carries."""


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
        name: begins the file's name.
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
        """The topic; the schema is one that all channels of a kind share."""
        return ACTION_BYTES + len(self.channel.topic)

    @property
    def is_repeated(self) -> bool:
        """Always: messages of the next file may be on it."""
        return True

    def write_to(self, file: McapFile) -> None:
        """Write the channel."""
        file.add_channel(self.channel)


class WriteChunk(LogAction, frozen=True):
    """Write these messages."""

    chunk: Chunk

    @property
    def bytes(self) -> int:
        """The messages, before compression."""
        return ACTION_BYTES + len(self.chunk.records)

    def write_to(self, file: McapFile) -> None:
        """Compress and write the messages."""
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
        """All names and values."""
        return ACTION_BYTES + sum(len(name) + len(entry) for name, entry in self.entries.items())

    @property
    def is_repeated(self) -> bool:
        """True if it lasts."""
        return self.lasts

    def write_to(self, file: McapFile) -> None:
        """Write the record."""
        file.add_metadata(self.name, self.entries)


class WriteAttachment(LogAction, frozen=True):
    """Write an attachment."""

    name: str
    media_type: str
    data: bytes
    wall_ns: int

    @property
    def bytes(self) -> int:
        """The content."""
        return ACTION_BYTES + len(self.data)

    @property
    def is_repeated(self) -> bool:
        """Always: each file can be read alone."""
        return True

    def write_to(self, file: McapFile) -> None:
        """Write the attachment."""
        file.add_attachment(self.name, self.media_type, self.data, self.wall_ns)


class SyncLog(LogAction, frozen=True):
    """Have all that is written reach the disk."""


class CloseLog(LogAction, frozen=True):
    """Make the file whole."""

    def write_to(self, file: McapFile) -> None:
        """Write the end of the data, the summary and the footer."""
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


Action = LogAction | Query | Publish
"""Whatever a recorder asks for."""
