"""A log in a program: ``from recorder import read_log``."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.reading.rows import END_OF_TIME_NS, Selection, read_rows
from recorder.reading.topic_names import wants_of
from recorder.reading.topics import UNREADABLE

logger = logging.getLogger(__name__)


class LogMessage(msgspec.Struct, frozen=True, gc=False):
    """A message of a log. Times are nanoseconds since 1970.

    Attributes:
        topic: the channel's topic; in a log of ours the Zenoh key.
        log_time_ns: when the recorder received it.
        publish_time_ns: when its source published it, by the source's clock.
        sequence: a count of the source's, for each topic.
        message: a class of ``schemas`` for what is ours; of others a protobuf message, or what JSON holds; the
            bytes where no decoder is known, or where they are no such message.
    """

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    message: Any


def read_log(
    *paths: str | Path,
    topics: Sequence[str] = (),
    from_ns: int = 0,
    to_ns: int = END_OF_TIME_NS,
    faults: Faults | None = None,
) -> Iterator[LogMessage]:
    """Read logs message by message, in the order of log times; damaged and unfinished ones as far as they go.

    Args:
        paths: files, or directories of logs.
        topics: patterns as of a shell, for the whole topic or what follows the robot in it: ``state``,
            ``safety/*``; none reads all.
        from_ns: the first log time.
        to_ns: the first log time that is too late.
        faults: takes what cannot be read. Without it that is logged as a warning, when all is read.

    Raises:
        CommandError: there is no log at these paths.
    """
    found = Faults() if faults is None else faults
    logs = find_logs([Path(path) for path in paths], found)
    for row in read_rows(logs, Selection(wants_of(topics), from_ns, to_ns), found):
        message: Any = row.data
        if row.topic.decode is not None:
            try:
                message = row.topic.decode(row.data)
            except UNREADABLE as error:
                found.add(f"{row.topic.name}: a message that is no {row.topic.schema}: {error}")
        yield LogMessage(row.topic.name, row.log_ns, row.publish_ns, row.sequence, message)
    for line in found.told if faults is None else ():
        logger.warning("%s", line)
