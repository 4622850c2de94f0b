"""The parts of ``check``: each proves one thing of a channel.

- Samples that never came, by the gaps in the sequences of their messages; in one log, and between several.
- Raw frames lost on the way from the chassis, by their alive counters; see ``schemas.can_word``.
- The state of one channel while a log is checked.

The proof that messages are what their schema says.

Most of ours have but fields of fixed width, so all bytes but the values themselves are known beforehand: they are
compared for many messages at once. Where that leaves a doubt, and for all other messages, each is decoded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, reduce
from itertools import pairwise
from operator import attrgetter, xor
from struct import calcsize
from typing import Any, Final

import msgspec
import numpy as np
from mcap import records
from msgspec import inspect
from numpy.typing import NDArray

from gateway.chassis.layout import MessageLayout
from gateway.choice import CHASSIS
from recorder.encoding.protobuf import (
    LOGGED,
    compile_encoder,
    descriptor_set,
    fields,
    message_class,
    packed_fields,
    schema_name,
)
from recorder.encoding.samples import RESTART_STEP, SCHEMA_DATA, SCHEMA_NAME, SEQUENCE_SPAN
from recorder.mcap.arrays import Bytes, Numbers, Places
from recorder.reading.topics import UNREADABLE, foreign_decoder, means_the_same, typed_decoder
from recorder.review.flaws import Findings
from schemas import keys
from schemas.can_word import COUNTER_SPAN, IDENTIFIER_MASK, UnseenRounds
from schemas.decisions import Journal
from schemas.messages import CanFrame, GatewayInfo, RawSample
from schemas.recording import RecorderEvent, RecordGap
from schemas.subjects import SCHEMA_PREFIX, SUBJECTS

Proof = Callable[[Bytes, Places], Sequence[int]]
"""Messages of a channel to the numbers of those that are not what their schema says."""

_OURS: Final = {
    **{schema_name(kind): (kind, descriptor_set(kind)) for kind in LOGGED},
    SCHEMA_NAME: (None, SCHEMA_DATA),
}
"""Schemas that this version writes: class, if it is one of ours, and schema."""

_FIXED_WIDTH: Final = inspect.IntType | inspect.FloatType | inspect.BoolType | inspect.EnumType
_NUMBERS: Final = frozenset("IiQqd")
_VARINT_BOUND: Final = 0x80

ANY_JSON: Final = msgspec.json.Decoder(msgspec.Raw).decode


class Layout(msgspec.Struct, frozen=True):
    """Records of a class that differ in the values of fields of fixed width, and in a tail, alone.

    Attributes:
        length: of every record.
        fixed_at, fixed: place and value of each byte that all have in common.
        bounds_at, bounds: place of each flag and enumeration, and what it is below.
        row: the fields of fixed width, by name, and ``tail``, if there is one.
    """

    length: int
    fixed_at: list[int]
    fixed: NDArray[np.uint8]
    bounds_at: list[int]
    bounds: NDArray[np.uint8]
    row: np.dtype[Any]

    def rows(self, content: Bytes, places: Places) -> tuple[NDArray[np.bool_], NDArray[Any]]:
        """Which messages are surely such records, and the fields of these; others may be good too."""
        fits = places.lengths == self.length
        if not fits.any():
            return fits, np.empty(0, self.row)
        rows = np.lib.stride_tricks.sliding_window_view(content, self.length)[places.offsets[fits]]
        good = (rows[:, self.fixed_at] == self.fixed).all(axis=1)
        good &= (rows[:, self.bounds_at] < self.bounds).all(axis=1)
        fits[fits] = good
        return fits, (rows if good.all() else rows[good]).view(self.row)[:, 0]


def layout_of(kind: type[msgspec.Struct], record: bytes = b"", tail: int = 0) -> Layout | None:
    """The layout of a class's records; None if they may have any length, and no record is given.

    Args:
        kind: the class.
        record: one of those that the layout is of...
        tail: ...and how many bytes at its end may have any value.
    """
    packed = packed_fields(kind, {}, "")
    if packed.parts and not record:
        return None
    at = 0
    fixed: dict[int, int] = {}
    bounds: dict[int, int] = {}
    row: list[tuple[str, str, int]] = []
    forms = zip(packed.layout[::2], packed.layout[1::2], packed.arguments, strict=True)
    of_fixed_width = [(name, field) for name, _, field in fields(kind) if isinstance(field, _FIXED_WIDTH)]
    for (name, field), (tag_form, form, argument) in zip(of_fixed_width, forms, strict=True):
        tag, width = int(argument.partition(",")[0]), calcsize(f"<{tag_form}")
        fixed.update((at + byte, tag >> 8 * byte & 0xFF) for byte in range(width))
        at += width
        if form not in _NUMBERS:
            bounds[at] = len(field.cls) if isinstance(field, inspect.EnumType) else _VARINT_BOUND
        row.append((name, f"<{form}", at))
        at += calcsize(f"<{form}")
    end = max(at, len(record))
    fixed.update((place, record[place]) for place in range(at, end - tail))
    if tail:
        row.append(("tail", f"{tail}u1", end - tail))
    names, formats, offsets = (list(column) for column in zip(*row, strict=True))
    return Layout(
        length=end,
        fixed_at=list(fixed),
        fixed=np.array(list(fixed.values()), np.uint8),
        bounds_at=list(bounds),
        bounds=np.array(list(bounds.values()), np.uint8),
        row=np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end}),
    )


def faults_of_schema(schema: records.Schema) -> list[str]:
    """The faults of a schema: it cannot be read, or is another than this version writes under that name."""
    if schema.encoding == "protobuf" and foreign_decoder(schema.name, schema.data) is None:
        return [f"the schema {schema.name} cannot be read"]
    # MCAP allows an empty one: any JSON.
    if schema.encoding == "jsonschema" and schema.data and _undecodable([schema.data], ANY_JSON):
        return [f"the schema {schema.name} is no JSON"]
    if schema.name in _OURS:
        kind, data = _OURS[schema.name]
        is_same = schema.data == data or (kind is not None and means_the_same(kind, schema.data))
        if schema.encoding != "protobuf" or not is_same:
            return [f"the schema {schema.name} is not the one that this version writes"]
    return []


def proof_of(channel: records.Channel, schema: records.Schema | None) -> Proof | None:
    """The proof of a channel's messages; None if nobody here can read them."""
    if channel.message_encoding == "json":
        return lambda content, places: _undecodable(datas(content, places), ANY_JSON)
    if channel.message_encoding != "protobuf" or schema is None:
        return None
    kind, data = _OURS.get(schema.name, (None, b""))
    if kind is not None and data == schema.data:
        return _own_proof(kind)
    decode = foreign_decoder(schema.name, schema.data)
    return None if decode is None else lambda content, places: _undecodable(datas(content, places), decode)


