"""The state of one channel while a log is checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
from mcap import records

from recorder.encoding.key_counters import SEQUENCE_SPAN
from recorder.encoding.protobuf_schema import schema_name
from recorder.mcap.arrays import Bytes, Places
from recorder.reading.topics import UNREADABLE, typed_decoder
from recorder.review.checking.findings import Findings
from recorder.review.checking.frames import FAR_NS, ClockStep, FrameCount
from recorder.review.checking.messages import datas, proof_of
from recorder.review.checking.samples import KEPT, ChannelEnds, FollowingCount, InTimeCount, has_sequence
from schemas.decisions import Journal
from schemas.messages import CanFrame
from schemas.recording import RecordGap

_CAN_FRAME: Final = schema_name(CanFrame)
_JOURNAL: Final = schema_name(Journal)
_RECORD_GAP: Final = schema_name(RecordGap)

_AGREE_NS: Final = 1_000_000_000
"""Times that differ by no more agree: a journal is published some milliseconds after what stands in it."""

STEPS_MAX: Final = 1000
"""Steps of the clock that are remembered."""

_TWO_SOURCES: Final = "two gateways speak under one name: what either lost is not known"

_FRAME_FAULTS: Final = {
    "lost": "frames lost, by the alive counter",
    "repeated": "frames with the alive counter of the one before",
    "corrupt": "frames with a wrong checksum",
    "outages": "gaps in time in which the alive counter may have gone round, or steps back",
    "unseen": "frames lost in these by whole rounds of the alive counter, by the period",
}


class ChannelCheck(msgspec.Struct, frozen=True):
    """A channel.

    Attributes:
        is_read: its messages were held against its schema; of an encoding that is not known here they cannot be.
        unreadable: messages that are not what their schema says.
        missed: samples that never came, by the gaps in ``sequence``; None where a gap says nothing.
        ends: its first and last message; None where a gap says nothing, and for messages that may have come later.
    """

    topic: str
    schema: str
    encoding: str
    messages: int
    is_read: bool
    unreadable: int
    missed: int | None
    ends: ChannelEnds | None


class Channel:
    """Follows one channel through a log.

    Args:
        record: the channel.
        schema: its schema, if the log holds it.
        findings: takes what is wrong.

    Attributes:
        frames: the counts of raw frames, if it has any.
        clock_steps: of the robot's clock, as the journal tells them.
    """

    def __init__(self, record: records.Channel, schema: records.Schema | None, findings: Findings) -> None:
        self.topic = record.topic
        self.clock_steps: list[ClockStep] = []
        self._encoding = record.message_encoding
        self._schema = "" if schema is None else schema.name
        self._findings = findings
        # Which of our own it is; of others nothing more is known.
        self._kind = self._schema if record.message_encoding == "protobuf" else ""
        self.frames = FrameCount() if self._kind == _CAN_FRAME else None
        self._proof = proof_of(record, schema)
        self._samples: FollowingCount | InTimeCount | None = None
        if has_sequence(self._kind):
            self._samples = InTimeCount() if self._kind in KEPT else FollowingCount()
        self._last_journal: tuple[int, bytes] | None = None
        self._messages = self._unreadable = 0
        self._ends: ChannelEnds | None = None
        self._newest = 0
        self._restarts = 0
        self._restarted_ns: int | None = None

    def take(self, content: Bytes, places: Places) -> list[int]:
        """Take messages of the channel; returns the numbers of those that are not what their schema says."""
        self._messages += len(places.offsets)
        restarts = self._take_sequences(content, places) if self._samples is not None else []
        if self._kind == _JOURNAL:
            self._look_for_clock_steps(content, places)
        elif self._kind == _RECORD_GAP:
            self._tell_gaps(content, places)
        wrong: Sequence[int] = []
        if self.frames is not None:
            wrong = self.frames.take(content, places, restarts)
        elif self._proof is not None:
            wrong = self._proof(content, places)
        self._unreadable += len(wrong)
        return list(wrong)

    def _take_sequences(self, content: Bytes, places: Places) -> list[int]:
        """Returns the numbers of raw frames before which another gateway began: it counts its batches from 0."""
        sequences = places.sequences(content).astype(np.int64)
        log_ns = places.log_ns(content)
        if isinstance(self._samples, InTimeCount):
            self._samples.take(sequences, places.publish_ns(content))
            return []
        if self._samples is not None:
            self._samples.take(sequences, log_ns)
        first = self._ends or ChannelEnds(int(sequences[0]), 0, int(log_ns[0]), 0)
        self._ends = ChannelEnds(first.first, int(sequences[-1]), first.first_ns, int(log_ns[-1]))
        if self.frames is None:
            return []
        back = -np.diff(sequences, prepend=self._newest)
        self._newest = int(sequences[-1])
        restarts: list[int] = np.flatnonzero((back > 0) & (back < SEQUENCE_SPAN // 2)).tolist()
        if restarts and self._restarted_ns is None:
            self._restarted_ns = int(log_ns[restarts[0]])
        self._restarts += len(restarts)
        return restarts

    def _look_for_clock_steps(self, content: Bytes, places: Places) -> None:
        """Hold the journal's wall times against its monotonic ones, where there is a far gap between two."""
        publish_ns = places.publish_ns(content).tolist()
        for time_ns, data in zip(publish_ns, datas(content, places), strict=True):
            last, self._last_journal = self._last_journal, (time_ns, data)
            if last is None or time_ns - last[0] <= FAR_NS or len(self.clock_steps) >= STEPS_MAX:
                continue
            passed_ns = _passed_ns(last[1], data)
            if passed_ns is not None and time_ns - last[0] - passed_ns > _AGREE_NS:
                self.clock_steps.append(ClockStep(last[0], time_ns))

    def _tell_gaps(self, content: Bytes, places: Places) -> None:
        """Add what the recorder says that it could not write."""
        for data in datas(content, places):
            try:
                gap: RecordGap = typed_decoder(RecordGap)(data)
            except UNREADABLE:
                continue
            what = f"not in the log, as its recorder says ({gap.reason.value})"
            self._findings.data(what, gap.key, gap.count, gap.first_ns)

    def sum_up(self, clock_steps: Sequence[ClockStep] = ()) -> ChannelCheck:
        """All of it, and what is missing; ``clock_steps`` are those of the robot's clock."""
        has_two_sources = self._samples is not None and self._samples.has_two_sources
        missed = None if self._samples is None else 0 if has_two_sources else self._samples.missed
        if has_two_sources:
            self._findings.data(_TWO_SOURCES, self.topic, 1, None if self._ends is None else self._ends.first_ns)
        elif missed and self._samples is not None:
            self._findings.data("samples missed, by the sequence", self.topic, missed, self._samples.first_ns)
        if self.frames is not None:
            self._sum_up_frames(self.frames, clock_steps, has_two_sources=has_two_sources)
        return ChannelCheck(
            topic=self.topic,
            schema=self._schema,
            encoding=self._encoding,
            messages=self._messages,
            is_read=self._proof is not None,
            unreadable=self._unreadable,
            missed=missed,
            ends=self._ends,
        )

    def _sum_up_frames(
        self, frames: FrameCount, clock_steps: Sequence[ClockStep], *, has_two_sources: bool
    ) -> None:
        if self._restarts and frames.counts and not has_two_sources:
            what = "times without a gateway, whose frames nobody received: another one began then"
            self._findings.data(what, self.topic, self._restarts, self._restarted_ns)
        for _, alive in sorted(frames.counts.items()):
            if has_two_sources:
                alive.forget_losses()
            if left_out := alive.leave_out(clock_steps):
                what = "steps of the robot's clock, over which whole rounds of the alive counter are not judged"
                self._findings.data(f"{alive.name}: {what}", self.topic, left_out, clock_steps[0].before_ns)
            for name, what in _FRAME_FAULTS.items():
                count = getattr(alive, name)
                if count:
                    first_ns = alive.first_ns.get("outages" if name == "unseen" else name)
                    self._findings.data(f"{alive.name}: {what}", self.topic, count, first_ns)


def _passed_ns(before: bytes, after: bytes) -> int | None:
    """Return the monotonic time between two messages of one run's journal; None if they do not give it."""
    try:
        first, second = (typed_decoder(Journal)(data) for data in (before, after))
        last_input, next_input = (msgspec.msgpack.decode(one.inputs)[-1] for one in (first, second))
        return next_input[1] - last_input[1] if first.run == second.run else None
    except (*UNREADABLE, msgspec.DecodeError):
        return None
