"""The seconds of a robot's logs around a moment, and the links that explain it."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from enum import Enum
from functools import reduce
from itertools import pairwise
from operator import xor
from typing import Any, Final, Generic, TypeVar

import msgspec

from gateway.chassis.layout import MessageLayout
from gateway.choice import frame_layouts
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import END_OF_TIME_NS, Row, Selection, read_rows
from recorder.reading.survey import settings_from
from recorder.reading.topics import UNREADABLE
from recorder.review.entries import NEAR_NS
from schemas import keys
from schemas.can_word import ERROR, EXTENDED, IDENTIFIER_MASK, REMOTE
from schemas.command_line import CommandError
from schemas.decisions import (
    COMMANDING,
    ArbiterState,
    Decision,
    EventKind,
    Journal,
    SafetyEvent,
    SafetyState,
    is_same_run,
)
from schemas.journal import Kind
from schemas.messages import (
    Body,
    Drive,
    GatewayHealth,
    Gear,
    Message,
    Parking,
    RobotState,
    Steering,
    TimeNs,
    Variant,
    WheelSpeed,
)
from schemas.recording import RecordGap
from schemas.settings import SAFETY_STATE_PERIOD_NS, SILENCE_MIN_NS, SILENCE_PERIODS, TICK_NS, CommandSettings


class Step(Enum):
    """The kind of a link: a fact, a cause, a reaction, or a gap in the log."""

    MOTION = "motion"
    ARBITER = "arbiter"
    COMMAND = "command"
    CAUSE = "cause"
    EVIDENCE = "evidence"
    ACTION = "action"
    LATCH = "latch"
    CURE = "cure"
    MISSING = "missing"


class Link(msgspec.Struct, frozen=True):
    """A sentence of an explanation; ``data`` are its numbers, with units in their names."""

    step: Step
    text: str
    time_ns: TimeNs | None = None
    data: dict[str, Any] = {}


def evidence(text: str, time_ns: int | None = None, **data: object) -> Link:
    return Link(Step.EVIDENCE, text, time_ns, data)


def missing(what: str) -> Link:
    return Link(Step.MISSING, f"not in the log: {what}")


def span(ns: float) -> str:
    """A length of time for people: ``12.3 ms``, ``310 ms``, ``2.35 s``, ``12 min 5 s``, ``3 h 20 min``."""
    ms = abs(ns) / 1e6
    if ms < 999.5:
        return f"{ms:.1f} ms" if ms < 99.95 else f"{ms:.0f} ms"
    if ms < 119_995:
        return f"{ms / 1e3:.2f} s"
    minutes, seconds = divmod(round(ms / 1e3), 60)
    return f"{minutes} min {seconds} s" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


def before(time_ns: int, at_ns: int, what: str = "that moment") -> str:
    """``12.3 ms before that moment``, or after it."""
    if time_ns == at_ns:
        return f"at {what}"
    return f"{span(at_ns - time_ns)} {'before' if time_ns < at_ns else 'after'} {what}"


def deg(angle_deg: float) -> str:
    return f"{round(angle_deg, 1) + 0.0:.1f} deg"


def mps(speed_mps: float) -> str:
    """A signed speed, without a minus before zero."""
    return f"{round(speed_mps, 2) + 0.0:.2f} m/s"


def counted(number: int, one: str) -> str:
    return f"{number} {one}{'' if number == 1 else 's'}"


BEFORE_NS: Final = 12_000_000_000  # length of the window before its moment: a little more than the longest lease

AFTER_NS: Final = 9_000_000_000
"""Length of the window after its moment: the longest stop takes 7 s, then hold and silence follow."""

LATER_NS: Final = 900_000_000_000
"""Decisions that the recorder queried afterwards are searched for this long after the moment."""

KEPT: Final = 5_000  # limit of messages of each class, and of frames of each identifier; the oldest are dropped
REACH_NS: Final = 5_000_000_000  # if a frame seems to have waited longer, the adapter has another clock
LINK_NS: Final = 1_500_000_000  # longest usual time between publication and receipt
STALL_NS: Final = 2_000_000_000  # the longest delay of a sample that a link still delivers

_TICKS_NEAR: Final = 500

Said = TypeVar("Said", bound=Message)


class Heard(msgspec.Struct, Generic[Said], frozen=True):
    """A message and its time."""

    time_ns: int
    said: Said


class DecodedFrame(msgspec.Struct, frozen=True):
    """A raw frame of the chassis: when the arbiter read it (``time_ns``), and when it was on the bus."""

    time_ns: int
    identifier: int
    data: bytes
    bus_ns: int

    @property
    def waited_ns(self) -> int:
        """The time from the bus to the arbiter; 0 if unknown."""
        waited_ns = max(0, self.time_ns - self.bus_ns)
        return waited_ns if waited_ns < REACH_NS else 0

    @property
    def bus_time_ns(self) -> int:
        return self.time_ns - self.waited_ns

    @property
    def is_whole(self) -> bool:
        """Eight bytes whose checksum is right."""
        return len(self.data) == 8 and self.checksum == self.data[7]

    @property
    def checksum(self) -> int:
        """The right value of byte 7: the XOR of those before."""
        return reduce(xor, self.data[:7], 0)

    @property
    def alive_counter(self) -> int:
        """The high half of byte 6."""
        return self.data[6] >> 4

    def __str__(self) -> str:
        return f"0x{self.identifier:08X} {BY_IDENTIFIER[self.identifier].name}, {self.data.hex(' ').upper()}"


BY_IDENTIFIER: Final[dict[int, MessageLayout]] = {
    frame.can_id & IDENTIFIER_MASK: frame for frame in frame_layouts.COMMON.messages.values()
}
"""Every frame of the DBC. Both variants have the same frames and cycle times."""

IDENTIFIERS: Final = {frame.name: identifier for identifier, frame in BY_IDENTIFIER.items()}

BODY: Final = IDENTIFIERS["Auto_MileageAndBodyFeedback"]
DRIVE: Final = IDENTIFIERS["Auto_DriveFeedBack"]


def silence_ns(name: str) -> int:
    """The time without a feedback frame after which it counts as silent."""
    return max(SILENCE_PERIODS * BY_IDENTIFIER[IDENTIFIERS[name]].period_ns, SILENCE_MIN_NS)


def signals(frame: DecodedFrame, variant: Variant = Variant.COARSE) -> dict[str, float]:
    """A frame's signals by name, scaled, whatever its checksum is; empty if it has not eight bytes."""
    if len(frame.data) != 8:
        return {}
    layout = frame_layouts.layout(variant).messages[BY_IDENTIFIER[frame.identifier].name]
    return {signal.name: signal.value(frame.data) for signal in layout.signals}