def datas(content: Bytes, places: Places) -> Iterator[bytes]:
    """The data of each message."""
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
def _own_proof(kind: type[msgspec.Struct]) -> Proof:
    decode: Any = message_class(kind).FromString
    layout = layout_of(kind)
    if layout is None:
        return lambda content, places: _undecodable(datas(content, places), decode)

    def proof(content: Bytes, places: Places) -> Sequence[int]:
        fits, _ = layout.rows(content, places)
        doubtful = np.flatnonzero(~fits)
        wrong = _undecodable(datas(content, places.only(doubtful)), decode)
        found: list[int] = doubtful[wrong].tolist()
        return found

    return proof


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


FRAME_BYTES: Final = 8

COUNTER_AT: Final = 6
"""The byte whose upper half is the counter."""

FAR_NS: Final = 60_000_000_000
"""A gap of this length may be a step of the robot's clock."""

FAR_MAX: Final = 1000
"""Such gaps that are remembered; further ones count as gaps."""

LAYOUTS_MAX: Final = 64
"""Layouts of frames that are remembered, by their length."""

_FRAME: Final = np.dtype(
    [("number", "<i8"), ("time_ns", "<i8"), ("identifier", "<i8"), ("data", "u1", FRAME_BYTES)]
)
"""A frame, and the number of its message."""

