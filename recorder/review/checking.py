"""The parts of ``check`` that concern a channel.

- Samples that never arrived, by the gaps in their sequences; in one log, and between several.
- Raw frames lost on the way from the chassis, by their alive counters; see ``schemas.can_word``.
- The state of one channel while a log is checked.

Messages match their schema if they can be decoded: ours as columns, many at once, others one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, partial
from itertools import pairwise
from operator import attrgetter
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from mcap import records
from numpy.typing import NDArray

from gateway.chassis.layout import MessageLayout
from gateway.choice.frame_layouts import COMMON
from recorder.encoding.protobuf import LOGGED, descriptor_set, schema_name
from recorder.encoding.samples import RESTART_STEP, SEQUENCE_SPAN
from recorder.encoding.viewers import SHOWN
from recorder.mcap.arrays import Bytes, Numbers, Places
from recorder.reading.topics import UNREADABLE, foreign_decoder, means_the_same, topic_of, typed_decoder
from recorder.review.columns import LOG_TIME, Decoder, columns_of
from recorder.review.flaws import Findings
from schemas import keys
from schemas.can_word import COUNTER_SPAN, IDENTIFIER_MASK, UnseenRounds
from schemas.messages import CanFrame, GatewayInfo, RawSample
from schemas.recording import RecorderEvent, RecordGap
from schemas.subjects import SCHEMA_PREFIX, SUBJECTS

Proof = Callable[[Bytes, Places], Sequence[int]]
"""Messages of a channel to the numbers of those that do not match their schema."""

_OURS: Final = {
    **{schema_name(kind): (kind, descriptor_set(kind)) for kind in LOGGED},
    **{shown.schema_name: (None, shown.schema_data) for shown in SHOWN},
}
"""Schemas of this version: class, if it is one of ours, and schema."""

ANY_JSON: Final = msgspec.json.Decoder(msgspec.Raw).decode


def faults_of_schema(schema: records.Schema) -> list[str]:
    """The faults of a schema: it cannot be read, or differs from this version's schema of that name."""
    if schema.encoding == "protobuf" and foreign_decoder(schema.name, schema.data) is None:
        return [f"the schema {schema.name} cannot be read"]
    # MCAP allows an empty one: any JSON.
    if schema.encoding == "jsonschema" and schema.data and _undecodable([schema.data], ANY_JSON):
        return [f"the schema {schema.name} is no JSON"]
    if schema.name in _OURS:
        kind, data = _OURS[schema.name]
        is_same = schema.data == data or (kind is not None and means_the_same(kind, schema.data))
        if schema.encoding != "protobuf" or not is_same:
            return [f"the schema {schema.name} differs from this version's"]
    return []


def proof_of(channel: records.Channel, schema: records.Schema | None) -> Proof | None:
    """The proof of a channel's messages; None if they cannot be decoded."""
    if channel.message_encoding == "json":
        return lambda content, places: _undecodable(datas(content, places), ANY_JSON)
    if channel.message_encoding != "protobuf" or schema is None:
        return None
    kind, data = _OURS.get(schema.name, (None, b""))
    if kind is not None and data == schema.data:
        return partial(_unreadable, kind)
    decode = foreign_decoder(schema.name, schema.data)
    return None if decode is None else lambda content, places: _undecodable(datas(content, places), decode)


def datas(content: Bytes, places: Places) -> Iterator[bytes]:
    for start, length in zip(places.offsets.tolist(), places.lengths.tolist(), strict=True):
        yield content[start : start + length].tobytes()


def _undecodable(messages: Iterable[bytes], decode: Callable[[bytes], Any]) -> list[int]:
    wrong = []
    for number, data in enumerate(messages):
        try:
            decode(data)
        except UNREADABLE:
            wrong.append(number)
    return wrong


@cache
def _decoder(kind: type[msgspec.Struct], *names: str) -> Decoder:
    """A decoder of a class of ours, with these of its columns."""
    channel = records.Channel(0, "", "protobuf", {}, 1)
    schema = records.Schema(1, descriptor_set(kind), "protobuf", schema_name(kind))
    return Decoder(columns_of(topic_of(channel, schema)), {LOG_TIME, *names})