class Limits(msgspec.Struct, frozen=True):
    """The settings in force, and their origin in words."""

    command: CommandSettings = CommandSettings()
    origin: str = "the default; no configuration is in the log"


def limits_at(at_ns: int, robot: str, configurations: Sequence[tuple[int, str]], faults: Faults) -> Limits:
    """The limits of the configuration that was published last, or else next."""
    texts = [text for time_ns, text in configurations if time_ns <= at_ns][-1:]
    for text in texts + [text for _, text in configurations][:1]:
        try:
            return Limits(settings_from(text).command, "from its configuration")
        except CommandError as error:
            faults.add(f"{robot}: its configuration cannot be read: {error}")
    return Limits()


class EvidenceWindow:
    """The messages of a robot around a moment. Times are nanoseconds since 1970, as those of the moment.

    Attributes:
        shift_ns: added to the robot's times.
        is_steady: no clock was set in this time.
        what: the moment in words.
        detail: the arbiter's text of the stop; may be empty.
        received: number of frames that the arbiter read in the second before the moment.
        has_frames: the log has the journal of the moment, and so its frames.
    """

    def __init__(self, robot: str, at_ns: int, shift_ns: int, limits: Limits, *, is_steady: bool = True) -> None:
        self.robot = robot
        self.at_ns = at_ns
        self.limits = limits
        self.what = "that moment"
        self.detail = ""
        self.received = 0
        self.has_frames = False
        self.gaps: list[RecordGap] = []
        self._shift_ns = shift_ns
        self._is_steady = is_steady
        self._frames: dict[int, deque[DecodedFrame]] = {}
        self._behind: dict[int, deque[DecodedFrame]] = {}
        self._said: dict[type[Message], list[Heard[Any]]] = {}
        self._during: dict[type[Message], list[Heard[Any]]] = {}
        self._run_ns = (0, END_OF_TIME_NS)
        self._seen: set[tuple[str, int, int, bytes]] = set()

    def take(self, row: Row) -> None:
        """Add a row of a wanted class."""
        kind, decode = row.topic.kind, row.topic.decode
        one = (row.topic.name, row.publish_ns, row.sequence, row.data)
        if kind is None or decode is None or one in self._seen:
            return
        self._seen.add(one)
        time_ns = row.publish_ns + self._shift_ns
        # Samples that a hung gateway had queued are late with the right time; others come from another clock.
        late_ns = BEFORE_NS if self._is_steady else STALL_NS
        if kind not in _ASKED_LATER and not -STALL_NS <= row.log_ns - time_ns <= late_ns:
            time_ns = row.log_ns
        if kind is RecordGap:
            gap = decode(row.data)
            parts = keys.parse(gap.key)
            if parts is None or self.robot in {parts.robot, f"{parts.root}/{parts.robot}"} or not parts.robot:
                self.gaps.append(gap)
        elif issubclass(kind, Message):
            self._said.setdefault(kind, []).append(Heard(time_ns, decode(row.data)))

    def settle(self) -> None:
        """Sort all messages after the last row."""
        for kind, heard in self._said.items():
            placed = heard if self._is_steady or kind not in _ASKED_LATER else self._by_tick(heard)
            self._said[kind] = sorted(placed, key=lambda one: one.time_ns)[-KEPT:]
        from_ns, to_ns = self._run_ns = self._run()
        for kind in _OF_A_GATEWAY & self._said.keys():
            self._during[kind] = [one for one in self._said[kind] if from_ns <= one.time_ns < to_ns]
        self._read_journal()

    def _run(self) -> tuple[int, int]:
        from_ns, to_ns = 0, END_OF_TIME_NS
        for was, then in pairwise(self.all(SafetyState)):
            if not is_same_run(was.said.tick, then.said.tick):
                if then.time_ns > self.at_ns:
                    return from_ns, then.time_ns
                from_ns = then.time_ns
        return from_ns, to_ns

    def _by_tick(self, heard: Sequence[Heard[Any]]) -> list[Heard[Any]]:
        """Messages at the times of their ticks where the clock was wrong; others than this time's are left out."""
        states = sorted({one.said.tick: one for one in reversed(self.all(SafetyState))}.values(), key=_tick_of)
        placed = []
        for one in heard:
            at = bisect_left(states, _tick_of(one), key=_tick_of)
            near = min(
                states[max(at - 1, 0) : at + 1], key=lambda two: abs(two.said.tick - _tick_of(one)), default=None
            )
            ticks = 0 if near is None else _tick_of(one) - near.said.tick
            time_ns = one.time_ns
            if near is not None and abs(ticks) <= _TICKS_NEAR:
                expected_ns = near.time_ns + ticks * TICK_NS
                time_ns = time_ns if abs(time_ns - expected_ns) <= NEAR_NS else expected_ns
            if self.at_ns - BEFORE_NS - STALL_NS <= time_ns <= self.at_ns + AFTER_NS + STALL_NS:
                placed.append(Heard(time_ns, one.said))
        return placed

    def _read_journal(self) -> None:
        """Split the frames into those that the arbiter read up to the moment's tick, and those after it.

        Frames before a gap of the journal, or of another run, are dropped.
        """
        upto_ns, told_ns, told = self.at_ns + TICK_NS // 2, 0, 0
        frames: list[DecodedFrame] = []
        for follows, part in _parts([one.said for one in self.all(Journal)], self._shift_ns):
            first_ns = next(time_ns for time_ns, frame in part if frame is None)
            if not follows and first_ns <= upto_ns:
                frames, told, told_ns = [], 0, 0
            for time_ns, frame in part:
                if frame is not None:
                    frames.append(frame)
                elif time_ns <= upto_ns:
                    told, told_ns = len(frames), time_ns
        self.has_frames = self.at_ns - told_ns <= SAFETY_STATE_PERIOD_NS + TICK_NS
        for number, one in enumerate(frames):
            if number >= told or self.has_frames:
                place = self._frames if number < told else self._behind
                place.setdefault(one.identifier, deque(maxlen=KEPT)).append(one)
                self.received += number < told and one.time_ns > self.at_ns - 1_000_000_000

    def ago(self, time_ns: int) -> str:
        return before(time_ns, self.at_ns, self.what)

    def all(self, kind: type[Said]) -> Sequence[Heard[Said]]:
        return self._said.get(kind, [])

    def during(self, kind: type[Said]) -> Sequence[Heard[Said]]:
        """The messages of a class by time; a gateway's messages about itself only of the moment's run."""
        return self._during.get(kind) or (() if kind in _OF_A_GATEWAY else self.all(kind))

    def last(self, kind: type[Said], at_ns: int | None = None) -> Heard[Said] | None:
        """The last one up to a time, by default the moment."""
        return next(self.until(kind, at_ns), None)

    def after(self, kind: type[Said], at_ns: int | None = None) -> Iterator[Heard[Said]]:
        """The messages of a class after a time, by default the moment."""
        from_ns = self.at_ns if at_ns is None else at_ns
        return (one for one in self.during(kind) if one.time_ns > from_ns)

    def until(self, kind: type[Said], at_ns: int | None = None) -> Iterator[Heard[Said]]:
        """The messages of a class up to a time, by default the moment; the last one first."""
        until_ns = self.at_ns if at_ns is None else at_ns
        return (one for one in reversed(self.during(kind)) if one.time_ns <= until_ns)

    @property
    def over_ns(self) -> int:
        """The end of the moment's stop: the next engagement, the next stop, or the end of the run."""
        has_begun = has_rested = False
        for one in self.after(SafetyState, self.at_ns - 1):
            state = one.said.state
            if (has_rested and state is ArbiterState.STOPPING) or (has_begun and state in COMMANDING):
                return one.time_ns
            has_begun |= state not in COMMANDING
            has_rested |= state is ArbiterState.STANDBY
        engaged = (one for one in self.after(SafetyEvent) if one.said.kind is EventKind.ENGAGED)
        return next((one.time_ns for one in engaged), self._run_ns[1])

    def frames(self, identifier: int) -> Sequence[DecodedFrame]:
        """Frames that the arbiter read up to the moment, in order."""
        return self._frames.get(identifier, ())

    def waiting(self, identifier: int) -> Sequence[DecodedFrame]:
        """Frames that were on the bus by the moment, and that the arbiter read after it."""
        return [one for one in self._behind.get(identifier, ()) if one.bus_time_ns <= self.at_ns]

    def commands_between(self, from_ns: int, to_ns: int) -> list[DecodedFrame]:
        """Command frames that this gateway received, and so did not send, by their time on the bus."""
        heard = [
            one
            for identifier, layout in BY_IDENTIFIER.items()
            if not layout.is_feedback
            for part in (self._frames, self._behind)
            for one in part.get(identifier, ())
            if from_ns <= one.bus_time_ns < to_ns
        ]
        return sorted(heard, key=lambda one: one.bus_time_ns)

    def speeds_after(self, from_ns: int) -> list[tuple[int, float]]:
        """Times and speeds of the drive feedback, from raw frames where no gateway decoded them yet."""
        found = {one.time_ns: one.said.speed_mps for one in self.all(Drive) if one.time_ns > from_ns}
        first_ns = min(found, default=END_OF_TIME_NS)
        for frame in (one for part in (self._frames, self._behind) for one in part.get(DRIVE, ())):
            if from_ns < frame.time_ns < first_ns and frame.is_whole:
                found[frame.time_ns] = signals(frame, self.variant)["Speed"]
        return sorted(found.items())

    @property
    def named_frames(self) -> list[str]:
        return [name for name in IDENTIFIERS if name in self.detail]

    @property
    def variant(self) -> Variant:
        """The firmware variant at the moment; coarse if the log does not have it."""
        state = self.last(RobotState)
        return state.said.variant if state and state.said.variant is not Variant.UNKNOWN else Variant.COARSE

    @property
    def lacks_decisions(self) -> int:
        """Number of decisions missing in this time, by their sequence."""
        numbers = sorted({one.said.sequence for one in self.all(Decision)})
        return numbers[-1] - numbers[0] + 1 - len(numbers) if numbers else 0


