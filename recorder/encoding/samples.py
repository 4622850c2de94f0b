"""Received samples, untrusted; the counters of a key; and events as ``foxglove.Log``. Pure.

Viewers show events on ``{key}/log`` as log lines. The schema is Foxglove's in protobuf
(https://docs.foxglove.dev/docs/visualization/message-schemas/log): fields and numbers as published there.
"""

from __future__ import annotations

from typing import Any, Final, Protocol

import msgspec
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from schemas.command_line import short
from schemas.decisions import SafetyEvent, Severity
from schemas.recording import GapReason, RecorderEvent


class ReceivedSample(Protocol):
    """A sample, or a reply to a query. Key, encoding and payload are cheap to read, the rest may cost time."""

    @property
    def key(self) -> str:
        """The key."""

    @property
    def encoding(self) -> str:
        """Zenoh's encoding string, schema included."""

    @property
    def payload(self) -> bytes:
        """The payload."""

    @property
    def received_ns(self) -> int:
        """The time of receipt, nanoseconds since 1970."""

    @property
    def is_reply(self) -> bool:
        """True of a reply to a query of ours."""

    @property
    def attachment(self) -> bytes:
        """The attachment; empty if there is none."""

    @property
    def zenoh_time_ns(self) -> int:
        """The sample's Zenoh timestamp since 1970; 0 if it has none."""

    @property
    def source(self) -> tuple[str, int] | None:
        """The publisher's identifier and its sequence number on the key; None if there is none."""

    @property
    def deleted(self) -> bool:
        """True if the sample deletes the key, and carries nothing else."""


class WaitingSample(msgspec.Struct, frozen=True, gc=False):
    """A copy of a sample for a queue: Zenoh's sample would hold its whole receive buffer of 64 KiB."""

    key: str
    encoding: str
    payload: bytes
    attachment: bytes
    zenoh_time_ns: int
    source: tuple[str, int] | None
    deleted: bool
    received_ns: int
    is_reply: bool


def copy(sample: ReceivedSample) -> WaitingSample:
    return WaitingSample(
        sample.key,
        sample.encoding,
        sample.payload,
        sample.attachment,
        sample.zenoh_time_ns,
        sample.source,
        sample.deleted,
        sample.received_ns,
        sample.is_reply,
    )


SEQUENCE_SPAN: Final = 2**32  # sequences wrap here

UNREAD: Final = frozenset({GapReason.QUEUE, GapReason.SIZE})
"""Reasons for the loss of samples that were never decoded: their sequence is not known."""

SOURCES_MAX: Final = 16  # sources followed per key; the least recent beyond it are forgotten

RESTART_STEP: Final = 2**24
"""A larger step forward (two days at 100 Hz) means that the sender restarted, or a sample was late."""