def _unreadable(kind: type[msgspec.Struct], content: Bytes, places: Places) -> list[int]:
    decoder = _decoder(kind)
    decoder.batch(content, places)
    return decoder.left_out


Times = NDArray[np.uint64]

_WITHOUT_SEQUENCE: Final = {schema_name(kind) for kind in (RawSample, GatewayInfo, RecorderEvent, RecordGap)}
"""A recorder numbers its own messages over all its logs, and each log has only those that concern it."""

KEPT: Final = frozenset(subject.schema_name for subject in SUBJECTS if subject.qos.kept_bytes)
"""Schemas of samples that a recorder may query later."""

BATCH_NS: Final = 1_000_000_000  # the same sequence later than this is another gateway's
RUNS_MAX: Final = 4096  # runs beyond which they are merged
RETURNS_MIN: Final = 10  # alternations of a sequence from which two sources are assumed
NEAR: Final = 16  # samples this near to each other may have changed their order


def has_sequence(schema: str) -> bool:
    """True if a gap in the sequence is a loss, by the schema's name."""
    return schema.startswith(f"{SCHEMA_PREFIX}.") and schema not in _WITHOUT_SEQUENCE


class FollowingCount:
    """Counts messages that are in order in the file; the frames of a batch share its sequence.

    Attributes:
        first_ns: log time of the message behind the first gap; None if there is none.
        returns: how often the sequence continued from before the previous sample.
    """

    def __init__(self) -> None:
        self.missed = self.returns = 0
        self.first_ns: int | None = None
        self._last: list[int] = []

    @property
    def has_two_sources(self) -> bool:
        """True if two sources alternate; their losses are unknown."""
        return self.returns >= RETURNS_MIN

    def take(self, sequences: Numbers, log_ns: Times) -> None:
        """Count the next messages."""
        joined = np.concatenate([np.array(self._last, np.int64), sequences])
        is_new = np.diff(joined, prepend=-1) != 0
        distinct = joined[is_new]
        steps = np.diff(distinct)
        if len(steps) > 1:
            goes_on = (distinct[2:] - distinct[:-2]) % SEQUENCE_SPAN == 1
            self.returns += int(np.count_nonzero(goes_on & (np.abs(steps[1:]) > NEAR)))
        gaps = (steps - 1) % SEQUENCE_SPAN
        gaps[gaps >= RESTART_STEP] = 0
        # The last two messages have been counted.
        gaps[: max(0, len(self._last) - 1)] = 0
        self.missed += int(gaps.sum())
        if self.first_ns is None and gaps.any():
            place = int(np.flatnonzero(is_new)[np.flatnonzero(gaps)[0] + 1]) - len(self._last)
            self.first_ns = int(log_ns[place])
        self._last = distinct[-2:].tolist()


