"""The topics of one log, as far as its records have told of them."""

from __future__ import annotations

from mcap import records

from recorder.mcap.summary_reader import LogSummary
from recorder.reading.topics import Topic, topic_of


class Declared:
    """Takes schemas and channels; each channel counts once, however often it is there.

    Args:
        namesakes: names that robots under several roots have.

    Attributes:
        topics: by channel id.
    """

    def __init__(self, namesakes: frozenset[str] = frozenset()) -> None:
        self.topics: dict[int, Topic] = {}
        self._schemas: dict[int, records.Schema] = {}
        self._namesakes = namesakes

    def take(self, record: records.Schema | records.Channel) -> list[tuple[int, Topic]]:
        """The channel id and the topic, if it is new."""
        if isinstance(record, records.Schema):
            self._schemas.setdefault(record.id, record)
            return []
        if record.id in self.topics:
            return []
        topic = topic_of(record, self._schemas.get(record.schema_id), self._namesakes)
        self.topics[record.id] = topic
        return [(record.id, topic)]

    def take_summary(self, summary: LogSummary | None) -> list[tuple[int, Topic]]:
        """Those that the summary repeats. Other people's recorders declare channels within chunks only."""
        if summary is None:
            return []
        found: list[records.Schema | records.Channel] = [*summary.schemas.values(), *summary.channels.values()]
        return [new for one in found for new in self.take(one)]
