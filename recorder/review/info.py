"""The contents of logs by their own account: channels, losses and robots.

It is read from the end of a file and its recorder's metadata, without unpacking a chunk; a file without such an
end is read record by record. ``check`` verifies that it is true.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from recorder.layouts.attached import RobotKeys
from recorder.reading.logs import Faults, LogFile, is_being_written, open_log
from recorder.reading.rows import Contents, Progress, read_contents, walk_contents
from recorder.reading.survey import survey
from recorder.reading.topics import Topic
from recorder.record.accounting import COMPLETENESS_NAME, KeyReport
from recorder.record.incidents import INCIDENT_NAME
from recorder.record.robots import METADATA_NAME
from schemas import keys
from schemas.subjects import RECORDER_CHUNK

CUT_NAME: Final = "cruiser.cut"  # the metadata record of a part of a log: its time, topics and source files


class LogSourceInfo(Enum):
    """The part of a file that was read."""

    SUMMARY = "summary"
    RECORDS = "records"


class ChannelInfo(msgspec.Struct, frozen=True):
    """A channel.

    Attributes:
        first_ns, last_ns: log times; None without messages or a readable index.
        rate_hz: mean over the channel's own span; None for fewer than two messages.
    """

    topic: str
    schema: str
    encoding: str
    messages: int
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None


class AttachmentInfo(msgspec.Struct, frozen=True):
    """An attachment of a log."""

    name: str
    media_type: str
    bytes: int


class LogInfo(msgspec.Struct, frozen=True):
    """A log.

    Attributes:
        whole: the file was closed properly; its data may still be damaged (``check``).
        is_being_written: a recorder has it open, so it is not whole yet.
        source: where this was read from.
        faults: the first faults of the file; ``fault_count``, all of them.
        robots: names, by the recorder's metadata, or else by the topics.
        versions: of the recorder and of each robot's gateway.
        metadata: all metadata records by name, the last of each.
        completeness: the recorder's account of losses by topic; empty if it gives none.
        is_cut: this is a part of the log that ``completeness`` is about.
        incidents: file, time and reason of each incident of this log, or of the log of this incident.
        incident: the last of ``incidents``.
    """

    path: str
    bytes: int
    whole: bool
    is_being_written: bool
    source: LogSourceInfo
    faults: list[str]
    fault_count: int
    messages: int
    start_ns: int | None
    end_ns: int | None
    duration_s: float
    robots: list[str]
    variants: dict[str, str]
    versions: dict[str, str]
    channels: list[ChannelInfo]
    attachments: list[AttachmentInfo]
    metadata: dict[str, dict[str, str]]
    completeness: dict[str, KeyReport]
    is_cut: bool
    incidents: list[dict[str, str]]
    incident: dict[str, str]


class LogBrief(msgspec.Struct, frozen=True, kw_only=True):
    """A log in a line, with fields of ``LogInfo``.

    Attributes:
        lost: samples and messages, by the recorder's account; None without one.
    """

    path: str
    bytes: int
    whole: bool
    is_being_written: bool
    messages: int
    start_ns: int | None
    end_ns: int | None
    duration_s: float
    robots: list[str]
    lost: int | None


class SetInfo(msgspec.Struct, frozen=True):
    """Several logs together.

    Attributes:
        whole: number of files that were closed properly.
        duration_s: from the first message to the last.
    """

    files: int
    whole: int
    bytes: int
    messages: int
    start_ns: int | None
    end_ns: int | None
    duration_s: float
    robots: list[str]


def read_info(path: Path, progress: Progress = lambda _: None) -> LogInfo:
    """Read what a log holds. Raises CommandError if there is no such file, or it is not an MCAP file."""
    with open_log(path) as (stream, size):
        return _read(stream, size, str(path), progress, is_written=is_being_written(stream))


def brief(info: LogInfo) -> LogBrief:
    shared = (field for field in LogBrief.__struct_fields__ if field != "lost")
    return LogBrief(**{field: getattr(info, field) for field in shared}, lost=lost(info))


def lost(info: LogInfo) -> int | None:
    """The number of lost samples and messages, by the recorder's account; None without one."""
    return sum(one.lost for one in info.completeness.values()) if info.completeness else None


