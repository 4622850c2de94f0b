"""Some seconds of one robot, out of its logs: what the arbiter saw, was asked, and did, around a moment."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from statistics import median
from typing import Any, Final, Generic, TypeVar

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import END_OF_TIME_NS, Row, Selection, read_rows
from recorder.reading.topics import UNREADABLE
from recorder.review.clock import FAR_NS, NEAR_NS
from recorder.review.reasoning.chain import before
from recorder.review.reasoning.given import GivenInputs, given_until
from recorder.review.reasoning.signals import IDENTIFIERS, DecodedFrame
from schemas import keys
from schemas.configuration import TomlSource, merge
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
from schemas.exit_codes import CommandError
from schemas.messages import (
    Body,
    CanFrame,
    Drive,
    GatewayHealth,
    Gear,
    Message,
    Parking,
    RobotState,
    Steering,
    Variant,
    WheelSpeed,
)
from schemas.recording import RecordGap
from schemas.settings import TICK_NS, CommandSettings

BEFORE_NS: Final = 12_000_000_000
"""Length of the window before its moment: the longest lease, and a bit."""

AFTER_NS: Final = 9_000_000_000
"""Length of the window behind its moment: the longest stop takes 7 s, and a hold and the silence follow."""

LATER_NS: Final = 900_000_000_000
"""Time behind the moment in which decisions are looked for that a recorder asked for later."""

KEPT: Final = 5_000
"""Messages of each class that are kept of a window; the oldest go first."""

FRAMES_KEPT: Final = 500
"""Frames of each identifier that are kept up to the moment, 5 s of the most frequent; and behind it."""

_LINK_NS: Final = 1_500_000_000
"""Longest usual time between publication and receipt."""

Said = TypeVar("Said", bound=Message)


class Heard(msgspec.Struct, Generic[Said], frozen=True):
    """A message, and when it was."""

    time_ns: int
    said: Said


class Limits(msgspec.Struct, frozen=True):
    """The settings that were in force.

    Attributes:
        is_known: the log holds them; else these are the start values.
    """

    command: CommandSettings = CommandSettings()
    is_known: bool = False

    @property
    def origin(self) -> str:
        """The origin of a limit in words, to be put behind it."""
        return "by its configuration" if self.is_known else "the start value; the log holds no configuration"


def is_other_run(one: SafetyState, other: SafetyState) -> bool:
    """The two are not of one run of a gateway."""
    return not is_same_run(one.tick, other.tick)


class EvidenceWindow:
    """The messages of a robot around a moment. Times are nanoseconds since 1970, as those of the moment.

    Attributes:
        at_ns: the moment.
        what: it is, in words.
        detail: the arbiter's own remark; may be empty.
        limits: the settings in force.
        frames: received ones by identifier, those before the moment and those behind it, each in their order. As
            far as the journal is in the log, those before are what the arbiter had been given.
        waiting: by identifier, those that the bus had before the moment, and the arbiter was given behind it.
        is_journaled: the journal of the moment is in the log, and shows when the arbiter was given a frame.
        sent: likewise those that the gateway sent.
        received: number of frames received in the last second before the moment.
        gaps: the gaps of this time that the recorder reports.
    """

    def __init__(self, robot: str, at_ns: int, shift_ns: int, limits: Limits) -> None:
        self.robot = robot
        self.at_ns = at_ns
        self.what = "that moment"
        self.detail = ""
        self.limits = limits
        self.frames: dict[int, tuple[deque[DecodedFrame], deque[DecodedFrame]]] = {}
        self.sent: dict[int, tuple[deque[DecodedFrame], deque[DecodedFrame]]] = {}
        self.waiting: dict[int, list[DecodedFrame]] = {}
        self.is_journaled = False
        self.received = 0
        self.gaps: list[RecordGap] = []
        self._shift_ns = shift_ns
        self._taken: dict[type[Message], deque[Heard[Any]]] = {}
        self._said: dict[type[Message], list[Heard[Any]]] = {}
        self._during: dict[type[Message], list[Heard[Any]]] = {}
        self._run_ns = (0, END_OF_TIME_NS)
        self._seen: set[tuple[str, int, int]] = set()

    def take(self, row: Row) -> None:
        """A row of one of the classes that are wanted.

        Raises:
            what ``recorder.reading.topics.UNREADABLE`` lists.
        """
        kind, decode = row.topic.kind, row.topic.decode
        if kind is None or decode is None:
            return
        time_ns = row.publish_ns + self._shift_ns
        if kind not in _ASKED_LATER and abs(row.log_ns - time_ns) > _STALL_NS:
            # The robot's clock was set in these seconds. These are received soon, so the receipt tells enough.
            time_ns = row.log_ns
        if kind is CanFrame:
            self._take_frame(row, time_ns, decode)
            return
        one = (row.topic.name, row.publish_ns, row.sequence)
        if one in self._seen:
            return
        self._seen.add(one)
        if kind is RecordGap:
            gap = decode(row.data)
            parts = keys.parse(gap.key)
            if parts is None or self.robot in {parts.robot, f"{parts.root}/{parts.robot}"} or not parts.robot:
                self.gaps.append(gap)
        elif issubclass(kind, Message):
            heard = self._taken.setdefault(kind, deque(maxlen=KEPT))
            heard.append(Heard(time_ns, decode(row.data)))

    def settle(self) -> None:
        """All is there: put what came late into its place."""
        # The first one received of each tick.
        states = {one.said.tick: one for one in reversed(self._taken.get(SafetyState, deque()))}
        by_tick = sorted(states.values(), key=_tick_of)
        for kind in _ASKED_LATER & self._taken.keys():
            placed = (_by_tick(one, by_tick) for one in self._taken[kind])
            # One that was asked for later, of a clock that was set meanwhile, may be of any other time.
            self._taken[kind] = deque((one for one in placed if self._is_near(one.time_ns)), maxlen=KEPT)
        self._said = {kind: sorted(heard, key=lambda one: one.time_ns) for kind, heard in self._taken.items()}
        from_ns, to_ns = self._run_ns = self._run()
        for kind in _OF_A_GATEWAY & self._said.keys():
            self._during[kind] = [one for one in self._said[kind] if from_ns <= one.time_ns < to_ns]
        given = given_until(self.at_ns, [one.said for one in self.during(Journal)], self._shift_ns)
        if given is not None:
            self._give(given)

    def _give(self, given: GivenInputs) -> None:
        """Put the arbiter's view of the frames before the moment into the place of the bus's."""
        self.is_journaled = True
        if not self.frames:
            # Raw frames were not recorded; the journal holds them all the same.
            since_ns = self.at_ns - 1_000_000_000
            self.received = sum(one.time_ns > since_ns for frames in given.frames.values() for one in frames)
        for identifier in self.frames.keys() | given.frames.keys():
            before, behind = self.frames.get(identifier, _NONE)
            had = given.frames.get(identifier, [])
            first_ns, last_ns = (had[0].bus_ns, had[-1].bus_ns) if had else (given.from_ns, given.from_ns)
            older = [one for one in before if one.time_ns < (first_ns or 0)]
            self.waiting[identifier] = [one for one in before if one.time_ns > (last_ns or 0)]
            self.frames[identifier] = deque(older + had, maxlen=FRAMES_KEPT), behind

    def _run(self) -> tuple[int, int]:
        """The times at which the gateway of the moment began, and the next one did."""
        from_ns, to_ns = 0, END_OF_TIME_NS
        for was, then in pairwise(self.all(SafetyState)):
            if is_other_run(was.said, then.said):
                if then.time_ns > self.at_ns:
                    return from_ns, then.time_ns
                from_ns = then.time_ns
        return from_ns, to_ns

    def _is_near(self, time_ns: int) -> bool:
        return self.at_ns - BEFORE_NS - _STALL_NS <= time_ns <= self.at_ns + AFTER_NS + _STALL_NS

    def ago(self, time_ns: int) -> str:
        """``12.3 ms before the stop``."""
        return before(time_ns, self.at_ns, self.what)

    def all(self, kind: type[Said]) -> Sequence[Heard[Said]]:
        """The messages of a class, by their time."""
        return self._said.get(kind, [])

    def during(self, kind: type[Said]) -> Sequence[Heard[Said]]:
        """The messages of a class, by time; what a gateway says of itself, of the run of the moment alone."""
        return self._during.get(kind) or (() if kind in _OF_A_GATEWAY else self.all(kind))

    def last(self, kind: type[Said], at_ns: int | None = None) -> Heard[Said] | None:
        """The last one up to a time, that of the moment if none is given."""
        until_ns = self.at_ns if at_ns is None else at_ns
        return next((one for one in reversed(self.during(kind)) if one.time_ns <= until_ns), None)

    def after(self, kind: type[Said], at_ns: int | None = None) -> Iterator[Heard[Said]]:
        """The messages of a class behind a time, that of the moment if none is given."""
        from_ns = self.at_ns if at_ns is None else at_ns
        return (one for one in self.during(kind) if one.time_ns > from_ns)

    def until(self, kind: type[Said], at_ns: int | None = None) -> Iterator[Heard[Said]]:
        """The messages of a class up to a time, that of the moment if none is given; the last one first."""
        until_ns = self.at_ns if at_ns is None else at_ns
        return (one for one in reversed(self.during(kind)) if one.time_ns <= until_ns)

    @property
    def over_ns(self) -> int:
        """The end of what was at the moment: the next engagement, the next stop, or the end of the run."""
        has_begun = has_rested = False
        for one in self.after(SafetyState, self.at_ns - 1):
            state = one.said.state
            if (has_rested and state is ArbiterState.STOPPING) or (has_begun and state in COMMANDING):
                return one.time_ns
            has_begun |= state not in COMMANDING
            has_rested |= state is ArbiterState.STANDBY
        engaged = (one for one in self.after(SafetyEvent) if one.said.kind is EventKind.ENGAGED)
        return next((one.time_ns for one in engaged), self._run_ns[1])

    def frames_before(self, identifier: int) -> Sequence[DecodedFrame]:
        """Frames that the arbiter was given up to the moment, in their order; see ``frames``."""
        return self.frames.get(identifier, _NONE)[0]

    @property
    def named_frames(self) -> list[str]:
        """The feedback frames that the detail names."""
        return [name for name in IDENTIFIERS if name in self.detail]

    @property
    def has_frames(self) -> bool:
        """Raw frames were recorded."""
        return bool(self.frames)

    @property
    def variant(self) -> Variant:
        """The chassis's firmware variant at the moment; coarse where the log does not have it."""
        state = self.last(RobotState)
        return state.said.variant if state and state.said.variant is not Variant.UNKNOWN else Variant.COARSE

    @property
    def lacks_decisions(self) -> int:
        """Decisions of this time that are not in the log, by their sequence."""
        numbers = sorted({one.said.sequence for one in self.all(Decision)})
        return numbers[-1] - numbers[0] + 1 - len(numbers) if numbers else 0

    def _take_frame(self, row: Row, time_ns: int, decode: Callable[[bytes], Any]) -> None:
        raw = decode(row.data)
        is_behind = time_ns > self.at_ns
        is_sent = row.topic.subject.endswith("/tx")
        if not is_sent and not is_behind and time_ns > self.at_ns - 1_000_000_000:
            self.received += 1
        if not raw.is_extended or raw.is_remote or raw.is_error:
            return
        of = self.sent if is_sent else self.frames
        pair = of.get(raw.identifier)
        if pair is None:
            if len(of) >= FRAMES_KEPT:
                return
            pair = of[raw.identifier] = deque(maxlen=FRAMES_KEPT), deque(maxlen=FRAMES_KEPT)
        frame = DecodedFrame(time_ns, raw.identifier, raw.data)
        if is_behind and len(pair[1]) == FRAMES_KEPT:
            return
        if not pair[is_behind] or pair[is_behind][-1] != frame:
            pair[is_behind].append(frame)


