"""What a log holds, and what it lacks: one pass over the file, in memory that does not grow with it."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import msgspec
from google.protobuf.message import DecodeError
from mcap import records

from recorder.completeness import KeyReport
from recorder.incidents import INCIDENT_NAME
from recorder.mcap_summary import MAGIC
from recorder.protobuf_schema import message_class, schema_name
from recorder.review.alive import FRAME_BYTES, AliveCount, feedback_frames
from recorder.review.faults import Faults
from recorder.review.pieces import End, Fault
from recorder.review.walk import LoggedMessage, Walked, walk
from recorder.robots import METADATA_NAME
from recorder.session import COMPLETENESS_NAME
from recorder.tally import Tally
from schemas.exit_codes import CommandError
from schemas.messages import CanFrame, GatewayInfo, RawSample
from schemas.printable import plain
from schemas.recording import GapReason, RecorderEvent, RecordGap
from schemas.subjects import SCHEMA_PREFIX, SUBJECTS

_CAN_FRAME: Final = schema_name(CanFrame)
_WITHOUT_SEQUENCE: Final = {schema_name(kind) for kind in (RawSample, GatewayInfo, RecorderEvent, RecordGap)}
"""A recorder's own words are counted over all its logs, and each log holds those that are about it."""
_CanFrameMessage: Final[Any] = message_class(CanFrame)
_RECORD_GAP: Final = schema_name(RecordGap)
_RecordGapMessage: Final[Any] = message_class(RecordGap)
_GAP_REASONS: Final = [reason.value for reason in GapReason]


class ChannelInfo(msgspec.Struct, frozen=True):
    """A channel.

    Attributes:
        rate_hz: mean over the channel's own span; None for fewer than two messages.
        missed: samples that never came, by the gaps in ``sequence``; None where a gap says nothing.
    """

    topic: str
    schema: str
    encoding: str
    messages: int
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    missed: int | None


class FrameInfo(msgspec.Struct, frozen=True):
    """Raw frames of one identifier; see ``alive.AliveCount``."""

    topic: str
    identifier: str
    name: str
    frames: int
    lost: int
    repeated: int
    corrupt: int
    outages: int
    unseen: int


class AttachmentInfo(msgspec.Struct, frozen=True):
    """An attachment."""

    name: str
    media_type: str
    bytes: int


class GapInfo(msgspec.Struct, frozen=True):
    """Messages of a topic that reached the recorder and are not in the log, for one reason."""

    topic: str
    reason: str
    count: int
    first_ns: int
    last_ns: int


class LogInfo(msgspec.Struct, frozen=True):
    """A log.

    Attributes:
        whole: the file was closed properly and no checksum is wrong.
        faults: what is wrong with the file; ``fault_count`` of them, the first ones told.
        missed: samples missed on all channels; ``frames_lost`` likewise of raw frames,
            by their alive counters and, across outages, by their period.
        robots: the robots' names.
        variants: the firmware variant of each robot that has told it.
        versions: of the recorder, and of each robot's gateway.
        metadata: all metadata records by name, the last of each.
        completeness: the recorder's own account of each topic while it wrote this log; empty if it gives none.
        gaps: what reached the recorder and is not in this log.
        incident: the other file, time and reason, where this is an incident or one was kept of it.
    """

    path: str
    bytes: int
    whole: bool
    faults: list[str]
    fault_count: int
    messages: int
    start_ns: int | None
    end_ns: int | None
    duration_s: float
    missed: int
    frames_lost: int
    robots: list[str]
    variants: dict[str, str]
    versions: dict[str, str]
    channels: list[ChannelInfo]
    frames: list[FrameInfo]
    attachments: list[AttachmentInfo]
    metadata: dict[str, dict[str, str]]
    completeness: dict[str, KeyReport]
    gaps: list[GapInfo]
    incident: dict[str, str]


