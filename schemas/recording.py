"""Messages of a recorder about itself, and the requests that it accepts.

A recorder is no robot: its keys begin ``{root}/@recorder/{recorder}``, a verbatim chunk, so that no wildcard of a
client of robots reaches it by accident. Its verbs stand below ``@cmd/{operator}`` like a robot's.
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, ClassVar, Final

import msgspec
from msgspec import Meta

from schemas.decisions import Severity
from schemas.messages import Count, DurationS, Message, RateHz, TimeNs, unit_keyword
from schemas.requests import Request

Bytes = Annotated[int, Meta(ge=0, le=2**63 - 1, extra_json_schema=unit_keyword("B"))]

LOG_CHUNK: Final = "log"
"""In a log, the topic ``{key}/log`` repeats the events of a key as text, for viewers."""

RAW_CHUNK: Final = "@raw"
"""In a log, the topic ``{key}/@raw`` holds samples that could not be decoded: viewers want a schema a topic."""


class RecorderState(Enum):
    """The state of a recorder. ``stopped``: it stands by. ``full``: it may use no more of the disk."""

    RECORDING = "recording"
    STOPPED = "stopped"
    FULL = "full"


class GapReason(Enum):
    """Reasons why messages that reached the recorder are not in a log."""

    QUEUE = "queue"
    DISK = "disk"
    FULL = "full"
    SIZE = "size"


class RecorderEventKind(Enum):
    """The kind of a recorder's event. ``gateway``: a robot's gateway vanished without announcing its end."""

    STARTED = "started"
    STOPPED = "stopped"
    FULL = "full"
    DISK = "disk"
    INCIDENT = "incident"
    DELETED = "deleted"
    RECOVERED = "recovered"
    GAP = "gap"
    GATEWAY = "gateway"


class RecorderHealth(Message, frozen=True):
    """The health of a recorder, published each second.

    Attributes:
        recorder: its chunk of the key.
        state_since_s: time in that state.
        files: logs that are being written now, incidents among them.
        files_ended: logs that were ended since the start; ``ended_bytes`` of them.
        robots: robots that it has received from; ``keys`` of theirs and of others.
        received: samples that reached it since the start.
        written: messages that it gave to logs since the start; a batch of raw frames is many.
        missed: samples that never reached it, by the gaps in their sequences, since the start.
        dropped: samples or messages that it could not keep since the start, by reason.
        queue_bytes: samples that wait to be recorded.
        disk_queue_bytes: messages that wait for the disk, before compression.
        ring_bytes: messages held for an incident, before compression.
        incidents: incident logs that were begun since the start.
        disk_free_bytes: of the directory's file system.
        disk_used_bytes: by this directory's logs, incidents among them.
        incident_bytes: by those that are incidents.
        cpu_percent: processor time of this process over the last second; 100 is one core.
        challenge: empty; of recorders of before in signed mode what an order echoed.
    """

    recorder: str
    recorder_version: str
    uptime_s: DurationS
    state: RecorderState
    state_since_s: DurationS
    files: Count
    files_ended: Count
    ended_bytes: Bytes
    robots: Count
    keys: Count
    received: Count
    received_per_s: RateHz
    written: Count
    missed: Count
    dropped: dict[str, Count]
    queue_bytes: Bytes
    disk_queue_bytes: Bytes
    ring_bytes: Bytes
    incidents: Count
    disk_free_bytes: Bytes
    disk_used_bytes: Bytes
    incident_bytes: Bytes
    cpu_percent: Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("%"))]
    challenge: Annotated[bytes, Meta(max_length=8)] = b""


class RecorderEvent(Message, frozen=True):
    """An event of a recording that a person should know about.

    Attributes:
        robot: the robot that it is about, or whose log; empty if it is about all.
        file: the log that it is about, without its directory; empty if there is none.
        operator: of recorders of before the operator who started or stopped it; else empty.
        text: the event in a sentence.
    """

    severity: Severity
    kind: RecorderEventKind
    robot: str
    file: str
    operator: str
    text: str


class RecordGap(Message, frozen=True):
    """Messages of one key that reached the recorder and are not in the log.

    Attributes:
        key: the key.
        first_ns: when the first of them was received, or not before.
        last_ns: when the last of them was received, or not after.
        count: number of samples if they were dropped unread, of the log's messages if the disk lost them.
    """

    key: str
    reason: GapReason
    first_ns: TimeNs
    last_ns: TimeNs
    count: Count


class RecorderReply(msgspec.Struct, frozen=True):
    """The reply to a verb of a recorder.

    Attributes:
        ok: the request was executed.
        detail: why not, or what was done, in words.
        files: the logs that it is about, without their directory: those ended, or the incidents begun.
        health: the recorder's, as it is now.
    """

    version: ClassVar[int] = 1

    ok: bool
    detail: str
    files: list[str]
    health: RecorderHealth


class Status(Request, frozen=True, forbid_unknown_fields=True):
    """Ask for the recorder's health."""


class Mark(Request, frozen=True, forbid_unknown_fields=True):
    """Keep what was received shortly before now and shortly after as an incident.

    Attributes:
        text: the reason; it goes into the log.
        robot: the robot to keep it of; every robot if it is empty.
    """

    text: Annotated[str, Meta(max_length=1000)] = ""
    robot: Annotated[str, Meta(max_length=200)] = ""
