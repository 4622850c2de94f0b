"""Received samples, untrusted, and the counters of a key. Pure."""

from __future__ import annotations

from typing import Final, Protocol

import msgspec

from schemas.recording import GapReason


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
