"""Messages of a recorder about itself, and the requests that it accepts.

A recorder's keys begin ``{root}/@recorder/{recorder}``, a verbatim chunk, which no wildcard for robots matches.
Its verbs are below ``@cmd/{operator}`` like a robot's.
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

TRANSFORM_CHUNK: Final = "tf"
"""Beside ``chassis/odometry``, ``{key}/tf`` has the robot's pose as a transform, for viewers."""

OUTLINE_CHUNK: Final = "outline"
"""Beside ``chassis/odometry``, ``{key}/outline`` has the robot's shape, for viewers."""

RAW_CHUNK: Final = "@raw"
"""In a log, the topic ``{key}/@raw`` holds samples that could not be decoded: viewers want a schema a topic."""


class RecorderState(Enum):
    """The state of a recorder. ``stopped``: standby. ``full``: its share of the disk is used up."""

    RECORDING = "recording"
    STOPPED = "stopped"
    FULL = "full"


class GapReason(Enum):
    """Reasons why messages that the recorder received are not in a log."""

    QUEUE = "queue"
    DISK = "disk"
    FULL = "full"
    SIZE = "size"


class RecorderEventKind(Enum):
    """The kind of a recorder's event. ``gateway``: a gateway disappeared without announcing its end."""

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
        recorder: the recorder's chunk of the key.
        state_since_s: time in that state.
        files: logs being written now, incidents included.
        files_ended: logs ended since the start; ``ended_bytes`` is their size.
        robots: robots with received samples; ``keys``, of robots and others.
        received: samples received since the start.
        written: messages written to logs since the start; each frame of a batch counts.
        missed: samples not received since the start, by gaps in their sequences.
        dropped: samples or messages dropped since the start, by reason.
        queue_bytes: samples that wait to be recorded.
        disk_queue_bytes: messages that wait for the disk, before compression.
        ring_bytes: messages held for an incident, before compression.
        incidents: incident logs begun since the start.
        disk_free_bytes: of the directory's file system.
        disk_used_bytes: by this directory's logs, incidents included.
        incident_bytes: by incidents.
        cpu_percent: processor time of this process over the last second; 100 is one core.
        challenge: always empty.
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
    """An event of a recording that a person should know.

    Attributes:
        robot: the robot concerned, or whose log is; empty for all.
        file: the log concerned, without its directory; empty if there is none.
        operator: always empty.
        text: the event in a sentence.
    """

    severity: Severity
    kind: RecorderEventKind
    robot: str
    file: str
    operator: str
    text: str


class RecordGap(Message, frozen=True):
    """Messages of one key that the recorder received and that are not in the log.

    Attributes:
        key: the key.
        first_ns: earliest time at which the first of them was received.
        last_ns: latest time at which the last of them was received.
        count: number of samples if they were dropped unread, of log messages if the disk lost them.
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
        detail: what was done, or why not.
        files: the logs that were ended, or the incidents that were begun, without their directory.
        health: the recorder's health now.
    """

    version: ClassVar[int] = 1

    ok: bool
    detail: str
    files: list[str]
    health: RecorderHealth


class Status(Request, frozen=True, forbid_unknown_fields=True):
    """Request the recorder's health."""


class Mark(Request, frozen=True, forbid_unknown_fields=True):
    """Record the time shortly before and after now as an incident.

    Attributes:
        text: the reason, written to the log.
        robot: the robot concerned; every robot if it is empty.
    """

    text: Annotated[str, Meta(max_length=1000)] = ""
    robot: Annotated[str, Meta(max_length=200)] = ""
