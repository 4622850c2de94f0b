"""The channels of a log, and what is known of each. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

import msgspec

from recorder.completeness import KeyReport, report
from recorder.effects import DeclareChannel, Effect, LogChannel
from recorder.foxglove_log import LOG_CHUNK, SCHEMA_DATA, SCHEMA_NAME
from recorder.protobuf_schema import descriptor_set, schema_name
from recorder.routes import Route
from recorder.tally import Tally
from schemas.recorder_settings import CHANNEL_LIMIT
from schemas.recording import GapReason
from schemas.subjects import Subject

OVERFLOW_TOPIC: Final = "@more"
"""The topic of the channel that all keys beyond CHANNEL_LIMIT share."""


class Channels:
    """By topic, which is the key but for broken samples: the one memory of keys, and a bounded one."""

    def __init__(self) -> None:
        self._by_topic: dict[str, Route] = {}
        # By channel id, from 1.
        self._by_id: list[Route] = []

    @property
    def tallies(self) -> Iterable[Tally]:
        """Of every topic."""
        return (route.tally for route in self._by_id)

    @property
    def counts(self) -> dict[str, KeyReport]:
        """Per topic, what was received, written and lost."""
        return {
            topic: report(route.tally, counts_sequence=route.counts_sequence)
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

    def get(self, topic: str) -> Route | None:
        """The topic's route, if it has a channel."""
        return self._by_topic.get(topic)

    def declare(
        self, topic: str, subject: Subject | None, robot: str, effects: list[Effect], *, is_own: bool = False
    ) -> Route:
        """The topic's channel, declared when it is new. There is always room for what the recorder itself says."""
        if len(self._by_topic) >= CHANNEL_LIMIT and topic not in self._by_topic and not is_own:
            topic, subject = OVERFLOW_TOPIC, None
        route = self._by_topic.get(topic)
        if route is None:
            route = self._add(topic, subject, robot)
            kind = route.kind
            channel = LogChannel(route.channel_id, topic, schema_name(kind), descriptor_set(kind))
            effects.append(DeclareChannel(channel))
        return route

    def declare_line(self, topic: str, effects: list[Effect]) -> Route | None:
        """The channel of a topic's events as viewers list them, declared when new; None if there are too many."""
        line_topic = f"{topic}/{LOG_CHUNK}"
        route = self._by_topic.get(line_topic)
        if route is None and len(self._by_topic) < CHANNEL_LIMIT:
            route = self._add(line_topic, None, "")
            effects.append(DeclareChannel(LogChannel(route.channel_id, line_topic, SCHEMA_NAME, SCHEMA_DATA)))
        return route

    def lose_written(self, counts: Mapping[int, int], reason: GapReason | None) -> dict[str, int]:
        """So many messages of these channels are in no log. Without a reason it is no loss.

        Returns:
            The same by topic.
        """
        topics = {}
        names = list(self._by_topic)
        for channel_id, count in counts.items():
            tally = self._by_id[channel_id - 1].tally
            tally.unwritten += count
            if reason is not None:
                tally.lose(reason, count)
            topics[names[channel_id - 1]] = count
        return topics

    def _add(self, topic: str, subject: Subject | None, robot: str) -> Route:
        route = self._by_topic[topic] = Route(len(self._by_topic) + 1, subject, robot)
        self._by_id.append(route)
        return route
