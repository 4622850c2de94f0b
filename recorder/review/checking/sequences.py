"""Samples that never came, by the gaps in the sequences of their messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from operator import attrgetter
from typing import Final, Protocol

from recorder.encoding.key_counters import RESTART_STEP, SEQUENCE_SPAN, KeyCounters
from recorder.encoding.protobuf_schema import schema_name
from schemas.messages import CanFrame, GatewayInfo, RawSample
from schemas.recording import RecorderEvent, RecordGap
from schemas.subjects import SCHEMA_PREFIX, SUBJECTS

_CAN_FRAME: Final = schema_name(CanFrame)
_WITHOUT_SEQUENCE: Final = {schema_name(kind) for kind in (RawSample, GatewayInfo, RecorderEvent, RecordGap)}
"""A recorder's own words are counted over all its logs, and each log holds those that are about it."""

KEPT: Final = frozenset(subject.schema_name for subject in SUBJECTS if subject.qos.kept_bytes)
"""Schemas of samples that a recorder may ask for after they went by."""

OPEN_RUNS: Final = 4
"""Runs that may go on by turns: what comes by itself, and what was asked for."""

BATCH_NS: Final = 1_000_000_000
"""The frames of one batch are no further apart than this; the same sequence later is another gateway's."""

RUNS_MAX: Final = 4096
"""Beyond this many they are put in order meanwhile."""


class SequenceCount(Protocol):
    """Follows the sequence of one channel."""

    def take(self, sequences: Sequence[int], publish_ns: Sequence[int], log_ns: Sequence[int]) -> None:
        """Messages that follow each other in the file, by the columns of their headers."""
        ...

    def missed(self) -> tuple[int, int | None]:
        """Samples that never came, and when the first of them should have, since 1970."""
        ...


def sequence_count(schema: str) -> SequenceCount | None:
    """The count of a channel by its schema's name; None where a gap says nothing."""
    if not schema.startswith(f"{SCHEMA_PREFIX}.") or schema in _WITHOUT_SEQUENCE:
        return None
    return _InTimeCount() if schema in KEPT else _InFileCount(is_batched=schema == _CAN_FRAME)


class _InFileCount:
    """Of messages that are in the file in their order.

    Args:
        is_batched: the frames of one batch share its sequence.
    """

    def __init__(self, *, is_batched: bool) -> None:
        self._tally = KeyCounters()
        self._is_batched = is_batched
        self._first_ns: int | None = None

    def take(self, sequences: Sequence[int], _publish_ns: Sequence[int], log_ns: Sequence[int]) -> None:
        tally = self._tally
        distinct = list(dict.fromkeys(sequences)) if self._is_batched else list(sequences)
        if self._is_batched and tally.next is not None and distinct[0] == (tally.next - 1) % SEQUENCE_SPAN:
            del distinct[0]
        if not distinct:
            return
        first, last = distinct[0], distinct[-1]
        if first == tally.next and distinct == list(range(first, last + 1)):
            tally.next = (last + 1) % SEQUENCE_SPAN
            return
        missed = tally.missed
        for place, sequence in enumerate(sequences):
            # Within a batch that is a step back to the tally, and no loss.
            tally.count_sequence(sequence)
            if tally.missed > missed and self._first_ns is None:
                self._first_ns = log_ns[place]

    def missed(self) -> tuple[int, int | None]:
        return self._tally.missed, self._first_ns


class SequenceRun:
    """Messages whose sequences follow each other; the frames of a batch share theirs."""

    __slots__ = ("first", "first_ns", "last", "last_ns")

    def __init__(self, sequence: int, publish_ns: int) -> None:
        self.first = self.last = sequence
        self.first_ns = self.last_ns = publish_ns

    def add(self, sequence: int, publish_ns: int) -> bool:
        """Add a message that follows the last one. Return False if it does not follow."""
        if sequence != self.last + 1 and (sequence != self.last or publish_ns > self.last_ns + BATCH_NS):
            return False
        self.last = sequence
        if publish_ns > self.last_ns:
            self.last_ns = publish_ns
        elif publish_ns < self.first_ns:
            self.first_ns = publish_ns
        return True

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


def _is_free(runs: list[SequenceRun], run: SequenceRun, publish_ns: int) -> bool:
    """Report whether no other run begins between the end of this one and that time: then it cannot go on there."""
    return not any(run.last_ns < other.first_ns < publish_ns for other in runs)


class SequenceLine:
    """The messages of one topic."""

    def __init__(self) -> None:
        self._runs: list[SequenceRun] = []
        self._limit = RUNS_MAX

    def add(self, sequence: int, publish_ns: int) -> None:
        """Add a message that is there."""
        if self._runs and self._runs[-1].add(sequence, publish_ns):
            return
        recent = self._runs[-OPEN_RUNS:]
        for run in reversed(recent[:-1]):
            if _is_free(recent, run, publish_ns) and run.add(sequence, publish_ns):
                return
        if len(self._runs) >= self._limit:
            self._runs = self.runs()
            self._limit = RUNS_MAX + 2 * len(self._runs)
        self._runs.append(SequenceRun(sequence, publish_ns))

    def runs(self) -> list[SequenceRun]:
        """Return the runs, in the order of time."""
        joined: list[SequenceRun] = []
        for run in sorted(self._runs, key=attrgetter("first_ns", "first")):
            if not joined or not joined[-1].join(run):
                joined.append(run)
        self._runs = joined
        return joined

    def gaps(self) -> Iterator[tuple[SequenceRun, SequenceRun, int | None]]:
        """The runs around each gap, and how many sequences are missing; None where the source began anew."""
        runs = self.runs()
        for before, after in pairwise(runs):
            step = (after.first - before.last - 1) % SEQUENCE_SPAN
            yield before, after, step if step < RESTART_STEP else None


class _InTimeCount:
    """Counts messages that a recorder may have queried later: only their publish time gives their place then."""

    def __init__(self) -> None:
        self._line = SequenceLine()

    def take(self, sequences: Sequence[int], publish_ns: Sequence[int], _log_ns: Sequence[int]) -> None:
        add = self._line.add
        for sequence, time_ns in zip(sequences, publish_ns, strict=True):
            add(sequence, time_ns)

    def missed(self) -> tuple[int, int | None]:
        gaps = [(before.last_ns, step) for before, _, step in self._line.gaps() if step]
        return sum(step for _, step in gaps), gaps[0][0] if gaps else None
