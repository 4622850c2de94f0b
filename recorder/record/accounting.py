"""Loss accounting: what of a key was sent, received and written, and where the rest was lost. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import msgspec

from recorder.encoding.key_counters import KeyCounters
from recorder.mcap.chunk import log_time
from schemas.keys import KEY_MAX_LENGTH
from schemas.recording import GapReason, RecordGap

COMPLETENESS_NAME: Final = "cruiser.completeness"
"""The metadata record with a ``KeyReport`` of each topic, as JSON: what was received and lost during this file."""

OTHER_KEYS: Final = "**"
"""The key of a gap that stands for keys beyond the limit, and for keys that are too long to be remembered."""


class KeyReport(msgspec.Struct, frozen=True):
    """The way of one key, from its source into the log.

    Samples are counted up to the recorder's queue, messages of the log from there on: a batch of raw frames is one
    sample and many messages.

    Attributes:
        sent: samples that the source sent, by their sequence; None where the sequence says nothing.
        received: samples that reached the recorder.
        written: messages in the log.
        lost_bus: frames lost between chassis and gateway, by their alive counters; None where the gateway's health
            does not report them.
        lost_source: raw frames that the gateway dropped.
        lost_link: samples that never reached the recorder.
        lost_queue: samples that the recorder dropped unread, as too many waited.
        lost_size: samples that are larger than the recorder may record.
        lost_full: messages that came while the disk could hold no more.
        lost_disk: messages that the disk did not take or keep.
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


NO_REPORT: Final = KeyReport()


def report(counters: KeyCounters, *, counts_sequence: bool) -> KeyReport:
    """Report the counters of a key."""
    lost = counters.lost
    received = counters.samples + counters.unread
    return KeyReport(
        sent=received + counters.missed if counts_sequence else None,
        received=received,
        written=max(0, counters.messages - counters.unwritten),
        lost_bus=counters.lost_bus,
        lost_source=counters.dropped,
        lost_link=counters.missed,
        lost_queue=lost.get(GapReason.QUEUE, 0),
        lost_size=lost.get(GapReason.SIZE, 0),
        lost_full=lost.get(GapReason.FULL, 0),
        lost_disk=lost.get(GapReason.DISK, 0),
    )


def since(now: KeyReport, before: KeyReport) -> KeyReport:
    """Subtract an earlier report. Never below 0: what one file missed may have come in the next."""
    first = msgspec.structs.asdict(before)
    change: dict[str, Any] = {
        name: None if value is None else max(0, value - (first[name] or 0))
        for name, value in msgspec.structs.asdict(now).items()
    }
    return KeyReport(**change)


def total(reports: Iterable[KeyReport]) -> KeyReport:
    """Add the reports of one topic in several logs; None where none of them counts."""
    sums: dict[str, Any] = {}
    for one in reports:
        for name, value in msgspec.structs.asdict(one).items():
            before = sums.get(name)
            sums[name] = value if before is None else before + (value or 0)
    return KeyReport(**sums)


class FileAccount:
    """Counts for each file what came since the end of the file before it."""

    def __init__(self) -> None:
        self._counted: dict[str, KeyReport] = {}

    def end_file(self, counts: Mapping[str, KeyReport]) -> dict[str, KeyReport]:
        """Report each topic for the file that ends. The next file counts from here."""
        reports = {topic: since(count, self._counted.get(topic, NO_REPORT)) for topic, count in counts.items()}
        self._counted = dict(counts)
        return reports


class LossReport:
    """Gaps that are to be reported: those of one place, key and reason become one.

    Args:
        keys_max: gaps that are kept apart; those of further keys are one gap of the key ``OTHER_KEYS``.
    """

    def __init__(self, keys_max: int) -> None:
        self._keys_max = keys_max
        self._gaps: dict[tuple[str, str, GapReason], RecordGap] = {}

    def lose(self, place: str, key: str, reason: GapReason, count: int, first_ns: int, last_ns: int) -> None:
        """Add samples or messages of a key that were lost between these times of receipt, since 1970."""
        self.add(place, RecordGap(0, 0, key, reason, log_time(first_ns), log_time(last_ns), count))

    def add(self, place: str, gap: RecordGap) -> None:
        """Add a gap. One that is merged has time and sequence of the newest."""
        key = gap.key
        is_new = (place, key, gap.reason) not in self._gaps
        if len(key) > KEY_MAX_LENGTH or (is_new and len(self._gaps) >= self._keys_max):
            key = OTHER_KEYS
        before = self._gaps.get((place, key, gap.reason))
        first_ns, last_ns, count = gap.first_ns, gap.last_ns, gap.count
        if before is not None:
            first_ns, last_ns = min(first_ns, before.first_ns), max(last_ns, before.last_ns)
            count += before.count
        self._gaps[place, key, gap.reason] = RecordGap(
            gap.time_ns, gap.sequence, key, gap.reason, first_ns, last_ns, count
        )

    def take(self) -> list[tuple[str, RecordGap]]:
        """Return the gaps since the last call, each with its place, and forget them."""
        gaps = [(place, gap) for (place, _, _), gap in self._gaps.items()]
        self._gaps.clear()
        return gaps