class KeyCounters:
    """Counts the samples of one key.

    Attributes:
        unwritten: messages that are in no log, for any reason.
        missed: samples that never arrived, by the gaps in ``sequence``, without those dropped unread.
        dropped: raw frames that the source dropped, by its own count.
        lost: messages that reached the recorder and are not in the log, by reason.
        lost_bus: frames of the chassis that never reached the gateway, by its count; None if it reports none.
    """

    def __init__(self) -> None:
        self.samples = 0
        self.messages = 0
        self.unwritten = 0
        self.missed = 0
        self.dropped = 0
        self.lost: dict[GapReason, int] = {}
        self.lost_bus: int | None = None
        self._bus_count: int | None = None
        # By source, the most recent one last.
        self._sources: dict[str, int | None] = {}
        self.next: int | None = None  # the next expected sequence; None before the first sample
        self._unread = 0  # samples dropped unread while ``next`` was ``_unread_at``
        self._unread_at: int | None = None

    @property
    def unread(self) -> int:
        """Samples that were dropped before they were decoded."""
        return sum(count for reason, count in self.lost.items() if reason in UNREAD)

    def lose(self, reason: GapReason, count: int) -> None:
        """Count samples or messages that reached the recorder and are not in the log."""
        self.lost[reason] = self.lost.get(reason, 0) + count
        if reason in UNREAD:
            self._unread = count + (self._unread if self._unread_at == self.next else 0)
            self._unread_at = self.next

    def find(self) -> None:
        """Count a missed sample that has arrived after all."""
        self.missed = max(0, self.missed - 1)

    def count_bus(self, lost: int) -> None:
        """Take the gateway's count of frames lost on the bus since its start; the first one is the baseline."""
        before, self._bus_count = self._bus_count, lost
        # A count that falls shows a restarted gateway.
        new = 0 if before is None else lost - before if lost >= before else lost
        self.lost_bus = (self.lost_bus or 0) + new

    def count_sequence(self, sequence: int) -> bool:
        """Count a sample by its sequence. False if it steps back: the source has restarted."""
        expected, self.next = self.next, (sequence + 1) % SEQUENCE_SPAN
        if expected is None or sequence == expected:
            return True
        step = (sequence - expected) % SEQUENCE_SPAN
        if step >= RESTART_STEP:
            return False
        # Samples dropped unread since the previous sample left a gap, too.
        self.missed += max(0, step - self._unread) if self._unread_at == expected else step
        return True

    def count_source(self, source: str, sequence: int) -> None:
        """Count a sample by Zenoh's sequence: each source of a key has its own."""
        self.next = self._sources.pop(source, None)
        self.count_sequence(sequence % SEQUENCE_SPAN)
        self._sources[source] = self.next
        if len(self._sources) > SOURCES_MAX:
            del self._sources[next(iter(self._sources))]


SCHEMA_NAME: Final = "foxglove.Log"

LEVELS: Final = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")

_LEVEL_OF: Final = {
    Severity.INFO: LEVELS.index("INFO"),
    Severity.WARNING: LEVELS.index("WARNING"),
    Severity.ERROR: LEVELS.index("ERROR"),
}

_TIMESTAMP: Final = FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)


def _file() -> FileDescriptorProto:
    file = FileDescriptorProto(
        name="foxglove/Log.proto", package="foxglove", syntax="proto3", dependency=[_TIMESTAMP.name]
    )
    message = file.message_type.add(name="Log")
    level = message.enum_type.add(name="Level")
    for number, name in enumerate(LEVELS):
        level.value.add(name=name, number=number)
    kind = FieldDescriptorProto
    for number, (name, field_type, type_name) in enumerate(
        (
            ("timestamp", kind.TYPE_MESSAGE, ".google.protobuf.Timestamp"),
            ("level", kind.TYPE_ENUM, ".foxglove.Log.Level"),
            ("message", kind.TYPE_STRING, ""),
            ("name", kind.TYPE_STRING, ""),
            ("file", kind.TYPE_STRING, ""),
            ("line", kind.TYPE_FIXED32, ""),
        ),
        start=1,
    ):
        field = message.field.add(name=name, number=number, label=kind.LABEL_OPTIONAL, type=field_type)
        if type_name:
            field.type_name = type_name
    return file


_FILES: Final = (_TIMESTAMP, _file())

SCHEMA_DATA: Final = FileDescriptorSet(file=_FILES).SerializeToString(deterministic=True)


def _message_class() -> Any:  # noqa: ANN401 - protobuf makes the class at run time
    pool = DescriptorPool()
    for file in _FILES:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(SCHEMA_NAME))


_Log: Final = _message_class()


def log_record(event: SafetyEvent | RecorderEvent, name: str) -> bytes:
    """An event as a log line of limited length; ``name`` is the sender."""
    operator = f" ({short(event.operator)})" if event.operator else ""
    text = f"{event.kind.value}: {short(event.text)}{operator}"
    line = _Log(level=_LEVEL_OF.get(event.severity, LEVELS.index("UNKNOWN")), message=text, name=name)
    line.timestamp.seconds, line.timestamp.nanos = divmod(event.time_ns, 1_000_000_000)
    data: bytes = line.SerializeToString()
    return data