def read_info(path: Path) -> LogInfo:
    """What a log holds.

    Raises:
        CommandError: there is no such file, or it is no MCAP file.
    """
    survey = _Survey()
    shown = plain(str(path))
    try:
        with path.open("rb") as stream:
            size = path.stat().st_size
            if size == 0:
                raise CommandError(f"{shown} is empty")
            if stream.read(len(MAGIC)) != MAGIC:
                raise CommandError(f"{shown} is no MCAP file")
            for walked in walk(stream, size):
                survey.take(walked)
    except OSError as error:
        raise CommandError(f"cannot read {shown}: {error.strerror or error}") from error
    return survey.sum_up(str(path), size)


_KEPT: Final = frozenset(subject.schema_name for subject in SUBJECTS if subject.qos.kept_bytes)
"""Schemas of samples that a recorder may ask for after they went by."""


class _Channel:
    def __init__(self, record: records.Channel, schema: str) -> None:
        self.topic = record.topic
        self.encoding = record.message_encoding
        self.schema = schema
        self.messages = 0
        self.first_ns = self.last_ns = 0
        self.tally = Tally()
        self.counts_sequence = schema.startswith(f"{SCHEMA_PREFIX}.") and schema not in _WITHOUT_SEQUENCE
        # What a recorder asked for later stands behind what came by itself: only its time tells its place.
        self.asked_later: list[tuple[int, int]] | None = [] if schema in _KEPT else None
        self.frames: dict[int, AliveCount] = {}

    def take(self, message: LoggedMessage) -> None:
        self.first_ns = min(self.first_ns, message.log_ns) if self.messages else message.log_ns
        self.last_ns = max(self.last_ns, message.log_ns)
        self.messages += 1
        if self.asked_later is not None:
            self.asked_later.append((message.publish_ns, message.sequence))
        elif self.counts_sequence:
            # The frames of one batch share its sequence, which to the tally is a step back, and no loss.
            self.tally.count_sequence(message.sequence)
        if self.schema == _CAN_FRAME:
            self._take_frame(message.data)

    def _take_frame(self, data: bytes) -> None:
        frame = _CanFrameMessage.FromString(data)
        known = feedback_frames().get(frame.identifier) if frame.is_extended else None
        if known is None or frame.is_remote or frame.is_error or len(frame.data) != FRAME_BYTES:
            return
        count = self.frames.get(frame.identifier)
        if count is None:
            count = self.frames[frame.identifier] = AliveCount(known)
        count.receive(frame.time_ns, frame.data)

    def sum_up(self) -> ChannelInfo:
        for _, sequence in sorted(self.asked_later or ()):
            self.tally.count_sequence(sequence)
        span_s = (self.last_ns - self.first_ns) / 1e9
        return ChannelInfo(
            topic=self.topic,
            schema=self.schema,
            encoding=self.encoding,
            messages=self.messages,
            first_ns=self.first_ns if self.messages else None,
            last_ns=self.last_ns if self.messages else None,
            rate_hz=(self.messages - 1) / span_s if self.messages > 1 and span_s > 0 else None,
            missed=self.tally.missed if self.counts_sequence else None,
        )

    def sum_up_frames(self) -> list[FrameInfo]:
        return [
            FrameInfo(
                topic=self.topic,
                identifier=f"0x{identifier:08X}",
                name=count.name,
                frames=count.frames,
                lost=count.lost,
                repeated=count.repeated,
                corrupt=count.corrupt,
                outages=count.outages,
                unseen=count.unseen,
            )
            for identifier, count in sorted(self.frames.items())
        ]


