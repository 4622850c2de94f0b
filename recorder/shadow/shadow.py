"""A robot's arbiter and one with other settings, fed by the same journal: where they decide differently. Pure.

The other arbiter begins in the state of the robot's, at the start of its run or at a checkpoint, as if the
settings had been changed there. Where the two are not in the same state at a later checkpoint, it begins there
again: no difference follows from one of more than a minute before.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final

import msgspec

from recorder.review.rerun.counterfactual import MOVED_NS, STOP_TOLERANCE_NS, RunsCompared, verdict_of
from recorder.review.rerun.minutes import COMMANDS, Commanded, commanded_in_words, verdict_in_words
from recorder.review.rerun.player import SampleAgain
from recorder.review.rerun.regress import MINUTE_NS
from schemas import codec
from schemas.decisions import Bound, Decision, EventKind, SafetyEvent, SafetyState, Verdict
from schemas.subjects import BY_NAME

LIMITS: Final = {
    Bound.SPEED: ("speed_limit_mps", "m/s"),
    Bound.ACCELERATION: ("acceleration_limit_mps2", "m/s2"),
    Bound.DECELERATION: ("deceleration_limit_mps2", "m/s2"),
    Bound.STEERING: ("steering_limit_deg", "deg"),
    Bound.STEERING_RATE: ("steering_rate_limit_degps", "deg/s"),
    Bound.LATERAL_ACCELERATION: ("lateral_acceleration_limit_mps2", "m/s2"),
    Bound.TRAVEL_DELAY: ("travel_speed_limit_mps", "m/s"),
}
"""The fields of ``safety/state`` that hold the limits, and their units."""

NOTHING: Final = "nothing of the kind"


class ShadowDifference(msgspec.Struct, frozen=True):
    """A thing that the other arbiter would have decided differently.

    Attributes:
        time_ns: nanoseconds since 1970, by the robot's clock.
        what: a request and who sent it, an event, or the commands to the chassis.
        recorded, other: the decision of either, with its reason and the limits and figures behind it.
    """

    robot: str
    time_ns: int
    what: str
    recorded: str
    other: str


class _Event(msgspec.Struct, frozen=True):
    said: SafetyEvent
    is_other: bool
    minute: int


class Shadow:
    """Both arbiters side by side; a ``PairListener`` of the gateway.

    Args:
        robot: its name.

    Attributes:
        compared: all that both said.
        minutes: so many of the robot's minutes were run; the last one may be shorter.
        start_ns, end_ns: the first tick and the last one, since 1970; 0 before.
        is_clear: the other arbiter began at a run's start or at rest, and not at a checkpoint.
        is_certain: nothing but the settings had to do with the state that it began in.
        has_strayed: at the last checkpoint the two were not in the same state.
    """

    def __init__(self, robot: str) -> None:
        self.compared = RunsCompared(self._take_decisions)
        self.minutes = 0
        self.start_ns = self.end_ns = 0
        self.is_clear = self.is_certain = True
        self.has_strayed = False
        self._robot = robot
        self._minute_ns = 0
        self._otherwise: set[int] = set()
        self._found: deque[ShadowDifference] = deque()
        self._shown: set[object] = set()
        """Reported in this minute, and so not reported again, but counted."""
        self._events: deque[_Event] = deque()
        self._states: dict[bool, bytes] = {}
        self._commanded: tuple[Commanded, Commanded] | None = None

    @property
    def otherwise(self) -> int:
        """The number of minutes in which something was decided differently."""
        return len(self._otherwise)

    def differences(self) -> Iterator[ShadowDifference]:
        """The differences that were found since the last call."""
        while self._found:
            yield self._found.popleft()

    def begin(self, *, is_clear: bool, is_certain: bool) -> None:
        """Both begin."""
        self.is_clear, self.is_certain, self.has_strayed = is_clear, is_certain, False

    def tick(self, time_ns: int) -> None:
        """A tick begins. A clock that was set begins another minute."""
        if not self.minutes or not 0 <= time_ns - self._minute_ns < MINUTE_NS:
            self.minutes += 1
            self._minute_ns = time_ns
            self._shown.clear()
        self.start_ns = self.start_ns or time_ns
        self.end_ns = time_ns
        while self._events and abs(time_ns - self._events[0].said.time_ns) > STOP_TOLERANCE_NS:
            self._report_event(self._events.popleft())

    def say(self, recorded: Sequence[SampleAgain], other: Sequence[SampleAgain]) -> None:
        """Both say something in the same call."""
        for samples, is_other in ((recorded, False), (other, True)):
            for sample in samples:
                if sample.subject == _STATE.name:
                    self._states[is_other] = sample.payload
        for samples, is_other in ((recorded, False), (other, True)):
            for sample in samples:
                self.compared.take(sample, is_other=is_other)
                if sample.subject == _EVENT.name:
                    said = codec.decode(_EVENT, sample.payload)
                    if isinstance(said, SafetyEvent):
                        self._take_event(_Event(said, is_other, self.minutes))
        if self._commanded is not None:
            words = [
                self._with_state(commanded_in_words(told), is_other=is_other)
                for told, is_other in zip(self._commanded, (False, True), strict=True)
            ]
            self._report(COMMANDS, self.end_ns, COMMANDS, words)
            self._commanded = None

    def command(self, recorded: Commanded, other: Commanded) -> None:
        """In this tick the chassis is told different things; what both say of it follows."""
        self._commanded = recorded, other

    def compare(self, *, are_same: bool) -> None:
        """Both are at a checkpoint, or the robot is at rest."""
        self.has_strayed = not are_same

    def _take_decisions(self, recorded: Decision, other: Decision) -> None:
        kinds = verdict_of(recorded), verdict_of(other)
        words = [self._decided(recorded, is_other=False), self._decided(other, is_other=True)]
        what = f"{recorded.request} of {recorded.operator}"
        self._report((what, *kinds), recorded.time_ns, what, words)

    def _take_event(self, event: _Event) -> None:
        for waiting in self._events:
            if waiting.is_other is not event.is_other and _kind(waiting) == _kind(event):
                self._events.remove(waiting)
                apart_ns = abs(waiting.said.time_ns - event.said.time_ns)
                if event.said.kind is EventKind.STOP and apart_ns >= MOVED_NS:
                    self._report_moved(waiting, event)
                return
        self._events.append(event)

    def _report_event(self, event: _Event) -> None:
        said = event.said
        words = [said.text, NOTHING] if not event.is_other else [NOTHING, said.text]
        key = (*_kind(event), event.is_other)
        self._report(key, said.time_ns, f"event {said.kind.value}, {said.reason.value}", words, event.minute)

    def _report_moved(self, first: _Event, second: _Event) -> None:
        recorded, other = (second, first) if first.is_other else (first, second)
        apart_s = (other.said.time_ns - recorded.said.time_ns) / 1e9
        moved = f"{abs(apart_s):.2f} s {'later' if apart_s > 0 else 'sooner'}: {other.said.text}"
        what = f"event {recorded.said.kind.value}, {recorded.said.reason.value}"
        words = [recorded.said.text, moved]
        self._report((*_kind(first), "moved"), recorded.said.time_ns, what, words, first.minute)

    def _report(self, key: object, time_ns: int, what: str, words: Sequence[str], minute: int = 0) -> None:
        self._otherwise.add(minute or self.minutes)
        if key not in self._shown:
            self._shown.add(key)
            recorded, other = words
            self._found.append(ShadowDifference(self._robot, time_ns, what, recorded, other))

    def _decided(self, decision: Decision, *, is_other: bool) -> str:
        """A decision in words: why it was made, and what came of it."""
        text = verdict_in_words(verdict_of(decision))
        if decision.detail:
            text += f": {decision.detail}"
        state = self._state(is_other=is_other)
        limits = [LIMITS[bound] for bound in decision.bound_by if bound in LIMITS]
        if state is not None and limits:
            values = [(getattr(state, field), unit) for field, unit in limits]
            text += f" ({', '.join(f'{value:.2f} {unit}' for value, unit in values if value is not None)})"
        if decision.verdict is Verdict.ACCEPTED and decision.requested_speed_mps is not None:
            text += f"; told {decision.output_speed_mps:.2f} m/s, {decision.output_angle_deg:.2f} deg"
        return text

    def _with_state(self, text: str, *, is_other: bool) -> str:
        state = self._state(is_other=is_other)
        if state is None:
            return text
        reasons = ", ".join(reason.value for reason in state.blocked_by)
        return f"{text}; {state.state.value}{reasons and f': {reasons}'}"

    def _state(self, *, is_other: bool) -> SafetyState | None:
        payload = self._states.get(is_other)
        state = None if payload is None else codec.decode(_STATE, payload)
        return state if isinstance(state, SafetyState) else None


def _kind(event: _Event) -> tuple[EventKind, object]:
    return event.said.kind, event.said.reason


_STATE: Final = BY_NAME["safety/state"]
_EVENT: Final = BY_NAME["safety/event"]
