"""Logs as a stream of typed messages, for programs: ``from recorder import read_log``."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from recorder.reading.logs import Faults, LogFile, find_logs
from recorder.reading.rows import END_OF_TIME_NS, Selection, place_of, read_rows, wants_of
from recorder.reading.survey import survey
from recorder.reading.times import in_words
from recorder.reading.topics import UNREADABLE, Topic
from schemas.command_line import CommandError
from schemas.subjects import BY_NAME

if TYPE_CHECKING:
    import pyarrow as pa

logger = logging.getLogger(__name__)


class LogMessage(msgspec.Struct, frozen=True, gc=False):
    """A message of a log.

    Attributes:
        topic: the channel's topic. In a log of the recorder it is the Zenoh key.
        log_time_ns: the time of receipt, in nanoseconds since 1970 (UTC).
        publish_time_ns: the time of publication by the source's clock, in the same unit.
        sequence: the source's count, by topic.
        message: an object of ``schemas`` for the gateway's own types; else a protobuf message, decoded JSON, or
            the bytes if there is no decoder or they do not decode.
    """

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    message: Any


class LogMessages:
    """The messages of some logs by log time. Each iteration reads the files again."""

    def __init__(
        self, logs: Sequence[LogFile], selection: Selection, topics: Sequence[str], faults: Faults | None
    ) -> None:
        self._logs = logs
        self._selection = selection
        self._topics = topics
        self._faults = faults

    def __iter__(self) -> Iterator[LogMessage]:
        faults = Faults() if self._faults is None else self._faults
        for row in read_rows(self._logs, self._selection, faults):
            message: Any = row.data
            if row.topic.decode is not None:
                try:
                    message = row.topic.decode(row.data)
                except UNREADABLE as error:
                    faults.add(f"{row.topic.name}: a message that is no {row.topic.schema}: {error}")
            yield LogMessage(row.topic.name, row.log_ns, row.publish_ns, row.sequence, message)
        self._warn(faults)

    def __repr__(self) -> str:
        first, last = min(log.start_ns for log in self._logs), max(log.end_ns for log in self._logs)
        of = f"topics={list(self._topics)}, " if self._topics else ""
        return f"<LogMessages {of}files={len(self._logs)}, from {in_words(first)} to {in_words(last)}>"

    def to_arrow(self) -> dict[str, pa.Table]:
        """Return a table for each topic that has messages, in the order of log times.

        The columns are ``log_time`` and ``publish_time`` (timestamps in ns, UTC), ``sequence``, and the message's
        fields. A field with a unit has it in its metadata, under ``unit``. Needs the extra ``review``.
        """
        import pyarrow as pa  # noqa: PLC0415 - an extra

        from recorder.review.columns import LOG_TIME, read_batches  # noqa: PLC0415 - as above

        faults = Faults() if self._faults is None else self._faults
        batches: dict[str, list[pa.Table]] = {}
        for log in self._logs:
            for batch in read_batches(log, self._selection, faults):
                batches.setdefault(batch.columns.topic.name, []).append(pa.Table.from_batches([batch.rows]))
        self._warn(faults)
        return {
            topic: pa.concat_tables(found, promote_options="default").unify_dictionaries().sort_by(LOG_TIME)
            for topic, found in sorted(batches.items())
        }

    def _warn(self, faults: Faults) -> None:
        for line in faults.told if self._faults is None else ():
            logger.warning("%s", line)


def read_log(
    *paths: str | Path,
    topics: Sequence[str] = (),
    from_ns: int = 0,
    to_ns: int = END_OF_TIME_NS,
    faults: Faults | None = None,
) -> LogMessages:
    """Read logs message by message, by log time. Damaged and unfinished files are read as far as they go.

    Args:
        paths: files, or directories of logs.
        topics: shell patterns of topics, whole or after the robot: ``state``, ``safety/*``; none is all.
        from_ns: the first log time, in nanoseconds since 1970.
        to_ns: the first log time that is not read.
        faults: collects what cannot be read. Without it, each fault is logged as a warning at the end.

    Raises:
        CommandError: there is no log at these paths, or no topic matches a pattern.
    """
    found = Faults() if faults is None else faults
    logs = find_logs([Path(path) for path in paths], found)
    if topics:
        _require(topics, survey(logs, Faults()).topics.values())
    return LogMessages(logs, Selection(wants_of(topics), from_ns, to_ns), topics, faults)


def _require(patterns: Iterable[str], topics: Iterable[Topic]) -> None:
    """Raise for a pattern without a topic, in these logs or among the gateway's own subjects."""
    topics = list(topics)
    places = {place_of(topic)[0] for topic in topics}
    for pattern in patterns:
        if pattern in BY_NAME or any(map(wants_of([pattern]), topics)):
            continue
        near = get_close_matches(pattern, sorted({*places, *BY_NAME, *(topic.name for topic in topics)}), 1)
        hint = f"; the nearest is {near[0]!r}" if near else ""
        raise CommandError(f"no topic of these logs is {pattern!r}{hint}")