_DECODE: Final = typed_decoder(CanFrame)
_ENCODE: Final = compile_encoder(CanFrame)


@cache
def feedback_frames() -> dict[int, MessageLayout]:
    """The chassis's periodic feedback frames by identifier; all are extended."""
    # Either variant would do: both have the same frames and cycle times.
    return {frame.can_id & IDENTIFIER_MASK: frame for frame in CHASSIS.common.feedback if frame.period_ns}


class ClockStep(msgspec.Struct, frozen=True):
    """The robot's wall clock was set between these two of its times."""

    before_ns: int
    after_ns: int

    def is_between(self, before_ns: int, after_ns: int) -> bool:
        """Report whether it may be what lies between two times of the same clock."""
        return max(before_ns, self.before_ns) < min(after_ns, self.after_ns)


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
        frames: frames seen.
        lost: frames that the counter passed over.
        repeated: frames with the counter of the one before.
        corrupt: frames with a wrong checksum; their counter is not read, and they are not lost.
        outages: gaps in time in which the counter may have gone round, and steps back of the clock.
        unseen: frames lost in outages beyond those that the counter passed over: 16 for each time that it went
            round. Not those of outages that are left out.
        first_ns: when each of these was seen for the first time, by the name of the count.
    """

    def __init__(self, frame: MessageLayout) -> None:
        self.name = frame.name
        self.frames = self.lost = self.repeated = self.corrupt = self.outages = 0
        self.first_ns: dict[str, int] = {}
        self._period_ns = frame.period_ns
        self._rounds = UnseenRounds(frame.period_ns)
        self._unseen_before = 0
        # Of each far gap the times of the frames around it, and the judgement of it alone.
        self._far: list[tuple[int, int, UnseenRounds]] = []
        self._counter = 0
        self._time_ns = 0
        self._is_first = True

    @property
    def unseen(self) -> int:
        """As above; what is not judged yet counts by what has come so far."""
        return self._unseen_before + self._rounds.lost_so_far

    def leave_out(self, steps: Sequence[ClockStep]) -> int:
        """Take what seemed lost over steps of the robot's clock out of ``unseen``. Returns how many gaps."""
        gaps = [one for one in self._far if any(step.is_between(one[0], one[1]) for step in steps)]
        self._far = [one for one in self._far if one not in gaps]
        self._unseen_before -= sum(rounds.lost_so_far for _, _, rounds in gaps)
        return len(gaps)

    def forget_losses(self) -> None:
        """Frames of two sources stand among each other: how many are missing is not known."""
        self.lost = self.repeated = self.outages = self._unseen_before = 0
        self._rounds = UnseenRounds(self._period_ns)

    def restart(self) -> None:
        """Another gateway receives the frames from here on: what came between the two was not lost on the way."""
        self._rounds.judge()
        self._is_first = True

    def receive(self, time_ns: int, data: bytes) -> None:
        """The next frame: when it was received, and its eight bytes."""
        self._count(time_ns, data[COUNTER_AT] >> 4, is_corrupt=reduce(xor, data) != 0)

    def receive_many(self, times_ns: Numbers, frames: NDArray[np.uint8]) -> None:
        """The next frames: when they were received, and the eight bytes of each."""
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
        is_far = is_outage and elapsed_ns > FAR_NS and len(self._far) < FAR_MAX
        if is_far or (is_outage and self._far and self._rounds is self._far[-1][2]):
            # The frames from here on are judged by themselves.
            self._unseen_before += self._rounds.lost_so_far
            self._rounds = UnseenRounds(self._period_ns)
        if is_far:
            self._far.append((self._time_ns, time_ns, self._rounds))
        if is_outage or self._rounds.is_waiting:
            self._rounds.follow(time_ns, elapsed_ns, steps)