class SequenceRun(msgspec.Struct):
    """Messages with successive sequences."""

    first: int
    last: int
    first_ns: int
    last_ns: int

    def join(self, other: SequenceRun) -> bool:
        """Add a run that begins no earlier. False if it neither follows this one nor is a part of it."""
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
    """Counts messages that a recorder may have queried later, so that only the publish time gives their order."""

    has_two_sources: Final = False

    def __init__(self) -> None:
        self._runs: list[SequenceRun] = []
        self._limit = RUNS_MAX

    @property
    def missed(self) -> int:
        return sum(step or 0 for _, _, step in self.gaps())

    @property
    def first_ns(self) -> int | None:
        """The time of the sample before the first gap."""
        return next((before.last_ns for before, _, step in self.gaps() if step), None)

    def take(self, sequences: Numbers, publish_ns: Times) -> None:
        """Count the next messages."""
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
        """The runs in order of time."""
        joined: list[SequenceRun] = []
        for run in sorted(self._runs, key=attrgetter("first_ns", "first")):
            if not joined or not joined[-1].join(run):
                joined.append(run)
        self._runs = joined
        return joined

    def gaps(self) -> Iterator[tuple[SequenceRun, SequenceRun, int | None]]:
        """The runs around each gap, and the number of missing sequences; None where the source restarted."""
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
        samples, topics: their numbers.
        from_ns, to_ns: log times of the last message before, and of the first one after.
    """

    robot: str
    samples: int
    topics: int
    from_ns: int
    to_ns: int
    before: str
    after: str


def between(logs: Iterable[tuple[str, dict[str, ChannelEnds]]]) -> list[Between]:
    """Find samples missing in all logs, given as path and ends of the channels by topic.

    A restart of the gateway between two logs is no loss.
    """
    by_topic: dict[str, list[tuple[ChannelEnds, str]]] = {}
    for path, ends in logs:
        for topic, one in ends.items():
            by_topic.setdefault(topic, []).append((one, path))
    found: dict[tuple[str, str, str], list[tuple[int, int, int]]] = {}
    for topic, parts in by_topic.items():
        parsed = keys.parse(topic)
        robot = f"{parsed.root}/{parsed.robot}" if parsed and parsed.robot else topic
        (before, path), *rest = sorted(parts, key=lambda part: part[0].first_ns)
        for after, next_path in rest:
            step = (after.first - before.last - 1) % SEQUENCE_SPAN
            if after.first_ns >= before.last_ns and 0 < step < RESTART_STEP:
                gap = step, before.last_ns, after.first_ns
                found.setdefault((robot, path, next_path), []).append(gap)
            # An incident's log lies within another.
            if after.last_ns > before.last_ns:
                before, path = after, next_path
    missing = [
        Between(robot, sum(steps), len(steps), min(from_ns), max(to_ns), first, second)
        for (robot, first, second), gaps in found.items()
        for steps, from_ns, to_ns in [zip(*gaps, strict=True)]
    ]
    return sorted(missing, key=lambda one: (one.from_ns, one.robot))


FRAME_BYTES: Final = 8

COUNTER_AT: Final = 6  # the byte whose upper half is the counter
FAR_NS: Final = 60_000_000_000  # a longer gap may be a step of the robot's clock

_COLUMNS: Final = ("time_ns", "identifier", "is_extended", "is_remote", "is_error", "data")


@cache
def feedback_frames() -> dict[int, MessageLayout]:
    """The chassis's periodic feedback frames by identifier; all are extended."""
    return {frame.can_id & IDENTIFIER_MASK: frame for frame in COMMON.feedback if frame.period_ns}


class FrameInfo(msgspec.Struct, frozen=True):
    """Raw frames of one identifier; see ``AliveCount``."""

    topic: str
    identifier: str
    name: str
    frames: int
    lost: int
    repeated: int
    corrupt: int
    outages: int
    unseen: int


