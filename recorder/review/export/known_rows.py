"""Messages that earlier logs hold already: an incident repeats its log, two recorders may record one robot.

Two messages of ours are one if topic, publish time and sequence are the same. The times and sequences of others
have no known meaning: such messages are one if the log time is the same too. A recorder's own messages are kept:
they are counted over all its logs, and each log holds those about itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from recorder.encoding.foxglove_log import SCHEMA_NAME as LOG_SCHEMA_NAME
from recorder.mcap.summary_reader import read_summary
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Selection
from recorder.reading.topics import Topic
from recorder.review.columns.reader import read_batches
from recorder.review.columns.tables import LOG_TIME, PUBLISH_TIME, SEQUENCE, TIME_MAX_NS
from schemas.messages import RawSample
from schemas.subjects import RECORDER_CHUNK

SLACK_NS: Final = 600_000_000_000
"""Logs may hold the same if their times overlap, give or take so much: clocks differ, and some comes late."""

KNOWN_MAX: Final = 8_000_000
"""So many messages of earlier logs are remembered, 8 bytes each; what is beyond may come twice."""

Hashes = NDArray[np.uint64]
_Key = tuple[str, str, str]


def may_repeat(topic: str) -> bool:
    """Report whether messages of the topic may be in another log."""
    return f"/{RECORDER_CHUNK}/" not in f"/{topic}"


class TopicNames(dict[Path, set[str] | None]):
    """The topics of logs that may be in other logs, each log's summary read once; None if it does not say."""

    def __missing__(self, path: Path) -> set[str] | None:
        self[path] = names = _topic_names(path)
        return names


def overlapping(log: LogFile, earlier: Sequence[LogFile], names: TopicNames) -> list[LogFile]:
    """Those of earlier logs that may hold what this one holds."""
    near = [
        one for one in earlier if one.start_ns <= log.end_ns + SLACK_NS and one.end_ns >= log.start_ns - SLACK_NS
    ]
    if not near:
        return []
    own = names[log.path]
    return [one for one in near if own is None or (others := names[one.path]) is None or others & own]


class KnownRows:
    """Leaves out what earlier logs hold.

    Args:
        log: the log that is read.
        earlier: those before it, of ``overlapping``.
        selection: the wanted messages.

    Attributes:
        repeats: messages so far that were left out.
        is_full: there were more than could be remembered.
    """

    def __init__(self, log: LogFile, earlier: Sequence[LogFile], selection: Selection) -> None:
        self.repeats = 0
        self.is_full = False
        self._known = self._read(log, earlier, selection)

    def sift(
        self,
        topic: Topic,
        log_ns: NDArray[np.uint64],
        publish_ns: NDArray[np.uint64],
        sequence: NDArray[np.uint32],
    ) -> NDArray[np.bool_] | None:
        """Return a mask of the messages that are new; None if all are. See ``reader.Sift``."""
        known = self._known.get(_key(topic))
        if known is None:
            return None
        hashes = _hashes(topic, log_ns, publish_ns, sequence)
        places = np.minimum(np.searchsorted(known, hashes), len(known) - 1)
        is_new: NDArray[np.bool_] = known[places] != hashes
        self.repeats += len(is_new) - int(is_new.sum())
        return is_new

    def _read(self, log: LogFile, earlier: Sequence[LogFile], selection: Selection) -> dict[_Key, Hashes]:
        found: dict[_Key, list[Hashes]] = {}
        count = 0
        for topic, hashes in _rows_of(log, earlier, selection):
            found.setdefault(topic, []).append(hashes)
            count += len(hashes)
            if count > KNOWN_MAX:
                self.is_full = True
                break
        return {topic: np.unique(np.concatenate(parts)) for topic, parts in found.items()}


def _rows_of(log: LogFile, earlier: Sequence[LogFile], selection: Selection) -> Iterator[tuple[_Key, Hashes]]:
    near = Selection(
        wants=lambda topic: may_repeat(topic.name) and selection.wants(topic),
        from_ns=max(0, log.start_ns - SLACK_NS),
        to_ns=log.end_ns + SLACK_NS,
    )
    for one in earlier:
        # What is wrong with it is told when it is read itself.
        for batch in read_batches(one, near, Faults(), wanted=(LOG_TIME, PUBLISH_TIME, SEQUENCE)):
            log_ns, publish_ns, sequence = (
                np.frombuffer(column.buffers()[1], np.uint64)[: len(column)] for column in batch.rows.columns
            )
            topic = batch.columns.topic
            yield _key(topic), _hashes(topic, log_ns, publish_ns, sequence)


def _key(topic: Topic) -> _Key:
    return topic.name, topic.schema, topic.encoding


def _hashes(topic: Topic, log_ns: NDArray[Any], publish_ns: NDArray[Any], sequence: NDArray[Any]) -> Hashes:
    """One number for each message, which two different ones share once in 2**64."""
    is_ours = topic.kind not in {None, RawSample} or topic.schema == LOG_SCHEMA_NAME
    mixed = np.zeros(len(log_ns), np.uint64)
    for numbers in (publish_ns, sequence) if is_ours else (publish_ns, sequence, log_ns):
        # Later times than Arrow's are all the same there.
        mixed ^= np.minimum(numbers.astype(np.uint64), np.uint64(TIME_MAX_NS))
        for _ in range(2):
            mixed ^= mixed >> np.uint64(32)
            mixed *= np.uint64(0xD6E8FEB86659FD93)
        mixed += np.uint64(0x9E3779B97F4A7C15)
    return mixed


def _topic_names(path: Path) -> set[str] | None:
    try:
        with path.open("rb") as stream:
            summary = read_summary(stream)
    except OSError:
        return None
    if summary is None:
        return None
    return {channel.topic for channel in summary.channels.values() if may_repeat(channel.topic)}
