"""The route of a sample into its channel: how it becomes records, with a fast path for nearly every sample. Pure.

The fast path of a key is one function, compiled for its subject: it decodes the payload, checks that the sequence
continues, and appends header and fields of the record in one packing. In any other case (a gap, a broken payload,
a full chunk) it returns False and changes nothing, and the log takes the slow path.

Raw frames have a fast path by columns, for the common batch of classic data frames. Their records differ in a few
bytes only: one record is repeated for all frames, and each column of bytes is written over it at once, which costs
a tenth of one packing a frame.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any, Final, cast

import msgspec

from recorder.encoding.protobuf import Encoder, Packed, compile_encoder, compile_row_encoder, packed_fields
from recorder.encoding.samples import SEQUENCE_SPAN, KeyCounters, ReceivedSample
from recorder.mcap.writer import ChunkBuilder, head_source, message_record
from schemas.can_word import BITRATE_SWITCH, ERROR, ERROR_STATE_INDICATOR, EXTENDED, FD, IDENTIFIER_MASK, REMOTE
from schemas.codec import PayloadFault, Understood, count_fields, decode, encoding_fault, understand
from schemas.decisions import SafetyEvent, SignedStatement
from schemas.messages import CanFrame, CanFrames, GatewayHealth, GatewayInfo, Message, RawSample
from schemas.subjects import ALL_SUBJECTS, Pattern, Subject

Adder = Callable[[bytes, int], bool]
"""Takes payload and log time of a sample; returns whether it was added. An undecodable payload raises."""


FastPath = tuple[str, Adder]  # the required encoding, and the function


class Latest:
    """The newest message of a key."""

    __slots__ = ("log_ns", "message")

    def __init__(self) -> None:
        self.log_ns = 0
        self.message: Message | None = None


Make = Callable[[KeyCounters, ChunkBuilder, int, Latest], Adder]


def compile_adder(
    kind: type[Message], counters: KeyCounters, chunk: ChunkBuilder, channel_id: int, latest: Latest
) -> Adder:
    return _make(kind)(counters, chunk, channel_id, latest)


@cache
def _make(kind: type[Message]) -> Make:
    """Compile the function.

    For a class with a number and a text besides time and sequence::

        def add(payload, log_ns):
            message = decode(payload)
            sequence = message.sequence
            records = chunk.records
            offset = len(records)
            if sequence != counters.next or offset >= limit_bytes:
                return False
            time_ns = message.time_ns
            tail = part_4(message.text)
            head = pack(5, 22 + 23 + len(tail), channel_id, sequence, log_ns, time_ns, 9, time_ns, 21, ...)
            records += head
            records += tail
            index = chunk.index[channel_id]
            index.append(log_ns)
            index.append(offset)
            counters.next = sequence + 1
            ...
            return True
    """
    packed: Packed = packed_fields(kind, {"time_ns": "time_ns", "sequence": "sequence"}, "message.")
    tail = " + ".join(packed.parts)
    length = str(packed.struct("").size) + (" + len(tail)" if tail else "")
    head_format, head = head_source(length)
    pack = packed.struct(head_format)
    arguments = ", ".join(["channel_id", "sequence", "log_ns", "time_ns", *packed.arguments])
    source = f"""
def make(counters, chunk, channel_id, latest):
    limit_bytes = chunk.limit_bytes
    def add(payload, log_ns):
        message = decode(payload)
        sequence = message.sequence
        records = chunk.records
        offset = len(records)
        if sequence != counters.next or offset >= limit_bytes:
            return False
        time_ns = message.time_ns
        {f"tail = {tail}" if tail else ""}
        head = pack({head}, {arguments})
        records += head
        {"records += tail" if tail else ""}
        index = chunk.index[channel_id]
        index.append(log_ns)
        index.append(offset)
        counters.next = sequence + 1
        counters.samples += 1
        counters.messages += 1
        latest.message = message
        latest.log_ns = log_ns
        return True
    return add
"""
    names: dict[str, Any] = {**packed.names, "pack": pack.pack, "decode": msgspec.msgpack.Decoder(kind).decode}
    # As in dataclasses and namedtuple: the source holds our own field names and nothing from outside.
    exec(source, names)  # noqa: S102
    return cast("Make", names["make"])


DATA_BYTES: Final = 8  # length of the frames on this path
FRAMES_MAX: Final = 10_000  # of a batch: more than a saturated bus carries in a second; a batch comes every 50 ms
TEMPLATES_MAX: Final = 4096  # two for each bus name; names are untrusted

# Unlikely values, to find the places of the columns.
_TIME_MARK: Final = 0x1122334455667788
_IDENTIFIER_MARK: Final = 0x0ABBCCDD
_DATA_MARK: Final = b"\xa1\xa2\xa3\xa4\xa5\xa6\xa7\xa8"

_ENCODE_ROW: Final[Callable[..., bytes]] = compile_row_encoder(CanFrame)
_DECODE: Final = msgspec.msgpack.Decoder(CanFrames).decode


class _Template(msgspec.Struct, frozen=True):
    """The data of a message with marks, and the marks' offsets in its record."""

    data: bytes
    size: int
    publish_at: int
    time_at: int
    identifier_at: int
    data_at: int