class AliveCount:
    """Follows the alive counter of one identifier.

    Attributes:
        corrupt: frames with a wrong checksum; their counter is not read, and they are not lost.
        outages: gaps in time in which the counter may have wrapped, and steps back of the clock.
        unseen: frames lost in outages by whole wraps of the counter, 16 each; not counted beyond FAR_NS.
        first_ns: time of the first of each count, by its name.
    """

    def __init__(self, frame: MessageLayout) -> None:
        self.name = frame.name
        self.frames = self.lost = self.repeated = self.corrupt = self.outages = 0
        self.first_ns: dict[str, int] = {}
        self._period_ns = frame.period_ns
        self._rounds = UnseenRounds(frame.period_ns)
        self._counter = 0
        self._time_ns = 0
        self._is_first = True

    @property
    def unseen(self) -> int:
        """As above, including outages that are not over."""
        return self._rounds.lost_so_far

    def forget_losses(self) -> None:
        """Reset the losses: with two sources they are unknown."""
        self.lost = self.repeated = self.outages = 0
        self._rounds = UnseenRounds(self._period_ns)

    def restart(self) -> None:
        """Note a restart of the gateway: the frames between were not lost on the way."""
        self._rounds.judge()
        self._is_first = True

    def receive(self, times_ns: Numbers, frames: NDArray[np.uint8]) -> None:
        """Count the next frames: times of receipt, and eight bytes each."""
        is_corrupt = np.bitwise_xor.reduce(frames, axis=1) != 0
        counters = frames[:, COUNTER_AT] >> 4
        gaps_ns = np.diff(times_ns, prepend=self._time_ns)
        steps = np.diff(counters, prepend=np.uint8(self._counter)) % COUNTER_SPAN
        is_regular = not (self._is_first or self._rounds.is_waiting or is_corrupt.any())
        if is_regular and gaps_ns.min() >= 0 and gaps_ns.max() < self._rounds.window_ns and (steps == 1).all():
            self.frames += len(counters)
            self._counter, self._time_ns = int(counters[-1]), int(times_ns[-1])
            return
        for time_ns, counter, corrupt in zip(
            times_ns.tolist(), counters.tolist(), is_corrupt.tolist(), strict=True
        ):
            self._count(time_ns, counter, is_corrupt=corrupt)

    def _count(self, time_ns: int, counter: int, *, is_corrupt: bool) -> None:
        self.frames += 1
        if is_corrupt:
            self.corrupt += 1
            self.first_ns.setdefault("corrupt", time_ns)
            counter = (self._counter + 1) % COUNTER_SPAN
        if not self._is_first:
            self._follow(time_ns, time_ns - self._time_ns, (counter - self._counter) % COUNTER_SPAN)
        self._is_first = False
        self._counter, self._time_ns = counter, time_ns

    def _follow(self, time_ns: int, elapsed_ns: int, steps: int) -> None:
        is_outage = not 0 <= elapsed_ns < self._rounds.window_ns
        if is_outage:
            self.outages += 1
            self.first_ns.setdefault("outages", time_ns)
            steps = steps or COUNTER_SPAN
        if not steps:
            self.repeated += 1
            self.first_ns.setdefault("repeated", time_ns)
        elif steps > 1 and elapsed_ns >= 0:
            self.lost += steps - 1
            self.first_ns.setdefault("lost", time_ns)
        if elapsed_ns > FAR_NS:
            self._rounds.judge()
        elif is_outage or self._rounds.is_waiting:
            self._rounds.follow(time_ns, elapsed_ns, steps)


class FrameCount:
    """Follows the alive counters of all identifiers of one channel of raw frames."""

    def __init__(self) -> None:
        self.counts: dict[int, AliveCount] = {}

    def take(self, content: Bytes, places: Places, restarts: Sequence[int] = ()) -> list[int]:
        """Take the next messages of the channel. Returns the numbers of those that are no frames."""
        decoder = _decoder(CanFrame, *_COLUMNS)
        batch = decoder.batch(content, places)
        numbers = np.delete(np.arange(len(places.offsets)), decoder.left_out)
        times_ns, identifiers, *kinds = (
            batch.column(name).to_numpy(zero_copy_only=False) for name in _COLUMNS[:-1]
        )
        data, is_remote, is_error = batch.column("data"), *kinds[1:]
        counts = kinds[0] & ~is_remote & ~is_error & (pc.binary_length(data).to_numpy() == FRAME_BYTES)
        joined = b"".join(data.filter(pa.array(counts)).to_pylist())
        frames = np.frombuffer(joined, np.uint8).reshape(-1, FRAME_BYTES)
        numbers, times_ns, identifiers = numbers[counts], times_ns[counts], identifiers[counts]
        bounds = [0, *np.searchsorted(numbers, restarts).tolist(), len(numbers)]
        for run, (first, behind) in enumerate(pairwise(bounds)):
            for count in self.counts.values() if run else ():
                count.restart()
            part = slice(first, behind)
            for identifier in np.unique(identifiers[part]).tolist():
                if identifier not in feedback_frames():
                    continue
                if identifier not in self.counts:
                    self.counts[identifier] = AliveCount(feedback_frames()[identifier])
                same = identifiers[part] == identifier
                self.counts[identifier].receive(times_ns[part][same], frames[part][same])
        return decoder.left_out

    def info(self, topic: str) -> list[FrameInfo]:
        names = FrameInfo.__struct_fields__[2:]
        return [
            FrameInfo(topic, f"0x{identifier:08X}", *(getattr(count, name) for name in names))
            for identifier, count in sorted(self.counts.items())
        ]


_CAN_FRAME: Final = schema_name(CanFrame)
_RECORD_GAP: Final = schema_name(RecordGap)

