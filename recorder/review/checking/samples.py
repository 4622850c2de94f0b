"""Samples that never came, by the gaps in the sequences of their messages; in one log, and between several."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from operator import attrgetter
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from recorder.encoding.key_counters import RESTART_STEP, SEQUENCE_SPAN
from recorder.encoding.protobuf_schema import schema_name
from recorder.mcap.arrays import Numbers
from schemas import keys
from schemas.messages import GatewayInfo, RawSample
from schemas.recording import RecorderEvent, RecordGap
from schemas.subjects import SCHEMA_PREFIX, SUBJECTS

Times = NDArray[np.uint64]

_WITHOUT_SEQUENCE: Final = {schema_name(kind) for kind in (RawSample, GatewayInfo, RecorderEvent, RecordGap)}
"""A recorder's own words are counted over all its logs, and each log holds those that are about it."""

KEPT: Final = frozenset(subject.schema_name for subject in SUBJECTS if subject.qos.kept_bytes)
"""Schemas of samples that a recorder may ask for after they went by."""

BATCH_NS: Final = 1_000_000_000
"""The same sequence later than this is another gateway's."""

RUNS_MAX: Final = 4096
"""Beyond this many they are put in order meanwhile."""

RETURNS_MIN: Final = 10
"""So many times a sequence has to go on where it was before the sample between, until two sources are believed."""

NEAR: Final = 16
"""Samples this near to each other may have overtaken one another."""


def has_sequence(schema: str) -> bool:
    """Report whether a gap in the sequence says something, by the schema's name."""
    return schema.startswith(f"{SCHEMA_PREFIX}.") and schema not in _WITHOUT_SEQUENCE


class FollowingCount:
    """Counts messages that are in the file in their order; the frames of a batch share its sequence.

    Attributes:
        missed: samples that never came.
        first_ns: log time of the message behind the first gap; None if there is none.
        returns: how often the sequence went on where it was before the sample between.
    """

    def __init__(self) -> None:
        self.missed = self.returns = 0
        self.first_ns: int | None = None
        self._last: list[int] = []

    @property
    def has_two_sources(self) -> bool:
        """Two sources take turns; what either lost is not known."""
        return self.returns >= RETURNS_MIN

    def take(self, sequences: Numbers, log_ns: Times) -> None:
        """Count the next messages, by the columns of their headers."""
        joined = np.concatenate([np.array(self._last, np.int64), sequences])
        is_new = np.diff(joined, prepend=-1) != 0
        distinct = joined[is_new]
        steps = np.diff(distinct)
        if len(steps) > 1:
            goes_on = (distinct[2:] - distinct[:-2]) % SEQUENCE_SPAN == 1
            self.returns += int(np.count_nonzero(goes_on & (np.abs(steps[1:]) > NEAR)))
        gaps = (steps - 1) % SEQUENCE_SPAN
        gaps[gaps >= RESTART_STEP] = 0
        # The two messages before have been counted.
        gaps[: max(0, len(self._last) - 1)] = 0
        self.missed += int(gaps.sum())
        if self.first_ns is None and gaps.any():
            place = int(np.flatnonzero(is_new)[np.flatnonzero(gaps)[0] + 1]) - len(self._last)
            self.first_ns = int(log_ns[place])
        self._last = distinct[-2:].tolist()


class SequenceRun(msgspec.Struct):
    """Messages whose sequences follow each other."""

    first: int
    last: int
    first_ns: int
    last_ns: int

    def join(self, other: SequenceRun) -> bool:
        """Add a run that begins no earlier. Return False if it neither follows this one nor is a part of it."""
        length, begins, ends = (
            (sequence - self.first) % SEQUENCE_SPAN for sequence in (self.last, other.first, other.last)
        )
        if begins == length:
            is_next = other.first_ns - self.last_ns <= BATCH_NS
        else:
            is_next = begins == length + 1 or (begins < length and other.first_ns <= self.last_ns)
        if is_next:
            if ends > length:
                self.last = other.last
            self.last_ns = max(self.last_ns, other.last_ns)
        return is_next


