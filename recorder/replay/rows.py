"""The rows of logs as they are replayed: each once, frames of a batch together, by a chosen time. Pure.

Memory is bounded, however long the logs are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from enum import Enum
from heapq import heappop, heappush
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Row, Selection, read_rows
from recorder.reading.topics import Topic
from schemas.messages import CanFrame
from schemas.settings import BATCH_MAX_FRAMES

REMEMBERED: Final = 200_000
"""Rows that are compared with those of other files: some four minutes of a robot. Twice as many are held."""

HORIZON_NS: Final = 2_000_000_000
"""A row that reached the recorder so much later than others is not sorted in among them any more."""

SORTED_MAX: Final = 100_000
"""Rows that are held for sorting, whatever their times say."""


class By(Enum):
    """The time that decides when a message is replayed: the recorder's receipt, or the source's own."""

    LOG = "log"
    PUBLISH = "publish"


class ReplayRun(msgspec.Struct, frozen=True, gc=False):
    """One message of a log; of raw frames all that came in one batch.

    Attributes:
        time_ns: when it is due, in the log's time.
    """

    time_ns: int
    topic: Topic
    rows: list[Row]


def topics_of(logs: Sequence[LogFile]) -> list[Topic]:
    """The topics of logs. Of chunks that have an index none is read."""
    found: list[Topic] = []

    def note(topic: Topic) -> bool:
        found.append(topic)
        return False

    # What cannot be read is told when the rows are.
    for _ in read_rows(logs, Selection(note), Faults()):
        pass
    return found


def once(rows: Iterable[Row], remembered: int = REMEMBERED) -> Iterator[Row]:
    """The rows without those that another file repeats: an incident, another recorder's log."""
    before: dict[tuple[str, int, int], Topic] = {}
    seen: dict[tuple[str, int, int], Topic] = {}
    for row in rows:
        topic = row.topic
        name = (topic.name, row.sequence, row.publish_ns)
        first = seen.get(name) or before.get(name)
        if first is None:
            if len(seen) >= remembered:
                before, seen = seen, {}
            seen[name] = topic
        elif first is not topic:
            # Each file has topics of its own; what one file has twice was twice.
            continue
        yield row


def runs(rows: Iterable[Row], by: By) -> Iterator[ReplayRun]:
    """The runs, each at the place of its first row."""
    pending: dict[Topic, list[Row]] = {}
    log_ns = -1
    for row in rows:
        if pending and row.log_ns != log_ns:
            yield from _released(pending, by)
        log_ns = row.log_ns
        topic = row.topic
        if topic.kind is not CanFrame:
            yield ReplayRun(_time_ns(row, by), topic, [row])
            continue
        batch = pending.get(topic)
        if batch and (batch[0].sequence != row.sequence or len(batch) >= BATCH_MAX_FRAMES):
            yield _run(batch, by)
            batch = None
        if batch is None:
            pending[topic] = [row]
        else:
            batch.append(row)
    yield from _released(pending, by)


def in_order(
    found: Iterable[ReplayRun], horizon_ns: int = HORIZON_NS, limit: int = SORTED_MAX
) -> Iterator[ReplayRun]:
    """The runs sorted by their times, as far as they are not more than the horizon out of it."""
    waiting: list[tuple[int, int, ReplayRun]] = []
    for number, run in enumerate(found):
        heappush(waiting, (run.time_ns, number, run))
        while waiting[0][2].rows[0].log_ns + horizon_ns <= run.rows[0].log_ns or len(waiting) > limit:
            yield heappop(waiting)[2]
    while waiting:
        yield heappop(waiting)[2]


def _released(pending: dict[Topic, list[Row]], by: By) -> Iterator[ReplayRun]:
    for batch in pending.values():
        yield _run(batch, by)
    pending.clear()


def _run(batch: list[Row], by: By) -> ReplayRun:
    # A batch was published when its last frame had come.
    return ReplayRun(max(_time_ns(row, by) for row in batch), batch[0].topic, batch)


def _time_ns(row: Row, by: By) -> int:
    return row.log_ns if by is By.LOG else row.publish_ns