_TWO_SOURCES: Final = "two gateways publish under one name: their losses are unknown"

_FRAME_FAULTS: Final = {
    "lost": "frames lost, by the alive counter",
    "repeated": "frames with a repeated alive counter",
    "corrupt": "frames with a wrong checksum",
    "outages": "gaps in time in which the alive counter may have wrapped, or steps back of the clock",
    "unseen": "frames lost in these by whole wraps of the alive counter, by the period",
}


class ChannelCheck(msgspec.Struct, frozen=True):
    """A channel.

    Attributes:
        is_read: its messages were compared with its schema; not for unknown encodings.
        missed: samples that never arrived, by the gaps in ``sequence``; None if gaps are no losses.
        ends: its first and last message; None if gaps are no losses, or messages may have been queried later.
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
    """Follows one channel through a log."""

    def __init__(self, record: records.Channel, schema: records.Schema | None, findings: Findings) -> None:
        self.topic = record.topic
        self._encoding = record.message_encoding
        self._schema = "" if schema is None else schema.name
        self._findings = findings
        # The schema, if it is one of ours.
        self._kind = self._schema if record.message_encoding == "protobuf" else ""
        self.frames = FrameCount() if self._kind == _CAN_FRAME else None
        self._proof = proof_of(record, schema)
        self._samples: FollowingCount | InTimeCount | None = None
        if has_sequence(self._kind):
            self._samples = InTimeCount() if self._kind in KEPT else FollowingCount()
        self._messages = self._unreadable = 0
        self._ends: ChannelEnds | None = None
        self._newest = 0
        self._restarts = 0
        self._restarted_ns: int | None = None

    def take(self, content: Bytes, places: Places) -> list[int]:
        """Take messages of the channel. Returns the numbers of those that do not match their schema."""
        self._messages += len(places.offsets)
        restarts = self._take_sequences(content, places) if self._samples is not None else []
        if self._kind == _RECORD_GAP:
            self._tell_gaps(content, places)
        wrong: Sequence[int] = []
        if self.frames is not None:
            wrong = self.frames.take(content, places, restarts)
        elif self._proof is not None:
            wrong = self._proof(content, places)
        self._unreadable += len(wrong)
        return list(wrong)

    def _take_sequences(self, content: Bytes, places: Places) -> list[int]:
        """Returns the numbers of raw frames at which a gateway restarted: it counts its batches from 0."""
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

    def _tell_gaps(self, content: Bytes, places: Places) -> None:
        """Add the losses reported by the recorder."""
        for data in datas(content, places):
            try:
                gap: RecordGap = typed_decoder(RecordGap)(data)
            except UNREADABLE:
                continue
            what = f"lost by the recorder ({gap.reason.value})"
            self._findings.data(what, gap.key, gap.count, gap.first_ns)

    def sum_up(self) -> ChannelCheck:
        """Sum up the channel, and add its losses to the findings."""
        has_two_sources = self._samples is not None and self._samples.has_two_sources
        missed = None if self._samples is None else 0 if has_two_sources else self._samples.missed
        if has_two_sources:
            self._findings.data(_TWO_SOURCES, self.topic, 1, None if self._ends is None else self._ends.first_ns)
        elif missed and self._samples is not None:
            self._findings.data("samples missed, by the sequence", self.topic, missed, self._samples.first_ns)
        if self.frames is not None:
            self._sum_up_frames(self.frames, has_two_sources=has_two_sources)
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

    def _sum_up_frames(self, frames: FrameCount, *, has_two_sources: bool) -> None:
        if self._restarts and frames.counts and not has_two_sources:
            what = "restarts of the gateway: the frames between were not received"
            self._findings.data(what, self.topic, self._restarts, self._restarted_ns)
        for _, alive in sorted(frames.counts.items()):
            if has_two_sources:
                alive.forget_losses()
            for name, what in _FRAME_FAULTS.items():
                count = getattr(alive, name)
                if count:
                    first_ns = alive.first_ns.get("outages" if name == "unseen" else name)
                    self._findings.data(f"{alive.name}: {what}", self.topic, count, first_ns)
