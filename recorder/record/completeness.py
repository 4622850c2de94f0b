"""What of a key was sent, received and written, and where the rest was lost; what of that a file tells. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import msgspec

from recorder.encoding.key_counters import Tally
from schemas.recording import GapReason


class KeyReport(msgspec.Struct, frozen=True):
    """The way of one key, from its source into the log.

    Samples are counted up to the recorder's queue, messages of the log from there on: a batch of raw frames is one
    sample and many messages.

    Attributes:
        sent: samples that the source sent, by their sequence; None where that says nothing.
        received: samples that reached the recorder.
        written: messages in the log.
        lost_bus: frames lost between chassis and gateway, by their alive counters, as its health tells; None where
            it does not.
        lost_source: raw frames that the gateway dropped.
        lost_link: samples that never reached the recorder.
        lost_queue: samples that it dropped unread, as too many waited.
        lost_size: samples that are larger than it may record.
        lost_full: messages that came while the disk could hold no more.
        lost_disk: messages that the disk did not take.
    """

    sent: int | None = None
    received: int = 0
    written: int = 0
    lost_bus: int | None = None
    lost_source: int = 0
    lost_link: int = 0
    lost_queue: int = 0
    lost_size: int = 0
    lost_full: int = 0
    lost_disk: int = 0

    @property
    def lost(self) -> int:
        """Everything that was lost after the source, samples and messages alike."""
        return self.lost_link + self.lost_queue + self.lost_size + self.lost_full + self.lost_disk


def report(tally: Tally, *, counts_sequence: bool) -> KeyReport:
    """What a tally says of its key."""
    lost = tally.lost
    received = tally.samples + tally.unread
    return KeyReport(
        sent=received + tally.missed if counts_sequence else None,
        received=received,
        written=max(0, tally.messages - tally.unwritten),
        lost_bus=tally.lost_bus,
        lost_source=tally.dropped,
        lost_link=tally.missed,
        lost_queue=lost.get(GapReason.QUEUE, 0),
        lost_size=lost.get(GapReason.SIZE, 0),
        lost_full=lost.get(GapReason.FULL, 0),
        lost_disk=lost.get(GapReason.DISK, 0),
    )


def since(now: KeyReport, before: KeyReport) -> KeyReport:
    """What has come between two reports. What one file missed may have come in the next: never below 0."""
    first = msgspec.structs.asdict(before)
    change: dict[str, Any] = {
        name: None if value is None else max(0, value - (first[name] or 0))
        for name, value in msgspec.structs.asdict(now).items()
    }
    return KeyReport(**change)


NEVER_MEANWHILE: Final = {"written": 0, "lost_disk": 0}
"""What comes while nothing is written is neither; what the disk then fails to take was written before."""

NONE: Final = KeyReport()


class Account:
    """From where the next file counts: its completeness is told since the end of the file before."""

    def __init__(self) -> None:
        self._counted: dict[str, KeyReport] = {}
        self._left_off: dict[str, KeyReport] | None = None

    def of_file(self, counts: Mapping[str, KeyReport]) -> dict[str, KeyReport]:
        """What the file that ends tells of each topic; the next one counts from here."""
        told = {topic: since(count, self._counted.get(topic, NONE)) for topic, count in counts.items()}
        self._counted = dict(counts)
        return told

    def leave_off(self, counts: Mapping[str, KeyReport]) -> None:
        """What comes from here on is no file's business: nobody wants it."""
        if self._left_off is None:
            self._left_off = dict(counts)

    def take_up(self, counts: Mapping[str, KeyReport]) -> None:
        """What comes from here on is. What came before ``leave_off`` still is, too."""
        before, self._left_off = self._left_off, None
        if before is None:
            return
        for topic, count in counts.items():
            meanwhile = msgspec.structs.replace(since(count, before.get(topic, NONE)), **NEVER_MEANWHILE)
            self._counted[topic] = total([self._counted.get(topic, NONE), meanwhile])


def total(reports: Iterable[KeyReport]) -> KeyReport:
    """Of a topic that several logs have; None where none of them tells."""
    sums: dict[str, Any] = {}
    for one in reports:
        for name, value in msgspec.structs.asdict(one).items():
            before = sums.get(name)
            sums[name] = value if before is None else before + (value or 0)
    return KeyReport(**sums)
