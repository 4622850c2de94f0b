"""The recorder's settings, and the limits that decide what a log holds; see ``settings``."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec
from msgspec import Meta

from schemas.keys import ROBOT_PATTERN

CHANNEL_LIMIT: Final = 35_000
"""Channels of a log for keys that anybody may make up. Those beyond share one of RawSamples, each with its key."""

TABLE_CHANNEL_LIMIT: Final = 30_000
"""Channels of a log for the key table's own: together, and with what the recorder says, below MCAP's 65,535."""

BUS_LIMIT: Final = 8
"""Buses of a robot whose keys count among the table's: their names are not in it."""

ROBOT_LIMIT: Final = 1024
"""Robots that have logs of their own and are asked who they are; those beyond it share one log."""

OWNED_KEY_LIMIT: Final = 65_536
"""Keys of which the recorder remembers the expression that they belong to; beyond it, it begins anew."""

INCIDENT_MAX_NS: Final = 600_000_000_000
"""An incident that goes on and on is one log of ten minutes, and another one after that."""

INCIDENT_SHARE: Final = 0.5
"""Incidents may fill so much of ``budget_bytes``: they are never deleted, and the logs need room too."""

MARK_SHARE: Final = 0.25
"""Marks, which nobody signs, begin incidents up to so much of ``budget_bytes``: faults have the rest."""

INCIDENT_FLOOR_SHARE: Final = 0.5
"""Incidents may leave so much of ``floor_bytes`` free: the reserve below the floor is for them."""

EventKindName = Literal[
    "lease", "engaged", "stop", "stopped", "latch", "reset", "takeover", "fault", "guard", "gateway"
]


INCIDENT_EVENTS: Final[tuple[EventKindName, ...]] = ("stop", "stopped", "latch", "takeover", "fault", "guard")


class RecorderSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The recorder.

    Attributes:
        name: the recorder's chunk of its keys; if empty, in signed mode the name of its grant, else the host's
        keys: key expressions to record; if empty, everything under the root
        directory: the directory of the logs
        per_robot: a log for each robot; else one for all
        shard: NUMBER/COUNT, such as 2/4: this recorder is the second of four that share a fleet's robots by their
            names; if empty, it records all of them
        standby: write nothing but incidents
        flush_s: s; at most this much of the log is not yet on the disk
        chunk_bytes: bytes of a chunk before compression
        rotate_bytes: bytes; a log that has reached this size is ended, and another begun; 0 is never
        rotate_s: s; so is one that was begun so long ago; 0 is never
        queue_bytes: bytes of samples that may wait to be recorded; beyond it the oldest go, and are counted
        sample_max_bytes: bytes; a larger sample is not recorded, but counted
        budget_bytes: bytes that the directory's logs may take; beyond it the oldest go of the robot that takes
            most; 0 is no limit
        floor_bytes: bytes that stay free on the file system, or a tenth of it; below it the oldest logs go
        known_robots: names of the robots that are known, besides those that `recorder.keys` names; all others then
            share one robot's part of the budget
        keep_s: s; so much of a known robot's newest logs goes only when nothing else is left to go
        keep_incidents_s: s; an incident that an upload has brought to safety is deleted only when it is this old
        incident_events: kinds of `safety/event`, of severity warning or error, that make an incident
        incident_before_s: s before an incident that its log holds
        incident_after_s: s after an incident that its log holds
        incident_ring_bytes: bytes of messages held in memory for an incident, of all robots together
    """

    name: Annotated[str, Meta(pattern=r"^[a-z0-9-]*\Z")] = ""
    keys: list[str] = []
    directory: Annotated[str, Meta(min_length=1)] = "."
    per_robot: bool = True
    shard: Annotated[str, Meta(pattern=r"^([1-9][0-9]{0,2}/[1-9][0-9]{0,2})?\Z")] = ""
    standby: bool = False
    flush_s: Annotated[float, Meta(ge=0.05, le=10)] = 0.5
    chunk_bytes: Annotated[int, Meta(ge=1024, le=16_777_216)] = 1_048_576
    rotate_bytes: Annotated[int, Meta(ge=0)] = 0
    rotate_s: Annotated[float, Meta(ge=0, le=2_678_400)] = 0.0
    queue_bytes: Annotated[int, Meta(ge=1_000_000, le=16_000_000_000)] = 64_000_000
    sample_max_bytes: Annotated[int, Meta(ge=1024, le=1_000_000_000)] = 16_000_000
    budget_bytes: Annotated[int, Meta(ge=0)] = 0
    floor_bytes: Annotated[int, Meta(ge=0)] = 200_000_000
    known_robots: list[Annotated[str, Meta(pattern=rf"^{ROBOT_PATTERN}\Z")]] = []
    keep_s: Annotated[float, Meta(ge=0, le=2_678_400)] = 7200.0
    keep_incidents_s: Annotated[float, Meta(ge=0, le=31_536_000)] = 604_800.0
    incident_events: list[EventKindName] = msgspec.field(default_factory=lambda: [*INCIDENT_EVENTS])
    incident_before_s: Annotated[float, Meta(ge=0, le=300)] = 30.0
    incident_after_s: Annotated[float, Meta(ge=0, le=300)] = 30.0
    incident_ring_bytes: Annotated[int, Meta(ge=0, le=16_000_000_000)] = 64_000_000


class UploadSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The upload of finished logs: see docs/upload.md.

    Attributes:
        store: URL of the object store: s3://BUCKET/PLACE, gs://BUCKET/PLACE, az://CONTAINER/PLACE,
            file:///DIRECTORY; empty: nothing is uploaded
        options: of that store, by obstore's names, such as endpoint and region; credentials are the environment's
        logs: incidents and logs, or incidents alone
        rate_bytes_s: bytes/s that it takes of the link, each way, in the mean of parts of 5 MiB; 0 is no limit
        read_back: read each log back, and compare; else the store's own checksum is enough, where it has one
        catalog: put each log's row of the catalog beside it, for which it is read once more when no log waits
        cache_bytes: bytes of copies of a store's logs that `cruiser review` keeps in $XDG_CACHE_HOME/cruiser, or
            ~/.cache/cruiser; beyond it those go that were not asked for longest
    """

    store: str = ""
    options: dict[str, str | int | float | bool] = {}
    logs: Literal["all", "incidents"] = "all"
    rate_bytes_s: Annotated[int, Meta(ge=0, le=1_000_000_000)] = 250_000
    read_back: bool = True
    catalog: bool = True
    cache_bytes: Annotated[int, Meta(ge=0)] = 20_000_000_000