_DECODER: Final = msgspec.msgpack.Decoder(list[tuple[Any, ...]])


_Input = tuple[int, DecodedFrame | None]
"""A frame and the time at which the arbiter read it; None stands for a tick."""


def _parts(journals: Sequence[Journal], shift_ns: int) -> Iterator[tuple[bool, list[_Input]]]:
    """The frames and ticks of each journal message with ticks, and whether it directly follows the one before."""
    expected = (-1, -1)
    for journal in journals:
        found: list[_Input] = []
        inputs: list[tuple[Any, ...]] = []
        with suppress(*UNREADABLE):
            inputs = _DECODER.decode(journal.inputs)
        offset_ns = next((shift_ns + offset_ns for offset_ns in map(_offset_ns, reversed(inputs)) if offset_ns), 0)
        for one in inputs if offset_ns else ():
            match one:
                case (Kind.TICK, int(now_ns), int(), *_):
                    found.append((now_ns + offset_ns, None))
                case (Kind.FRAME, int(now_ns), [int(word), bytes(data), int(bus_ns), *_]):
                    identifier, given_ns = word & IDENTIFIER_MASK, now_ns + offset_ns
                    if word & EXTENDED and not word & (REMOTE | ERROR) and identifier in BY_IDENTIFIER:
                        bus_ns = bus_ns + shift_ns if bus_ns else given_ns
                        found.append((given_ns, DecodedFrame(given_ns, identifier, data, bus_ns)))
                case _:
                    pass
        if offset_ns:
            yield (journal.run, journal.first) == expected, found
        expected = (journal.run, journal.first + journal.count)


