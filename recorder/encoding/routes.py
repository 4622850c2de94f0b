"""The route of a key's samples: their channel, and how they become records. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import msgspec

from recorder.encoding.can_columns import FRAMES_MAX, can_adder
from recorder.encoding.fast_path import Adder, Latest, compile_adder
from recorder.encoding.key_counters import KeyCounters
from recorder.encoding.received_sample import ReceivedSample
from recorder.encoding.transcode import Encoder, compile_encoder, compile_row_encoder
from recorder.mcap.chunk import ChunkBuilder
from schemas.can_word import (
    BITRATE_SWITCH,
    ERROR,
    ERROR_STATE_INDICATOR,
    EXTENDED,
    FD,
    IDENTIFIER_MASK,
    REMOTE,
)
from schemas.codec import PayloadFault, Understood, count_fields, decode, encoding_fault, understand
from schemas.decisions import SafetyEvent, SignedStatement
from schemas.messages import CanFrame, CanFrames, GatewayHealth, GatewayInfo, Message, RawSample
from schemas.subjects import ALL_SUBJECTS, Pattern, Subject

RAW_CHUNK: Final = "@raw"
"""A broken sample of a known key goes to ``{key}/@raw``: viewers want one schema per topic."""

FRAMES_MAX_BYTES: Final = 1_000_000
"""FRAMES_MAX of the longest frames take less: a larger batch is not even decoded."""

Record = tuple[int, bytes]
"""Publish time in nanoseconds, and protobuf bytes."""

Transcoder = Callable[[Any], Sequence[Record]]
"""A message to its records: one each, but one per frame of a batch of raw frames."""


class Route:
    """From a key to its channel.

    Attributes:
        subject: the key's row in the subject table; None if it has none.
        robot: the key's robot, as ``Robots`` calls it; empty if the key is not known.
        encoding: the Zenoh encoding that a sample must have to be decoded.
        counts_sequence: whether a gap in ``sequence`` is a loss: replies to others' queries are none.
        is_state: its newest sample tells all; ``latest`` is that one.
        is_kept: the gateway keeps its samples for a while; see ``recorder.record.backlog``.
        is_watched: the session looks into its messages, besides recording them.
        field_count: fields of a message.
        kind: the class of the channel's records.
        transcode: from a decoded message to its records.
    """

    __slots__ = (
        "channel_id",
        "counters",
        "counts_sequence",
        "encoding",
        "field_count",
        "is_kept",
        "is_state",
        "is_watched",
        "kind",
        "latest",
        "robot",
        "subject",
        "transcode",
    )

    def __init__(self, channel_id: int, subject: Subject | None, robot: str) -> None:
        self.channel_id = channel_id
        self.subject = subject
        self.robot = robot
        self.counters = KeyCounters()
        self.encoding = ""
        self.counts_sequence = subject is not None and subject.pattern is Pattern.PUBLISHED
        self.is_kept = subject is not None and subject.qos.kept_bytes > 0
        self.is_state = (
            subject is not None and self.counts_sequence and not self.is_kept and subject.type is not CanFrames
        )
        self.is_watched = subject is not None and subject.type in _WATCHED
        self.latest = Latest()
        self.field_count = 0
        self.kind: type[msgspec.Struct] = RawSample
        self.transcode: Transcoder = _one_record(_ENCODE_RAW)
        if subject is not None:
            self.encoding = subject.encoding
            self.field_count = len(subject.type.__struct_fields__)
            self.kind = CanFrame if subject.type is CanFrames else subject.type
            self.transcode = _TRANSCODERS[subject.type]

    def adder(self, chunk: ChunkBuilder) -> Adder | None:
        """The fast path into a chunk, if there is one: see ``fast_path``. After the first sample."""
        if self.subject is None or self.counters.next is None:
            return None
        if self.subject.type is CanFrames:
            return can_adder(self.counters, chunk, self.channel_id)
        if not self.is_state or self.is_watched:
            return None
        return compile_adder(self.subject.type, self.counters, chunk, self.channel_id, self.latest)

    def decode(self, sample: ReceivedSample) -> Message | str:
        """The sample's message, or why it is kept as it is."""
        if self.subject is None:
            return "deleted" if sample.deleted else "the key is no known subject"
        if sample.encoding != self.encoding:
            if sample.deleted:
                return "deleted"
            return encoding_fault(sample.encoding, self.encoding, "the recorder", "the sender")
        if self.kind is CanFrame and len(sample.payload) > FRAMES_MAX_BYTES:
            return f"a batch of frames is larger than {FRAMES_MAX_BYTES} bytes"
        message = decode(self.subject, sample.payload)
        if isinstance(message, PayloadFault):
            return message.detail
        if isinstance(message, CanFrames):
            return _fault_of(message) or message
        return message

    def understand(self, sample: ReceivedSample) -> Understood[Message] | None:
        """Return a sample of a newer version as far as it is understood; None if it is not at all."""
        if self.subject is None or self.kind is CanFrame or sample.encoding != self.encoding:
            return None
        read = understand(self.subject.type, sample.payload)
        return None if isinstance(read, PayloadFault) else read

    def has_unknown_fields(self, sample: ReceivedSample) -> bool:
        """Report whether a sample that was decoded has fields that its class does not have."""
        return self.subject is not None and count_fields(sample.payload) > self.field_count


_WATCHED: Final = frozenset({CanFrames, GatewayInfo, GatewayHealth, SafetyEvent, SignedStatement})


def _fault_of(batch: CanFrames) -> str:
    """Describe the fault of a batch; empty if there is none."""
    count = len(batch.frame_time_ns)
    if not count == len(batch.can_id) == len(batch.fd_flags) == len(batch.length) == len(batch.data):
        return "the columns differ in length"
    return f"more than {FRAMES_MAX} frames in a batch" if count > FRAMES_MAX else ""


def unfold(batch: CanFrames) -> list[Record]:
    """One CanFrame record for each frame of a batch."""
    bus = batch.bus
    columns = (batch.frame_time_ns, batch.can_id, batch.fd_flags, batch.length, batch.data)
    return [
        (
            time_ns,
            _ENCODE_CAN_FRAME(
                time_ns,
                bus,
                word & IDENTIFIER_MASK,
                word & EXTENDED != 0,
                word & REMOTE != 0,
                word & ERROR != 0,
                fd_flags & FD != 0,
                fd_flags & BITRATE_SWITCH != 0,
                fd_flags & ERROR_STATE_INDICATOR != 0,
                length,
                data,
            ),
        )
        for time_ns, word, fd_flags, length, data in zip(*columns, strict=True)
    ]


def keep_raw(sample: ReceivedSample, reason: str, time_ns: int) -> bytes:
    """The RawSample record of a sample that is not decoded."""
    raw = RawSample(
        time_ns=time_ns,
        key=sample.key,
        encoding=sample.encoding,
        payload=sample.payload,
        attachment=sample.attachment,
        reason=reason,
    )
    return _ENCODE_RAW(raw)


def _one_record(encode: Encoder) -> Transcoder:
    return lambda message: ((message.time_ns, encode(message)),)


_ENCODE_RAW: Final = compile_encoder(RawSample)
_ENCODE_CAN_FRAME: Final[Callable[..., bytes]] = compile_row_encoder(CanFrame)
_TRANSCODERS: Final[dict[type[Message], Transcoder]] = {
    subject.type: unfold if subject.type is CanFrames else _one_record(compile_encoder(subject.type))
    for subject in ALL_SUBJECTS
}