class FrameCount:
    """Follows the alive counters of all identifiers of one channel of raw frames.

    Attributes:
        counts: of each identifier that was seen.
    """

    def __init__(self) -> None:
        self.counts: dict[int, AliveCount] = {}
        self._layouts: dict[int, Layout | None] = {}

    def take(self, content: Bytes, places: Places, restarts: Sequence[int] = ()) -> list[int]:
        """Take messages of the channel that follow each other. Returns the numbers of those that are no frames.

        Args:
            content: the records.
            places: of the messages.
            restarts: numbers of messages before which another gateway began.
        """
        frames, wrong = self._read(content, places)
        bounds = [0, *np.searchsorted(frames["number"], restarts).tolist(), len(frames)]
        for run, (first, behind) in enumerate(pairwise(bounds)):
            for count in self.counts.values() if run else ():
                count.restart()
            part = frames[first:behind]
            for identifier in np.unique(part["identifier"]).tolist():
                if identifier not in feedback_frames():
                    continue
                if identifier not in self.counts:
                    self.counts[identifier] = AliveCount(feedback_frames()[identifier])
                same = part[part["identifier"] == identifier]
                self.counts[identifier].receive_many(same["time_ns"], same["data"])
        return wrong

    def info(self, topic: str) -> list[FrameInfo]:
        """All counts; the channel's topic is theirs."""
        names = FrameInfo.__struct_fields__[2:]
        return [
            FrameInfo(topic, f"0x{identifier:08X}", *(getattr(count, name) for name in names))
            for identifier, count in sorted(self.counts.items())
        ]

    def _read(self, content: Bytes, places: Places) -> tuple[NDArray[Any], list[int]]:
        """Return what may be feedback frames, and the numbers of messages that are no frames."""
        parts, wrong, others = [np.empty(0, _FRAME)], [], []
        for length in np.unique(places.lengths).tolist():
            numbers = np.flatnonzero(places.lengths == length)
            layout = self._layout_of(content, places.only(numbers[:1]))
            if layout is None:
                others += numbers.tolist()
                continue
            fits, rows = layout.rows(content, places.only(numbers))
            others += numbers[~fits].tolist()
            if "tail" in (layout.row.names or ()) and rows["tail"].shape[1:] == (FRAME_BYTES,):
                counts = (rows["is_extended"] == 1) & (rows["is_remote"] == 0) & (rows["is_error"] == 0)
                parts.append(np.empty(np.count_nonzero(counts), _FRAME))
                columns = (numbers[fits], rows["time_ns"], rows["identifier"], rows["tail"])
                for name, column in zip(_FRAME.names or (), columns, strict=True):
                    parts[-1][name] = column[counts]
        for number, data in zip(others, datas(content, places.only(np.array(others, np.int64))), strict=True):
            try:
                frame: CanFrame = _DECODE(data)
            except UNREADABLE:
                wrong.append(number)
                continue
            if frame.is_extended and not frame.is_remote and not frame.is_error and len(frame.data) == FRAME_BYTES:
                row = number, frame.time_ns, frame.identifier, np.frombuffer(frame.data, np.uint8)
                parts.append(np.array([row], _FRAME))
        return np.sort(np.concatenate(parts), order="number"), sorted(wrong)

    def _layout_of(self, content: Bytes, first: Places) -> Layout | None:
        """The layout of records of this length, by the first of these if they are not as those before."""
        length = int(first.lengths[0])
        layout = self._layouts.get(length)
        if layout is None or not layout.rows(content, first)[0].all():
            [record] = datas(content, first)
            try:
                frame: CanFrame = _DECODE(record)
            except UNREADABLE:
                return None
            if _ENCODE(frame) != record:
                return None
            if len(self._layouts) >= LAYOUTS_MAX:
                self._layouts.clear()
            layout = self._layouts[length] = layout_of(CanFrame, record, len(frame.data))
        return layout


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