def _tick_of(one: Heard[Any]) -> int:
    tick: int = one.said.tick
    return tick


def _by_tick(one: Heard[Any], states: Sequence[Heard[SafetyState]]) -> Heard[Any]:
    """The same, at the time of its tick if its clock was wrong by then; the states are in the order of theirs."""
    tick = _tick_of(one)
    place = bisect_left(states, tick, key=_tick_of)
    beside = states[max(place - 1, 0) : place + 1]
    near = min(beside, key=lambda state: abs(state.said.tick - tick), default=None)
    ticks = 0 if near is None else tick - near.said.tick
    if near is None or abs(ticks) > _TICKS_NEAR:
        return one
    expected_ns = near.time_ns + ticks * TICK_NS
    return one if abs(one.time_ns - expected_ns) <= NEAR_NS else Heard(expected_ns, one.said)


_ASKED_LATER: Final[frozenset[type[Message]]] = frozenset({Decision, SafetyEvent})

_OF_A_GATEWAY: Final[frozenset[type[Message]]] = frozenset(
    {Decision, SafetyEvent, SafetyState, GatewayHealth, RobotState, Journal}
)
"""Classes in which a gateway describes itself and the chassis; the others are the chassis's own feedback."""

_STALL_NS: Final = 2_000_000_000
"""No link delays a sample that it delivers for longer; it would be cut."""

