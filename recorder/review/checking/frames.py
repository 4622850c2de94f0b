"""Raw frames lost on the way from the chassis, by their alive counters; see ``schemas.can_word``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from itertools import pairwise
from operator import xor
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from gateway.chassis.cruiser.frames import load
from gateway.chassis.layout import MessageLayout
from recorder.encoding.transcode import compile_encoder
from recorder.mcap.arrays import Bytes, Numbers, Places
from recorder.reading.topics import UNREADABLE, typed_decoder
from recorder.review.checking.messages import Layout, datas, layout_of
from schemas.can_word import COUNTER_SPAN, IDENTIFIER_MASK, UnseenRounds
from schemas.messages import CanFrame, Variant

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
    return {frame.can_id & IDENTIFIER_MASK: frame for frame in load(Variant.COARSE).feedback if frame.period_ns}


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