@lru_cache(TEMPLATES_MAX)
def _template(bus: str, *, is_extended: bool) -> _Template:
    flags = (is_extended, False, False, False, False, False)
    body = _ENCODE_ROW(_TIME_MARK, bus, _IDENTIFIER_MARK, *flags, DATA_BYTES, _DATA_MARK)
    time_mark = struct.pack("<Q", _TIME_MARK)
    record = message_record(0, 0, 0, _TIME_MARK, body)
    start = len(record) - len(body)
    return _Template(
        data=body,
        size=len(record),
        publish_at=record.index(time_mark),
        time_at=record.index(time_mark, start),
        identifier_at=record.index(struct.pack("<I", _IDENTIFIER_MARK), start),
        # The bus's name, which may be anything, stands before it.
        data_at=record.rindex(_DATA_MARK),
    )


def can_adder(counters: KeyCounters, chunk: ChunkBuilder, channel_id: int) -> Adder:
    """The fast path of one key of raw frames."""
    limit_bytes = chunk.limit_bytes

    def add(payload: bytes, log_ns: int) -> bool:
        batch = _DECODE(payload)
        if batch.sequence != counters.next or chunk.is_full or not is_common(batch):
            return False
        count = len(batch.can_id)
        if count:
            template = _template(batch.bus, is_extended=batch.can_id[0] & EXTENDED != 0)
            # The slow path splits a batch larger than a chunk.
            if count > FRAMES_MAX or count * template.size > limit_bytes:
                return False
            _write(batch, template, log_ns, chunk, channel_id)
        counters.next = (batch.sequence + 1) % SEQUENCE_SPAN
        counters.dropped = max(counters.dropped, batch.dropped)
        counters.samples += 1
        counters.messages += count
        return True

    return add


def is_common(batch: CanFrames) -> bool:
    """True if all frames are classic data frames of eight bytes, with identifiers of one length."""
    words = batch.can_id
    count = len(words)
    if not (
        count
        == len(batch.frame_time_ns)
        == len(batch.data)
        == batch.fd_flags.count(0)
        == len(batch.fd_flags)
        == batch.length.count(DATA_BYTES)
        == len(batch.length)
    ):
        return False
    if not count:
        return True
    # The highest bits are the flags: if the lowest and the highest word have the same, all have.
    flags = min(words) & ~IDENTIFIER_MASK
    return (
        flags == max(words) & ~IDENTIFIER_MASK
        and not flags & (REMOTE | ERROR)
        and set(map(len, batch.data)) == {DATA_BYTES}
    )


def _write(batch: CanFrames, template: _Template, log_ns: int, chunk: ChunkBuilder, channel_id: int) -> None:
    count, size = len(batch.can_id), template.size
    one = message_record(channel_id, batch.sequence, log_ns, 0, template.data)
    records: Any = bytearray(one) * count
    times = struct.pack(f"<{count}Q", *batch.frame_time_ns)
    for byte in range(8):
        column = times[byte::8]
        records[template.publish_at + byte :: size] = column
        records[template.time_at + byte :: size] = column
    words = struct.pack(f"<{count}I", *[word & IDENTIFIER_MASK for word in batch.can_id])
    for byte in range(4):
        records[template.identifier_at + byte :: size] = words[byte::4]
    data = b"".join(batch.data)
    for byte in range(DATA_BYTES):
        records[template.data_at + byte :: size] = data[byte::DATA_BYTES]
    start = len(chunk.records)
    chunk.records += records
    places = array("Q", [log_ns]) * (2 * count)
    places[1::2] = array("Q", range(start, start + count * size, size))
    chunk.index[channel_id].extend(places)


FRAMES_MAX_BYTES: Final = 1_000_000  # a larger batch is not decoded: FRAMES_MAX of the longest frames take less

Record = tuple[int, bytes]  # publish time in nanoseconds, and protobuf bytes

Transcoder = Callable[[Any], Sequence[Record]]
"""A message to its records: one, or one per frame of a batch of raw frames."""


class Route:
    """From a key to its channel.

    Attributes:
        subject: the key's row in the subject table; None if it has none.
        robot: the key's robot, as ``Robots`` names it; empty if the key is unknown.
        encoding: the Zenoh encoding required to decode a sample.
        counts_sequence: whether a gap in ``sequence`` is a loss.
        is_state: only its newest sample matters; ``latest`` is that one.
        is_kept: the gateway stores its recent samples; see ``recorder.record.robots``.
        is_watched: the log also evaluates its messages.
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
        """The fast path into a chunk, if there is one; after the first sample."""
        if self.subject is None or self.counters.next is None:
            return None
        if self.subject.type is CanFrames:
            return can_adder(self.counters, chunk, self.channel_id)
        if not self.is_state or self.is_watched:
            return None
        return compile_adder(self.subject.type, self.counters, chunk, self.channel_id, self.latest)

    def decode(self, sample: ReceivedSample) -> Message | str:
        """The sample's message, or why it is recorded as it is."""
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
        """Decode a sample of a newer version as far as possible; None if it is not at all."""
        if self.subject is None or self.kind is CanFrame or sample.encoding != self.encoding:
            return None
        read = understand(self.subject.type, sample.payload)
        return None if isinstance(read, PayloadFault) else read

    def has_unknown_fields(self, sample: ReceivedSample) -> bool:
        """Report whether a decoded sample has unknown fields."""
        return self.subject is not None and count_fields(sample.payload) > self.field_count


_WATCHED: Final = frozenset({CanFrames, GatewayInfo, GatewayHealth, SafetyEvent, SignedStatement})


def _fault_of(batch: CanFrames) -> str:
    """Describe the fault of a batch; empty if there is none."""
    count = len(batch.frame_time_ns)
    if not count == len(batch.can_id) == len(batch.fd_flags) == len(batch.length) == len(batch.data):
        return "the columns differ in length"
    return f"more than {FRAMES_MAX} frames in a batch" if count > FRAMES_MAX else ""


def unfold(batch: CanFrames) -> list[Record]:
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