_TICKS_NEAR: Final = 500

_NONE: Final[tuple[deque[DecodedFrame], deque[DecodedFrame]]] = deque(), deque()

_WANTED: Final = frozenset(
    {
        SafetyEvent, SafetyState, Decision, GatewayHealth, RobotState, CanFrame, Journal,
        Drive, WheelSpeed, Steering, Gear, Body, Parking,
    }
)  # fmt: skip


class WindowReader:
    """A robot's logs, of which windows are read.

    Args:
        robot: its name.
        logs: in the order of their beginnings.
        configurations: the texts of its configuration, each with its log time.
        faults: takes what cannot be read.
    """

    def __init__(
        self, robot: str, logs: Sequence[LogFile], configurations: Sequence[tuple[int, str]], faults: Faults
    ) -> None:
        self.robot = robot
        self._logs = logs
        self._configurations = configurations
        self._faults = faults

    def shift(self, at_ns: int) -> int:
        """The offset to add to the robot's clock around a log time; 0 if nothing was received then."""
        around = Selection(
            lambda topic: topic.robot == self.robot and topic.kind in {SafetyState, RobotState},
            max(0, at_ns - 2_000_000_000),
            at_ns + 2_000_000_000,
        )
        off_ns = [row.log_ns - row.publish_ns for row in read_rows(self._logs, around, self._faults)]
        if not off_ns:
            return 0
        middle_ns = round(median(off_ns))
        if NEAR_NS < middle_ns <= FAR_NS:
            # They may have waited for the recorder: what came the soonest is nearest to the truth.
            middle_ns = min(off_ns)
        return middle_ns if abs(middle_ns) > NEAR_NS else 0

    def window(self, at_ns: int, shift_ns: int) -> EvidenceWindow:
        """Read the window around a moment."""
        window = EvidenceWindow(self.robot, at_ns, shift_ns, self._limits(at_ns))
        from_ns, to_ns = max(0, at_ns - BEFORE_NS), at_ns + AFTER_NS
        around = Selection(
            lambda topic: (topic.robot == self.robot and topic.kind in _WANTED) or topic.kind is RecordGap,
            from_ns,
            to_ns + _LINK_NS,
        )
        self._read(window, around)
        if window.lacks_decisions or not window.all(Decision):
            later = Selection(
                lambda topic: topic.robot == self.robot and topic.kind in {Decision, SafetyEvent},
                to_ns + _LINK_NS,
                to_ns + LATER_NS,
                # What was asked for later is in a digest, for it was received late.,
            )
            self._read(window, later, until_ns=to_ns)
        window.gaps = [gap for gap in window.gaps if gap.first_ns < to_ns and gap.last_ns >= from_ns]
        window.settle()
        return window

    def _read(
        self,
        window: EvidenceWindow,
        selection: Selection,
        until_ns: int | None = None,
    ) -> None:
        for row in read_rows(self._logs, selection, self._faults):
            if until_ns is not None and row.publish_ns >= until_ns:
                continue
            try:
                window.take(row)
            except UNREADABLE as error:
                self._faults.add(f"{row.topic.name}: a message that cannot be read: {error}")

    def _limits(self, at_ns: int) -> Limits:
        """Return the configuration that was published last, or else next."""
        texts = [text for time_ns, text in self._configurations if time_ns <= at_ns][-1:]
        texts += [text for _, text in self._configurations][:1]
        for text in texts:
            try:
                return Limits(
                    merge(TomlSource("configuration.toml", text, is_recorded=True), {}, {}).command, is_known=True
                )
            except CommandError as error:
                self._faults.add(f"{self.robot}: its configuration cannot be read: {error}")
        return Limits()
