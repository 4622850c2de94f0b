"""The channels of a log, and its counts of samples sent, received, written and lost. Pure.

Samples and records for viewers (``KEY/log``, ``KEY/tf``, ...) have two maps, both by key: a sample published as
``KEY/log`` is no line.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from enum import Enum, auto
from typing import Any, Final

import msgspec

from recorder.encoding.protobuf import descriptor_set, schema_name
from recorder.encoding.routes import Route
from recorder.encoding.samples import KeyCounters
from recorder.encoding.viewers import SHOWN, Shown
from recorder.mcap.writer import LogChannel, log_time
from schemas.keys import KEY_MAX_LENGTH
from schemas.recording import RAW_CHUNK, GapReason, RecordGap
from schemas.settings import CHANNEL_LIMIT, TABLE_CHANNEL_LIMIT
from schemas.subjects import Subject

COMPLETENESS_NAME: Final = "cruiser.completeness"
"""Metadata record with each topic's ``KeyReport`` for this file, as JSON."""

OTHER_KEYS: Final = "**"
"""The key of a gap that stands for keys beyond the limit, and for keys that are too long."""


class KeyReport(msgspec.Struct, frozen=True):
    """Counts of one key, from its source into the log.

    Up to the recorder's queue it counts samples, then messages: a batch of raw frames is one sample and many
    messages.

    Attributes:
        sent: by the sequence; None where the source has none.
        lost_bus: frames lost between chassis and gateway, by alive counters; None if the gateway reports none.
        lost_queue: dropped from a full queue.
        lost_size: larger than the recorder may record.
        lost_full: received while the disk was full.
        lost_disk: not stored by the disk.
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
        return self.lost_link + self.lost_queue + self.lost_size + self.lost_full + self.lost_disk


NO_REPORT: Final = KeyReport()


def report(counters: KeyCounters, *, counts_sequence: bool) -> KeyReport:
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
    """Subtract an earlier report. Never below 0: a later file may hold what an earlier one missed."""
    first = msgspec.structs.asdict(before)
    change: dict[str, Any] = {
        name: None if value is None else max(0, value - (first[name] or 0))
        for name, value in msgspec.structs.asdict(now).items()
    }
    return KeyReport(**change)


def total(reports: Iterable[KeyReport]) -> KeyReport:
    sums: dict[str, Any] = {}
    for one in reports:
        for name, value in msgspec.structs.asdict(one).items():
            before = sums.get(name)
            sums[name] = value if before is None else before + (value or 0)
    return KeyReport(**sums)


class LossReport:
    """Gaps to report, merged by place, key and reason. Beyond ``keys_max`` all keys share ``OTHER_KEYS``."""

    def __init__(self, keys_max: int) -> None:
        self._keys_max = keys_max
        self._gaps: dict[tuple[str, str, GapReason], RecordGap] = {}

    def lose(self, place: str, key: str, reason: GapReason, count: int, first_ns: int, last_ns: int) -> None:
        """Add lost samples or messages of a key, received between these times since 1970."""
        self.add(place, RecordGap(0, 0, key, reason, log_time(first_ns), log_time(last_ns), count))

    def add(self, place: str, gap: RecordGap) -> None:
        """Add a gap. A merged gap has time and sequence of the newest."""
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


OVERFLOW_TOPIC: Final = "@more"  # the topic that all keys beyond the limit share

RESERVED_CHUNKS: Final = {shown.chunk: f"@{shown.chunk}" for shown in SHOWN}
"""Event lines go to ``{key}/@log`` where ``{key}/log`` is a sample's key; no sample's key ends so."""


class ChannelQuota(Enum):
    """The quota that a new channel counts against: made-up keys must not displace others."""

    OTHER = auto()
    TABLE = auto()
    OWN = auto()


LIMITS: Final = {ChannelQuota.OTHER: CHANNEL_LIMIT, ChannelQuota.TABLE: TABLE_CHANNEL_LIMIT}  # OWN has none


class Channels:
    """The channels of a log by key; bounded."""

    def __init__(self, declare: Callable[[LogChannel], None]) -> None:
        self._declare = declare
        self._by_key: dict[str, Route] = {}
        self._shown: dict[tuple[str, str], Route] = {}  # by the key of the samples, and the chunk
        self._by_topic: dict[str, Route] = {}
        # By channel id, from 1.
        self._by_id: list[Route] = []
        self._topics: list[str] = []
        self._used: Counter[ChannelQuota] = Counter()

    @property
    def counters(self) -> Iterable[KeyCounters]:
        return (route.counters for route in self._by_id)

    @property
    def counts(self) -> dict[str, KeyReport]:
        return {
            topic: report(route.counters, counts_sequence=route.counts_sequence)
            for topic, route in sorted(self._by_topic.items())
        }

    @property
    def latest(self) -> dict[str, str]:
        """The newest state of each topic, as JSON, with its log time."""
        return {
            topic: msgspec.json.encode({"log_time_ns": latest.log_ns, "message": latest.message}).decode()
            for topic, route in sorted(self._by_topic.items())
            if (latest := route.latest).message is not None
        }

    def get(self, key: str) -> Route | None:
        """The route of a key's samples, if it has a channel."""
        return self._by_key.get(key)

    def declare(
        self, key: str, subject: Subject | None, robot: str, quota: ChannelQuota = ChannelQuota.OTHER
    ) -> Route:
        """The route of a key's samples, declared when new; the shared one if the quotas are used up."""
        route = self._by_key.get(key)
        if route is None:
            if len(key) > KEY_MAX_LENGTH or not self._use(quota):
                return self._add(OVERFLOW_TOPIC, None, "")
            topic = f"{key}/{RAW_CHUNK}" if self._is_shown(key) else key
            route = self._by_key[key] = self._add(topic, subject, robot)
        return route

    def declare_raw(self, key: str) -> Route:
        """The route of a known key's undecodable samples."""
        return self.declare(f"{key}/{RAW_CHUNK}", None, "")

    def declare_shown(self, key: str, shown: Shown, quota: ChannelQuota) -> Route | None:
        """The route of the records for viewers beside a key; None if the quotas are used up."""
        route = self._shown.get((key, shown.chunk))
        if route is None and self._use(quota):
            topic = f"{key}/{shown.chunk}"
            if topic in self._by_topic:
                topic = f"{key}/{RESERVED_CHUNKS[shown.chunk]}"
            route = self._shown[key, shown.chunk] = self._remember(topic, None, "")
            self._declare(LogChannel(route.channel_id, topic, shown.schema_name, shown.schema_data))
        return route

    def lose_written(self, counts: Mapping[int, int], reason: GapReason | None) -> dict[str, int]:
        """Count unwritten messages of these channels. Without a reason they are no loss."""
        topics = {}
        for channel_id, count in counts.items():
            counters = self._by_id[channel_id - 1].counters
            counters.unwritten += count
            if reason is not None:
                counters.lose(reason, count)
            topics[self._topics[channel_id - 1]] = count
        return topics

    def _is_shown(self, topic: str) -> bool:
        """True if a topic is one of records for viewers, or reserved for them."""
        key, _, chunk = topic.rpartition("/")
        return chunk in RESERVED_CHUNKS.values() or (key, chunk) in self._shown

    def _use(self, quota: ChannelQuota) -> bool:
        """Use one more channel of a quota, or else of OTHER. False if both are full."""
        for one in (quota, ChannelQuota.OTHER):
            limit = LIMITS.get(one)
            if limit is None or self._used[one] < limit:
                self._used[one] += 1
                return True
        return False

    def _add(self, topic: str, subject: Subject | None, robot: str) -> Route:
        route = self._by_topic.get(topic)
        if route is None:
            route = self._remember(topic, subject, robot)
            kind = route.kind
            self._declare(LogChannel(route.channel_id, topic, schema_name(kind), descriptor_set(kind)))
        return route

    def _remember(self, topic: str, subject: Subject | None, robot: str) -> Route:
        self._by_id.append(Route(len(self._by_id) + 1, subject, robot))
        self._topics.append(topic)
        route = self._by_topic[topic] = self._by_id[-1]
        return route