class _Survey:
    """Gathers what a walk brings."""

    def __init__(self) -> None:
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, _Channel] = {}
        self._attachments: list[AttachmentInfo] = []
        self._metadata: dict[str, dict[str, str]] = {}
        self._faults = Faults()
        self._messages = 0
        self._promised: int | None = None
        self._ended = False
        self._gaps: dict[tuple[str, str], GapInfo] = {}

    def take(self, walked: Walked) -> None:
        match walked:
            case LoggedMessage():
                self._take_message(walked)
            case records.Schema():
                self._schemas[walked.id] = walked.name
            case records.Channel():
                # The summary repeats them.
                schema = self._schemas.get(walked.schema_id, "")
                self._channels.setdefault(walked.id, _Channel(walked, schema))
            case records.Attachment():
                info = AttachmentInfo(walked.name, walked.media_type, len(walked.data))
                self._attachments.append(info)
            case records.Metadata():
                self._metadata[walked.name] = walked.metadata
            case records.Statistics():
                self._promised = walked.message_count
            case End():
                self._ended = True
            case Fault():
                self._faults.add(f"byte {walked.offset}: {walked.detail}")

    def _take_message(self, message: LoggedMessage) -> None:
        channel = self._channels.get(message.channel_id)
        self._messages += 1
        if channel is None:
            self._faults.add(f"a message of channel {message.channel_id}, which the file does not hold")
            return
        try:
            channel.take(message)
            if channel.schema == _RECORD_GAP:
                self._take_gap(message.data)
        except DecodeError:
            self._faults.add(f"a message of {channel.topic} that cannot be read")

    def _take_gap(self, data: bytes) -> None:
        gap = _RecordGapMessage.FromString(data)
        reason = _GAP_REASONS[gap.reason] if gap.reason < len(_GAP_REASONS) else str(gap.reason)
        before = self._gaps.get((gap.key, reason), GapInfo(gap.key, reason, 0, gap.first_ns, gap.last_ns))
        self._gaps[gap.key, reason] = GapInfo(
            gap.key,
            reason,
            before.count + gap.count,
            min(before.first_ns, gap.first_ns),
            max(before.last_ns, gap.last_ns),
        )

    def sum_up(self, path: str, size: int) -> LogInfo:
        if self._promised is not None and self._promised != self._messages:
            self._faults.add(f"the file says that it holds {self._promised} messages; {self._messages} were read")
        channels = sorted((channel.sum_up() for channel in self._channels.values()), key=lambda one: one.topic)
        frames = [frame for channel in self._channels.values() for frame in channel.sum_up_frames()]
        starts = [channel.first_ns for channel in channels if channel.first_ns is not None]
        ends = [channel.last_ns for channel in channels if channel.last_ns is not None]
        ours = self._metadata.get(METADATA_NAME, {})
        robots = [name for name in ours.get("robots", "").split(",") if name]
        return LogInfo(
            path=path,
            bytes=size,
            whole=self._ended and not self._faults,
            faults=self._faults.told,
            fault_count=self._faults.count,
            messages=self._messages,
            start_ns=min(starts, default=None),
            end_ns=max(ends, default=None),
            duration_s=(max(ends) - min(starts)) / 1e9 if starts else 0.0,
            missed=sum(channel.missed or 0 for channel in channels),
            frames_lost=sum(frame.lost + frame.unseen for frame in frames),
            robots=robots,
            variants={name: ours[f"{name}.variant"] for name in robots if f"{name}.variant" in ours},
            versions={
                key: value for key, value in ours.items() if key == "recorder_version" or ".versions." in key
            },
            channels=channels,
            frames=frames,
            attachments=self._attachments,
            metadata=self._metadata,
            completeness=_completeness(self._metadata.get(COMPLETENESS_NAME, {})),
            gaps=[gap for _, gap in sorted(self._gaps.items())],
            incident=self._metadata.get(INCIDENT_NAME, {}),
        )


def _completeness(entries: dict[str, str]) -> dict[str, KeyReport]:
    """The account of each topic; what is no such account is left out."""
    reports = {}
    for topic, text in sorted(entries.items()):
        with suppress(msgspec.MsgspecError):
            reports[topic] = msgspec.json.decode(text, type=KeyReport)
    return reports