def _offset_ns(one: tuple[Any, ...]) -> int:
    """The offset from monotonic to wall clock, by a tick; else 0."""
    match one:
        case (Kind.TICK, int(now_ns), int(wall_ns), *_):
            return wall_ns - now_ns
        case _:
            return 0


def _tick_of(one: Heard[Any]) -> int:
    tick: int = one.said.tick
    return tick


_ASKED_LATER: Final[frozenset[type[Message]]] = frozenset({Decision, SafetyEvent})

_OF_A_GATEWAY: Final[frozenset[type[Message]]] = frozenset(
    {Decision, SafetyEvent, SafetyState, GatewayHealth, RobotState}
)
"""Classes in which a gateway describes itself; the others are feedback of the chassis."""

_WANTED: Final = _OF_A_GATEWAY | {Journal, Drive, WheelSpeed, Steering, Gear, Body, Parking}


def read_window(window: EvidenceWindow, logs: Sequence[LogFile], faults: Faults) -> EvidenceWindow:
    from_ns, to_ns = max(0, window.at_ns - BEFORE_NS), window.at_ns + AFTER_NS

    def read(selection: Selection, until_ns: int) -> None:
        for row in read_rows(logs, selection, faults):
            try:
                if row.publish_ns < until_ns:
                    window.take(row)
            except UNREADABLE as error:
                faults.add(f"{row.topic.name}: a message that cannot be read: {error}")

    def is_wanted(kind: object, robot: str) -> bool:
        return (robot == window.robot and kind in _WANTED) or kind is RecordGap

    read(Selection(lambda one: is_wanted(one.kind, one.robot), from_ns, to_ns + LINK_NS), END_OF_TIME_NS)
    if window.lacks_decisions or not window.all(Decision):
        later = Selection(
            lambda one: one.robot == window.robot and one.kind in _ASKED_LATER, to_ns + LINK_NS, to_ns + LATER_NS
        )
        read(later, to_ns)
    window.gaps = [gap for gap in window.gaps if gap.first_ns < to_ns and gap.last_ns >= from_ns]
    window.settle()
    return window
