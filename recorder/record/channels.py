"""The channels of a log, and what is known of each. Pure.

A sample is looked up by its key, and an event's second form by the key of the event: two maps, for both may want
the same topic. What somebody publishes as ``KEY/log`` is no line of ours.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from enum import Enum, auto
from typing import Final

import msgspec

from recorder.encoding.foxglove_log import LOG_CHUNK, SCHEMA_DATA, SCHEMA_NAME
from recorder.encoding.key_counters import KeyCounters
from recorder.encoding.protobuf_schema import descriptor_set, schema_name
from recorder.encoding.routes import RAW_CHUNK, Route
from recorder.mcap.channel import LogChannel
from recorder.record.accounting import KeyReport, report
from schemas.keys import KEY_MAX_LENGTH
from schemas.recording import GapReason
from schemas.settings import CHANNEL_LIMIT, TABLE_CHANNEL_LIMIT
from schemas.subjects import Subject

OVERFLOW_TOPIC: Final = "@more"
"""The topic of the channel that all keys share for which there is no other."""

RESERVED_LINE_CHUNK: Final = "@log"
"""Events as viewers list them go to ``{key}/@log`` where ``{key}/log`` is somebody's key; no key goes there."""


class ChannelQuota(Enum):
    """The channels among which a new one counts: keys that anybody makes up must not take the place of others."""

    OTHER = auto()
    TABLE = auto()
    OWN = auto()


LIMITS: Final = {ChannelQuota.OTHER: CHANNEL_LIMIT, ChannelQuota.TABLE: TABLE_CHANNEL_LIMIT}
"""Channels of each quota. What the recorder itself publishes has no limit."""


class Channels:
    """The channels of a log by key: its only memory of keys, and a bounded one.

    Args:
        declare: is called with each new channel.
    """

    def __init__(self, declare: Callable[[LogChannel], None]) -> None:
        self._declare = declare
        self._by_key: dict[str, Route] = {}
        self._lines: dict[str, Route] = {}
        """By the key of the events."""
        self._by_topic: dict[str, Route] = {}
        # By channel id, from 1.
        self._by_id: list[Route] = []
        self._topics: list[str] = []
        self._used: Counter[ChannelQuota] = Counter()

    @property
    def counters(self) -> Iterable[KeyCounters]:
        """The counters of every topic."""
        return (route.counters for route in self._by_id)

    @property
    def counts(self) -> dict[str, KeyReport]:
        """The report of each topic."""
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
            topic = f"{key}/{RAW_CHUNK}" if self._is_line(key) else key
            route = self._by_key[key] = self._add(topic, subject, robot)
        return route

    def declare_raw(self, key: str) -> Route:
        """The route of the broken samples of a known key."""
        return self.declare(f"{key}/{RAW_CHUNK}", None, "")

    def declare_line(self, key: str, quota: ChannelQuota) -> Route | None:
        """The route of a key's events as viewers list them; None if the quotas are used up."""
        route = self._lines.get(key)
        if route is None and self._use(quota):
            topic = f"{key}/{LOG_CHUNK}"
            if topic in self._by_topic:
                topic = f"{key}/{RESERVED_LINE_CHUNK}"
            route = self._lines[key] = self._remember(topic, None, "")
            self._declare(LogChannel(route.channel_id, topic, SCHEMA_NAME, SCHEMA_DATA))
        return route

    def lose_written(self, counts: Mapping[int, int], reason: GapReason | None) -> dict[str, int]:
        """Count messages of these channels that are in no log. Without a reason they are no loss.

        Returns:
            The counts by topic.
        """
        topics = {}
        for channel_id, count in counts.items():
            counters = self._by_id[channel_id - 1].counters
            counters.unwritten += count
            if reason is not None:
                counters.lose(reason, count)
            topics[self._topics[channel_id - 1]] = count
        return topics

    def _is_line(self, topic: str) -> bool:
        """True if a topic is one of a line, or is kept free for one."""
        key, _, chunk = topic.rpartition("/")
        return chunk == RESERVED_LINE_CHUNK or (chunk == LOG_CHUNK and key in self._lines)

    def _use(self, quota: ChannelQuota) -> bool:
        """Use one more channel of a quota, or else of the one for keys that anybody may make up. False if full."""
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