def total(infos: Sequence[LogInfo | LogBrief]) -> SetInfo:
    start_ns = min((info.start_ns for info in infos if info.start_ns is not None), default=None)
    end_ns = max((info.end_ns for info in infos if info.end_ns is not None), default=None)
    return SetInfo(
        files=len(infos),
        whole=sum(info.whole for info in infos),
        bytes=sum(info.bytes for info in infos),
        messages=sum(info.messages for info in infos),
        start_ns=start_ns,
        end_ns=end_ns,
        duration_s=_seconds(start_ns, end_ns),
        robots=sorted({robot for info in infos for robot in info.robots}, key=keys.in_order),
    )


def _read(
    stream: BinaryIO,
    size: int,
    path: str,
    progress: Progress,
    *,
    is_written: bool = False,
) -> LogInfo:
    source, contents = LogSourceInfo.SUMMARY, read_contents(stream)
    if contents is None:
        source = LogSourceInfo.RECORDS
        contents = walk_contents(stream, size, progress, is_being_written=is_written)
    else:
        progress(size)
    metadata = dict(contents.metadata)
    ours = metadata.get(METADATA_NAME, {})
    channels = sorted(_channels(contents), key=lambda one: one.topic)
    robots = [name for name in ours.get("robots", "").split(",") if name] or _robots(channels)
    return LogInfo(
        path=path,
        bytes=size,
        whole=contents.has_ended and not contents.faults,
        is_being_written=is_written,
        source=source,
        faults=contents.faults.told,
        fault_count=contents.faults.count,
        messages=sum(contents.counts.values()),
        start_ns=contents.start_ns,
        end_ns=contents.end_ns,
        duration_s=_seconds(contents.start_ns, contents.end_ns),
        robots=robots,
        variants={name: ours[f"{name}.variant"] for name in robots if f"{name}.variant" in ours},
        versions={key: value for key, value in ours.items() if key == "recorder_version" or ".versions." in key},
        channels=channels,
        attachments=[AttachmentInfo(*one) for one in contents.attachments],
        metadata=metadata,
        completeness=_completeness(metadata.get(COMPLETENESS_NAME, {})),
        is_cut=CUT_NAME in metadata,
        incidents=_incidents(contents),
        incident=metadata.get(INCIDENT_NAME, {}),
    )


def _channels(contents: Contents) -> Iterable[ChannelInfo]:
    for channel_id, channel in contents.channels.items():
        messages = contents.counts.get(channel_id, 0)
        first_ns, last_ns = contents.spans.get(channel_id, (None, None))
        span_s = _seconds(first_ns, last_ns)
        schema = contents.schemas.get(channel.schema_id)
        yield ChannelInfo(
            topic=channel.topic,
            schema="" if schema is None else schema.name,
            encoding=channel.message_encoding,
            messages=messages,
            first_ns=first_ns,
            last_ns=last_ns,
            rate_hz=(messages - 1) / span_s if messages > 1 and span_s > 0 else None,
        )


def _incidents(contents: Contents) -> list[dict[str, str]]:
    """Each incident once. One that began before its log names no file at first."""
    found = [entries for name, entries in contents.metadata if name == INCIDENT_NAME]
    found = [one for number, one in enumerate(found) if one not in found[:number]]
    return [one for one in found if one.get("file")] or found


def _robots(channels: Iterable[ChannelInfo]) -> list[str]:
    parts = [keys.parse(channel.topic) for channel in channels if channel.messages]
    return sorted({one.robot for one in parts if one is not None and one.robot}, key=keys.in_order)


def _seconds(start_ns: int | None, end_ns: int | None) -> float:
    return 0.0 if start_ns is None or end_ns is None else (end_ns - start_ns) / 1e9


def _completeness(entries: dict[str, str]) -> dict[str, KeyReport]:
    """The readable accounts by topic."""
    reports = {}
    for topic, text in sorted(entries.items()):
        with suppress(msgspec.MsgspecError):
            reports[topic] = msgspec.json.decode(text, type=KeyReport)
    return reports


def robots_of(logs: Sequence[LogFile], faults: Faults) -> list[RobotKeys]:
    return robots_in(survey(logs, faults).topics.values())


def robots_in(topics: Iterable[Topic]) -> list[RobotKeys]:
    """The robots of these topics, each with its first CAN bus by name."""
    buses: dict[str, set[str]] = {}
    for topic in topics:
        parts = keys.parse(topic.name)
        if parts is not None and parts.robot and RECORDER_CHUNK not in topic.name.split("/"):
            buses.setdefault(f"{parts.root}/{parts.robot}", set()).add(parts.bus)
    return [RobotKeys(key, min(found - {""}, default="")) for key, found in sorted(buses.items())]
