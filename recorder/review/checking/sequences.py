"""Samples that never came, by the gaps in the sequences of their messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Protocol

from recorder.backfill.runs import SequenceLine
from recorder.encoding.key_counters import SEQUENCE_SPAN, KeyCounters
from recorder.encoding.protobuf_schema import schema_name
from schemas.messages import CanFrame, GatewayInfo, RawSample
from schemas.recording import RecorderEvent, RecordGap
from schemas.subjects import SCHEMA_PREFIX, SUBJECTS

_CAN_FRAME: Final = schema_name(CanFrame)
_WITHOUT_SEQUENCE: Final = {schema_name(kind) for kind in (RawSample, GatewayInfo, RecorderEvent, RecordGap)}
"""A recorder's own words are counted over all its logs, and each log holds those that are about it."""

KEPT: Final = frozenset(subject.schema_name for subject in SUBJECTS if subject.qos.kept_bytes)
"""Schemas of samples that a recorder may ask for after they went by."""


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
