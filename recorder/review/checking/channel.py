"""The state of one channel while a log is checked.

Messages wait until many of them can be judged at once: most of what that costs does not depend on how many.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

import msgspec
from mcap import records

from recorder.encoding.key_counters import SEQUENCE_SPAN
from recorder.encoding.protobuf_schema import schema_name
from recorder.mcap.columns import ChannelMessages
from recorder.reading.topics import UNREADABLE, typed_decoder
from recorder.review.checking.alive import FAR_NS, ClockStep
from recorder.review.checking.between import ChannelEnds
from recorder.review.checking.findings import Findings
from recorder.review.checking.frames import FrameCount
from recorder.review.checking.proofs import Proof, proof_of
from recorder.review.checking.sequences import KEPT, sequence_count
from schemas.decisions import Journal
from schemas.messages import CanFrame
from schemas.recording import RecordGap

WAITING_MAX: Final = 1024
"""Messages of a channel that wait at most, but for the rest of their chunk."""

_CAN_FRAME: Final = schema_name(CanFrame)
_JOURNAL: Final = schema_name(Journal)
_RECORD_GAP: Final = schema_name(RecordGap)

_AGREE_NS: Final = 1_000_000_000
"""Times that differ by no more agree: a journal is published some milliseconds after what stands in it."""

STEPS_MAX: Final = 1000
"""Steps of the clock that are remembered."""

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
    """

    def __init__(self, record: records.Channel, schema: records.Schema | None, findings: Findings) -> None:
        self.topic = record.topic
        self._encoding = record.message_encoding
        self._schema = "" if schema is None else schema.name
        self._findings = findings
        is_protobuf = record.message_encoding == "protobuf"
        self.frames = FrameCount() if is_protobuf and self._schema == _CAN_FRAME else None
        self._proof: Proof | None = self.frames.take if self.frames else proof_of(record, schema)
        self._sequence = sequence_count(self._schema) if is_protobuf else None
        self._is_journal = is_protobuf and self._schema == _JOURNAL
        self._last_journal: tuple[int, bytes] | None = None
        self.clock_steps: list[ClockStep] = []
        self._is_gaps = is_protobuf and self._schema == _RECORD_GAP
        self._messages = self._unreadable = 0
        self._ends: ChannelEnds | None = None
        self._newest = 0
        self._begun_anew = 0
        self._begun_anew_ns: int | None = None
        self._sequences: list[int] = []
        self._publish_ns: list[int] = []
        self._log_ns: list[int] = []
        self._datas: list[bytes] = []
        # Where in the file the chunk is that a message has come from, by its place among those that wait.
        self._offsets: list[tuple[int, int]] = []

    def take(self, messages: ChannelMessages, offset: int) -> None:
        """Messages of the channel, of the chunk at this offset."""
        self._messages += len(messages.starts)
        if self._sequence is not None:
            self._sequences += messages.sequences
            self._publish_ns += messages.publish_ns
            self._log_ns += messages.log_ns
        if self._is_journal:
            self._look_for_clock_steps(messages)
        if self._proof is not None:
            self._offsets.append((len(self._datas), offset))
            self._datas += messages.datas
        if len(self._sequences) >= WAITING_MAX or len(self._datas) >= WAITING_MAX:
            self.judge()

    def judge(self) -> None:
        """Judge the messages that wait."""
        # Of raw frames as many sequences wait as there are data.
        anew = self._look_for_other_gateways() if self.frames else []
        if self._sequence is not None and self._sequences:
            self._sequence.take(self._sequences, self._publish_ns, self._log_ns)
            self._note_ends()
            self._sequences, self._publish_ns, self._log_ns = [], [], []
        if self._proof is not None and self._datas:
            for place in self._proven(self._proof, anew):
                self._unreadable += 1
                offset = max(one for one in self._offsets if one[0] <= place)[1]
                self._findings.file("messages are not what their schema says", offset, topic=self.topic)
            if self._is_gaps:
                self._tell_gaps()
            self._datas, self._offsets = [], []

    def _note_ends(self) -> None:
        if self._schema in KEPT:
            return
        first = self._ends or ChannelEnds(self._sequences[0], 0, self._log_ns[0], 0)
        self._ends = msgspec.structs.replace(first, last=self._sequences[-1], last_ns=self._log_ns[-1])

    def _look_for_clock_steps(self, messages: ChannelMessages) -> None:
        """Hold the journal's wall times against its monotonic ones, where there is a far gap between two."""
        for publish_ns, data in zip(messages.publish_ns, messages.datas, strict=True):
            last, self._last_journal = self._last_journal, (publish_ns, data)
            if last is None or publish_ns - last[0] <= FAR_NS or len(self.clock_steps) >= STEPS_MAX:
                continue
            passed_ns = _passed_ns(last[1], data)
            if passed_ns is not None and publish_ns - last[0] - passed_ns > _AGREE_NS:
                self.clock_steps.append(ClockStep(last[0], publish_ns))

    def sum_up(self, clock_steps: Sequence[ClockStep] = ()) -> ChannelCheck:
        """All of it, and what is missing; ``clock_steps`` are those of the robot's clock."""
        self.judge()
        missed, missed_ns = (None, None) if self._sequence is None else self._sequence.missed()
        if missed:
            self._findings.data("samples missed, by the sequence", self.topic, missed, missed_ns)
        if self._begun_anew and self.frames and any(self.frames.counts):
            what = "times without a gateway, whose frames nobody received: another one began then"
            self._findings.data(what, self.topic, self._begun_anew, self._begun_anew_ns)
        for _, alive in self.frames.counts if self.frames else ():
            if left_out := alive.leave_out(clock_steps):
                what = "steps of the robot's clock, over which whole rounds of the alive counter are not judged"
                self._findings.data(f"{alive.name}: {what}", self.topic, left_out, clock_steps[0].before_ns)
            for name, what in _FRAME_FAULTS.items():
                count = getattr(alive, name)
                if count:
                    first_ns = alive.first_ns.get("outages" if name == "unseen" else name)
                    self._findings.data(f"{alive.name}: {what}", self.topic, count, first_ns)
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

    def _look_for_other_gateways(self) -> list[int]:
        """Before which of the frames that wait another gateway began: it counts its batches from 0."""
        sequences, before = self._sequences, self._newest
        if not sequences:
            return []
        self._newest = sequences[-1]
        if sequences[0] >= before and sequences == sorted(sequences):
            return []
        steps = enumerate(pairwise([before, *sequences]))
        places = [place for place, (was, now) in steps if 0 < was - now < SEQUENCE_SPAN // 2]
        if places and self._begun_anew_ns is None:
            self._begun_anew_ns = self._log_ns[places[0]]
        self._begun_anew += len(places)
        return places

    def _proven(self, proof: Proof, anew: Sequence[int]) -> Iterator[int]:
        """The places of data that are not what their schema says."""
        for start, end in pairwise([0, *anew, len(self._datas)]):
            if start in anew and self.frames:
                self.frames.begin_anew()
            if start < end:
                yield from (start + place for place in proof(self._datas[start:end] if anew else self._datas))

    def _tell_gaps(self) -> None:
        """Add what the recorder says that it could not write."""
        for data in self._datas:
            try:
                gap: RecordGap = typed_decoder(RecordGap)(data)
            except UNREADABLE:
                continue
            what = f"not in the log, as its recorder says ({gap.reason.value})"
            self._findings.data(what, gap.key, gap.count, gap.first_ns)


def _passed_ns(before: bytes, after: bytes) -> int | None:
    """Return the monotonic time between two messages of one run's journal; None if they do not give it."""
    try:
        first, second = (typed_decoder(Journal)(data) for data in (before, after))
        last_input, next_input = (msgspec.msgpack.decode(one.inputs)[-1] for one in (first, second))
        return next_input[1] - last_input[1] if first.run == second.run else None
    except (*UNREADABLE, msgspec.DecodeError):
        return None