class InTimeCount:
    """Counts messages that a recorder may have asked for later: only their publish time gives their place then."""

    has_two_sources: Final = False

    def __init__(self) -> None:
        self._runs: list[SequenceRun] = []
        self._limit = RUNS_MAX

    @property
    def missed(self) -> int:
        """Samples that never came."""
        return sum(step or 0 for _, _, step in self.gaps())

    @property
    def first_ns(self) -> int | None:
        """The time of the sample before the first of them."""
        return next((before.last_ns for before, _, step in self.gaps() if step), None)

    def take(self, sequences: Numbers, publish_ns: Times) -> None:
        """Count the next messages, by the columns of their headers."""
        steps, times_ns = np.diff(sequences), publish_ns.astype(np.float64)
        follows = (steps == 1) | ((steps == 0) & (np.diff(times_ns) <= BATCH_NS))
        begins = np.flatnonzero(np.concatenate([[True], ~follows]))
        ends = np.append(begins[1:], len(sequences)) - 1
        firsts_ns, lasts_ns = np.minimum.reduceat(publish_ns, begins), np.maximum.reduceat(publish_ns, begins)
        columns = (sequences[begins], sequences[ends], firsts_ns, lasts_ns)
        self._runs += [SequenceRun(*run) for run in zip(*(column.tolist() for column in columns), strict=True)]
        if len(self._runs) >= self._limit:
            self._limit = RUNS_MAX + 2 * len(self.runs())

    def runs(self) -> list[SequenceRun]:
        """Return the runs, in the order of time."""
        joined: list[SequenceRun] = []
        for run in sorted(self._runs, key=attrgetter("first_ns", "first")):
            if not joined or not joined[-1].join(run):
                joined.append(run)
        self._runs = joined
        return joined

    def gaps(self) -> Iterator[tuple[SequenceRun, SequenceRun, int | None]]:
        """The runs around each gap, and how many sequences are missing; None where the source started again."""
        for before, after in pairwise(self.runs()):
            step = (after.first - before.last - 1) % SEQUENCE_SPAN
            yield before, after, step if step < RESTART_STEP else None


class ChannelEnds(msgspec.Struct, frozen=True):
    """The first and the last message of a channel in a log: their sequences and log times."""

    first: int
    last: int
    first_ns: int
    last_ns: int


class Between(msgspec.Struct, frozen=True):
    """Samples of a robot that are missing between two logs.

    Attributes:
        robot: the first chunks of its keys.
        samples: how many, on so many ``topics``.
        from_ns, to_ns: log times of the last message before, and of the first one after.
        before, after: the two logs.
    """

    robot: str
    samples: int
    topics: int
    from_ns: int
    to_ns: int
    before: str
    after: str


def between(logs: Iterable[tuple[str, dict[str, ChannelEnds]]]) -> list[Between]:
    """Find what is in none of the logs. Where a gateway started again between two logs, nothing is counted.

    Args:
        logs: of each its path, and the ends of its channels by topic.
    """
    by_topic: dict[str, list[tuple[ChannelEnds, str]]] = {}
    for path, ends in logs:
        for topic, one in ends.items():
            by_topic.setdefault(topic, []).append((one, path))
    found: dict[tuple[str, str, str], Between] = {}
    for topic, parts in by_topic.items():
        for new in _of_topic(topic, sorted(parts, key=lambda part: part[0].first_ns)):
            place = new.robot, new.before, new.after
            found[place] = _added(found[place], new) if place in found else new
    return sorted(found.values(), key=lambda one: (one.from_ns, one.robot))


def _of_topic(topic: str, parts: list[tuple[ChannelEnds, str]]) -> Iterator[Between]:
    parsed = keys.parse(topic)
    robot = f"{parsed.root}/{parsed.robot}" if parsed and parsed.robot else topic
    before, path = parts[0]
    for after, next_path in parts[1:]:
        step = (after.first - before.last - 1) % SEQUENCE_SPAN
        if after.first_ns >= before.last_ns and 0 < step < RESTART_STEP:
            yield Between(robot, step, 1, before.last_ns, after.first_ns, path, next_path)
        # An incident's log lies within another.
        if after.last_ns > before.last_ns:
            before, path = after, next_path


def _added(one: Between, other: Between) -> Between:
    return Between(
        one.robot,
        one.samples + other.samples,
        one.topics + other.topics,
        min(one.from_ns, other.from_ns),
        max(one.to_ns, other.to_ns),
        one.before,
        one.after,
    )
