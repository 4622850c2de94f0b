"""One moment in words: what the robot and its arbiter did, a stop, and the story of its runs."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import pairwise, takewhile
from typing import Final

import msgspec

from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import END_OF_TIME_NS, Progress, Selection, read_rows
from recorder.review.entries import ENDS, SETTLE_NS, STOP_KINDS, Entry, EntryKind, EntrySource
from recorder.review.events import Timeline, hung_ns
from recorder.review.evidence import last_command
from recorder.review.window import (
    AFTER_NS,
    BEFORE_NS,
    EvidenceWindow,
    Heard,
    Link,
    Said,
    Step,
    before,
    deg,
    missing,
    mps,
    span,
)
from schemas.decisions import (
    COMMANDING,
    ArbiterState,
    Bound,
    EventKind,
    SafetyEvent,
    SafetyState,
    Severity,
    StopPhase,
    is_same_run,
)
from schemas.messages import (
    Body,
    Drive,
    GatewayHealth,
    Gear,
    GearPosition,
    Parking,
    ParkingStatus,
    RobotState,
    Steering,
)
from schemas.reasons import OF_A_ROBOT, RESET, TEXTS, Reason, cure_of, of_a_robot
from schemas.recording import RecorderEvent
from schemas.settings import STANDSTILL_MPS, STANDSTILL_TICKS, TICK_NS

_PHASES: Final = {
    StopPhase.BRAKE: "zero speed",
    StopPhase.PARK: "parking brake",
    StopPhase.NEUTRAL: "neutral",
    StopPhase.HOLD: "hold",
    StopPhase.DISABLE: "enables off",
}

_DOUBTFUL: Final = frozenset({Reason.IMPLAUSIBLE_SPEED, Reason.VARIANT_UNKNOWN})
"""Reasons that make the chassis's reported speeds unreliable."""

_UNSEEN_NS: Final = 150_000_000  # without drive feedback for longer, the distance is not known

_STANDS_NS: Final = STANDSTILL_TICKS * TICK_NS


def actions(window: EvidenceWindow, reason: Reason) -> Iterator[Link]:
    states = list(window.after(SafetyState, window.at_ns - 1))
    stopping = list(takewhile(lambda one: one.said.state is ArbiterState.STOPPING, states))
    if stopping:
        yield from _ramp(window, stopping)
    elif reason is Reason.GUARD:
        yield Link(Step.ACTION, "the gateway sends nothing: the guard stops the robot", window.at_ns)
    elif states and states[0].said.state is ArbiterState.STANDBY:
        text = "the gateway sends nothing: the remote control, or the last command, moves the robot"
        yield Link(Step.ACTION, text, states[0].time_ns)
    else:
        yield missing("the arbiter's states after this")
    over_ns = window.over_ns
    yield standstill(window, over_ns, is_doubtful=reason in _DOUBTFUL)
    ended = next((one for one in window.after(SafetyEvent) if one.said.kind is EventKind.STOPPED), None)
    if ended is not None and ended.time_ns < over_ns:
        after_ns = ended.time_ns - window.at_ns
        text = f"{ended.said.text}, after {span(after_ns)}"
        yield Link(Step.ACTION, text, ended.time_ns, {"after_s": after_ns / 1e9})


def _ramp(window: EvidenceWindow, stopping: Sequence[Heard[SafetyState]]) -> Iterator[Link]:
    """The ramp of the commanded speed, and the start of each phase."""
    was = window.last(SafetyState, window.at_ns - 1)
    zero = next((one for one in stopping if not one.said.output_speed_mps), None)
    if was is None or (zero is None and was.said.output_speed_mps):
        yield missing("the ramp of the commanded speed")
    elif zero is None or not was.said.output_speed_mps:
        yield Link(Step.ACTION, "the commanded speed was zero", stopping[0].time_ns)
    else:
        ramp = [one.said for one in stopping if one.said.output_speed_mps]
        took_ns, slope_mps2 = zero.time_ns - window.at_ns, None
        if len(ramp) > 1 and ramp[-1].tick > ramp[0].tick:
            fallen_mps = abs(ramp[0].output_speed_mps) - abs(ramp[-1].output_speed_mps)
            slope_mps2 = fallen_mps / ((ramp[-1].tick - ramp[0].tick) * TICK_NS / 1e9)
        slope = "" if slope_mps2 is None else f" at {slope_mps2:.1f} m/s2"
        text = f"the commanded speed went from {was.said.output_speed_mps:.2f} m/s to zero{slope}"
        text += f" in {span(took_ns)}"
        data = {"from_mps": was.said.output_speed_mps, "deceleration_mps2": slope_mps2, "took_s": took_ns / 1e9}
        yield Link(Step.ACTION, text, window.at_ns, data)
    begun: dict[StopPhase, int] = {}
    for one in stopping:
        begun.setdefault(one.said.stop_phase, one.time_ns - window.at_ns)
    parts = [f"{words} after {span(begun[phase])}" for phase, words in _PHASES.items() if phase in begun]
    if parts:
        data = {f"{phase.value}_after_s": after_ns / 1e9 for phase, after_ns in begun.items()}
        yield Link(Step.ACTION, ", ".join(parts), stopping[0].time_ns, data)


def standstill(window: EvidenceWindow, over_ns: int, *, is_doubtful: bool) -> Link:
    """The time and distance to standstill, by the drive feedback up to ``over_ns``."""
    last = window.last(Drive)
    way = [one for one in (last, *window.after(Drive)) if one is not None and one.time_ns < over_ns]
    if len(way) < 2:
        return missing("the drive feedback of this time")
    if way[0].said.speed_mps < STANDSTILL_MPS:
        return Link(Step.ACTION, "the robot stood already, by its drive feedback", way[0].time_ns)
    metres, stood, unseen_ns = 0.0, None, 0
    for was, now in pairwise(way):
        if now.said.speed_mps >= STANDSTILL_MPS:
            stood = None
        elif stood is None:
            stood = now
        if stood is not None and now.time_ns - stood.time_ns >= _STANDS_NS:
            break
        unseen_ns = max(unseen_ns, now.time_ns - was.time_ns)
        passed_ns = max(0, now.time_ns - max(was.time_ns, window.at_ns))
        metres += (was.said.speed_mps + now.said.speed_mps) / 2 * passed_ns / 1e9
    if stood is None:
        text = f"the last drive feedback, {window.ago(way[-1].time_ns)}, still read "
        return Link(Step.ACTION, f"{text}{way[-1].said.speed_mps:.2f} m/s", way[-1].time_ns)
    is_known = unseen_ns <= _UNSEEN_NS and not is_doubtful
    why = "the speeds are in doubt" if is_doubtful else f"no drive feedback for {span(unseen_ns)}"
    text = f"the robot, at {way[0].said.speed_mps:.2f} m/s, was below {STANDSTILL_MPS:g} m/s after "
    text += f"{span(stood.time_ns - window.at_ns)}"
    text += f" and {metres:.2f} m" if is_known else f"; {why}: the distance is not known"
    data = {
        "from_mps": way[0].said.speed_mps,
        "after_s": (stood.time_ns - window.at_ns) / 1e9,
        "distance_m": metres if is_known else None,
    }
    return Link(Step.ACTION, text, stood.time_ns, data)


FRESH_NS: Final = 500_000_000  # older feedback does not describe the moment; the slowest frame comes every 50 ms
_STILL_MPS: Final = 0.005  # speeds below this are shown as 0.00 m/s

PLAIN: Final = frozenset({Reason.STOPPING, Reason.NOT_ENGAGED, Reason.ENGAGING, Reason.NO_LEASE})
"""Reasons that only say that the robot is not engaged."""

_PASSING: Final = frozenset({Reason.STOPPING, Reason.ENGAGING, Reason.GEAR_SHIFTING})
"""Reasons that end by themselves."""

_FORBIDS: Final = {Reason.FRONT_BUMPER: (1, "forward"), Reason.REAR_BUMPER: (-1, "backward")}
"""The sign of the speeds that a pressed bumper forbids to an engaged robot, and their direction in words."""

_WAYS: Final = {GearPosition.REVERSE: "backward ", GearPosition.DRIVE: "forward "}


def motion(now: EvidenceWindow) -> Link:
    """The robot's motion, by its feedback; by its state if the feedback is not in the log."""
    drive, state = _fresh(now, Drive), _fresh(now, RobotState)
    steering, gear = _fresh(now, Steering), _fresh(now, Gear)
    body, parking = _fresh(now, Body), _fresh(now, Parking)
    seen = drive or state
    if seen is None or seen.said.speed_mps is None:
        return missing("the robot's speed at this moment")
    speed_mps = abs(seen.said.speed_mps)
    position = gear.said.gear_position if gear is not None else GearPosition.UNDEFINED
    moved = f"moved {_WAYS.get(position, '')}at {speed_mps:.2f} m/s"
    parts = [f"it {_stood(speed_mps) if speed_mps < STANDSTILL_MPS else moved}"]
    parts += [f"steering {deg(steering.said.angle_deg)}"] if steering is not None else []
    parts += [f"gear {position.value}"] if gear is not None else []
    if body is not None:
        parts.append(f"mode {body.said.mode.value}")
        parts += [f"{side} bumper pressed" for side in ("front", "rear") if getattr(body.said, f"{side}_bumper")]
    if parking is not None and parking.said.parking_status is not ParkingStatus.UNDEFINED:
        parts.append(f"parking brake {parking.said.parking_status.value}")
    parts += [f"silent: {', '.join(state.said.silent)}"] if state is not None and state.said.silent else []
    facts: dict[str, object] = {
        "speed_mps": speed_mps,
        "angle_deg": None if steering is None else steering.said.angle_deg,
        "gear_position": position.value,
        "mode": None if body is None else body.said.mode.value,
    }
    return Link(Step.MOTION, ", ".join(parts), seen.time_ns, facts)


def _stood(speed_mps: float) -> str:
    """A robot that counts as standing in words; it may still roll."""
    return "stood" if speed_mps < _STILL_MPS else f"barely moved, at {speed_mps:.2f} m/s"


def arbiter(state: SafetyState | None) -> Link:
    if state is None:
        return missing("the arbiter's state at this moment")
    text = f"the arbiter was {state.state.value}"
    if state.stop_phase is not StopPhase.IDLE:
        text += f" ({state.stop_phase.value}) because of {state.stop_reason.value}"
    if state.lease_holder:
        text += f"; {state.lease_holder} held the lease as {state.lease_role.value}"
        text += f" with {state.lease_expires_s:.1f} s left"
    else:
        text += "; the lease was free"
    if state.state in COMMANDING:
        text += f"; the speed limit was {state.speed_limit_mps:.2f} m/s"
    data = {
        "tick": state.tick,
        "state": state.state.value,
        "stop_phase": state.stop_phase.value,
        "lease_holder": state.lease_holder,
        "latched": [reason.value for reason in state.latched],
        "blocked_by": [reason.value for reason in state.blocked_by],
        "speed_limit_mps": state.speed_limit_mps,
        "output_speed_mps": state.output_speed_mps,
    }
    return Link(Step.ARBITER, text, None, data)


def headline(
    now: EvidenceWindow, state: SafetyState | None, focus: Entry | None, why: str, latch: Entry | None
) -> str:
    is_stop = focus is not None and focus.kind in {EntryKind.STOP, EntryKind.END}
    when = "" if focus is None else before(focus.time_ns, now.at_ns)
    soon = ""
    if focus is not None and focus.time_ns > now.at_ns:
        began = "a stop began" if is_stop else "the gateway let go"
        soon = f"; {span(focus.time_ns - now.at_ns)} later {began}: {why}"
    if state is None:
        last = "." if focus is None else f". The last stop was {when}: {why}."
        return f"Not in the log: what the arbiter did then{last}"
    match state.state:
        case ArbiterState.STOPPING:
            return f"It was being stopped: {why or TEXTS[state.stop_reason].means}."
        case ArbiterState.STANDBY:
            if focus is None:
                return f"It was not engaged: {_in_words(state.blocked_by)}."
            last = soon or f". The last stop was {when}: {why}"
            if not soon and latch is not None and latch.time_ns > focus.time_ns:
                last = f", and was latched {before(latch.time_ns, now.at_ns)}: {cause_of(latch)}{last}"
            return f"It was not engaged{last}."
        case ArbiterState.ENGAGING:
            return f"It was being engaged: the chassis did not yet report auto{soon}."
        case _:
            return f"{_engaged(now, state)}{soon}."


def cause_of(entry: Entry) -> str:
    """The text of a stop without its first word."""
    return entry.text.partition(": ")[2] or entry.text


def _engaged(now: EvidenceWindow, state: SafetyState) -> str:
    """An engaged robot in words: its motion, or why it stood."""
    drive, robot = _fresh(now, Drive), _fresh(now, RobotState)
    speed_mps = drive.said.speed_mps if drive is not None else None if robot is None else robot.said.speed_mps
    if speed_mps is not None and speed_mps >= STANDSTILL_MPS:
        return f"It was engaged and moved, at {speed_mps:.2f} m/s"
    did = "was not seen to move" if speed_mps is None else _stood(speed_mps)
    if round(state.output_speed_mps, 2):
        return f"It was engaged, commanded {mps(state.output_speed_mps)}, and {did}"
    blocking = kept_by(now, state)
    if blocking:
        return f"It was engaged and {did}: {_in_words(blocking)}"
    last = last_command(now)
    if last is None:
        return f"It was engaged and {did}: no drive command is in the log"
    asked_mps = round(last.said.requested_speed_mps or 0.0, 2)
    if asked_mps:
        return f"It was engaged, requested {mps(asked_mps)}, commanded 0.00 m/s, and {did}"
    return f"It was engaged and {did}: {last.said.operator} requested zero speed"


def kept_by(now: EvidenceWindow, state: SafetyState) -> list[Reason]:
    """The reasons that kept an engaged robot from moving; none if it was commanded to move.

    A pressed bumper counts only if its direction was requested.
    """
    if round(state.output_speed_mps, 2):
        return []
    last = last_command(now)
    is_bound = last is not None and Bound.BUMPER in last.said.bound_by
    return [reason for reason in state.blocked_by if reason not in _FORBIDS or is_bound]


def blocks(reason: Reason, now: EvidenceWindow, state: SafetyState) -> bool:
    """True if a reason blocks the robot; a pressed bumper does not if the robot drives away from it."""
    if state.state is not ArbiterState.ENGAGED:
        return True
    if reason in _FORBIDS:
        return (state.output_speed_mps or state.target_speed_mps) * _FORBIDS[reason][0] >= 0
    return reason in kept_by(now, state)


def blocked_words(reason: Reason, state: SafetyState) -> str:
    """A blocking reason in words for a robot in this state."""
    means = OF_A_ROBOT[reason].means
    match state.state:
        case ArbiterState.ENGAGED if reason in _FORBIDS:
            return f"it could not be driven {_FORBIDS[reason][1]}: {means}, and is still pressed"
        case ArbiterState.ENGAGED:
            return f"no speed was commanded: {means}"
        case ArbiterState.STOPPING:
            return f"it could not be engaged again: {means}"
        case _:
            return f"it could not be engaged: {means}"


def cures(reason: Reason, robot: str, beside: Collection[Reason] = (), *, is_reset: bool) -> Iterator[Link]:
    """Yield the cure of a reason; after a reset, what remains to be done."""
    cure = of_a_robot(reason, beside).cure
    cure = cure.rpartition(RESET)[2] if is_reset else cure
    if cure and reason not in _PASSING:
        yield Link(Step.CURE, f"to cure {reason.value}: {cure_of(cure, robot)}", None, {"reason": reason.value})


def _in_words(reasons: Sequence[Reason]) -> str:
    return "; ".join(OF_A_ROBOT[reason].means for reason in reasons) or "nothing blocked it"


def _fresh(now: EvidenceWindow, kind: type[Said]) -> Heard[Said] | None:
    heard = now.last(kind)
    return heard if heard is not None and now.at_ns - heard.time_ns <= FRESH_NS else None


KEPT: Final = 50_000  # entries of a story; the oldest go first

_TELLS: Final = ENDS | {
    EntryKind.LATCH,
    EntryKind.RESET,
    EntryKind.STOPPED,
    EntryKind.ENGAGED,
    EntryKind.GATEWAY,
    EntryKind.CLOCK,
}


class GatewaySilence(msgspec.Struct, frozen=True):
    """A time without states: the gateway died, restarted, or its loop hung.

    It begins with the last state of its arbiter, as in ``events`` and ``report``.

    Attributes:
        then: the first state after it; None if the logs end with it.
        is_hang: both states are of one run.
        was_told: the gateway shut down as requested, at rest.
        text: a recorder's text on a death that no state follows.
    """

    was: Heard[SafetyState]
    then: Heard[SafetyState] | None
    is_hang: bool = False
    was_told: bool = False
    text: str = ""

    @property
    def time_ns(self) -> int:
        return self.was.time_ns

    @property
    def end_ns(self) -> int:
        return END_OF_TIME_NS if self.then is None else self.then.time_ns

    @property
    def was_active(self) -> bool:
        return self.was.said.state is not ArbiterState.STANDBY


class Story:
    """The entries of a robot, in order, and the silences of its gateways.

    If the clock was set back, two moments can have one time: the later is meant.

    Attributes:
        is_shared: two gateways use its name.
    """

    def __init__(self, entries: Iterable[Entry]) -> None:
        self.is_shared = False
        self.silences: deque[GatewaySilence] = deque(maxlen=KEPT)
        self._offsets: list[tuple[int, int]] = []
        self._eras = [(0, END_OF_TIME_NS, 0)]
        """Times between steps back of the clock, each with the sum of the steps before."""
        ordered = []
        for entry in deque(entries, maxlen=KEPT):
            if entry.kind is EntryKind.CLOCK and entry.last_ns > entry.time_ns:
                from_ns, _, set_ns = self._eras[-1]
                self._eras[-1] = (from_ns, entry.last_ns, set_ns)
                self._eras.append((entry.time_ns, END_OF_TIME_NS, set_ns + entry.last_ns - entry.time_ns))
            ordered.append((entry.time_ns + self._eras[-1][2], entry))
        ordered.sort(key=lambda one: one[0])
        self._order_ns = [order_ns for order_ns, _ in ordered]
        self._entries = [entry for _, entry in ordered]

    @classmethod
    def read(cls, robot: str, logs: Sequence[LogFile], faults: Faults, progress: Progress) -> Story:
        """Read the arbiter's events and states, and the recorders' events about the gateway."""
        wanted = {SafetyEvent, SafetyState, GatewayHealth}
        selection = Selection(
            lambda topic: topic.kind is RecorderEvent or (topic.robot == robot and topic.kind in wanted)
        )
        timeline, silences, offsets = Timeline(faults), deque[GatewaySilence](maxlen=KEPT), list[tuple[int, int]]()
        track = timeline.robot(robot)
        last: Heard[SafetyState] | None = None

        def entries() -> Iterator[Entry]:
            nonlocal last
            for row in read_rows(logs, selection, faults, progress):
                was_told = track.is_ended
                timeline.take(row)
                if track.state is not None and (last is None or track.state is not last.said):
                    now = Heard(track.state_ns, track.state)
                    if last is not None and not track.is_shared:
                        is_hang = is_same_run(last.said.tick, now.said.tick)
                        if not is_hang or hung_ns(last.said, now.said, now.time_ns - last.time_ns):
                            silences.append(GatewaySilence(last, now, is_hang, was_told))
                    last = now
                    if not offsets or offsets[-1][1] != track.clock.offset_ns:
                        offsets.append((row.log_ns, track.clock.offset_ns))
                yield from timeline.tell()
            yield from timeline.end()

        story = cls(one for one in entries() if one.robot == robot and one.kind in _TELLS)
        story.silences, story.is_shared, story._offsets = silences, track.is_shared, offsets
        death = next((one for one in reversed(story._entries) if one.kind is not EntryKind.CLOCK), None)
        if last is not None and death is not None and _is_death(death):
            silences.append(GatewaySilence(last, None, text=death.text))
        return story

    def order_ns(self, at_ns: int) -> int:
        """The time without the steps back of the clock."""
        within = [set_ns for from_ns, to_ns, set_ns in self._eras if from_ns <= at_ns <= to_ns]
        return at_ns + (within[-1] if within else 0)

    def offset_ns(self, at_ns: int) -> int:
        """The offset to add to the robot's times around a moment."""
        offsets = [offset_ns for log_ns, offset_ns in self._offsets if log_ns <= at_ns + SETTLE_NS + 1_000_000_000]
        return offsets[-1] if offsets else next((offset_ns for _, offset_ns in self._offsets), 0)

    def is_steady(self, at_ns: int) -> bool:
        """True if no clock was set in the seconds around a moment."""
        clocks = (one.time_ns for one in self._entries if one.kind is EntryKind.CLOCK)
        return not any(at_ns - BEFORE_NS <= time_ns <= at_ns + AFTER_NS for time_ns in clocks)

    def last_stop(self) -> Entry | None:
        """The last stop; without any, the last normal end."""
        either = (
            next((one for one in reversed(self._entries) if stops(one, kinds)), None)
            for kinds in (STOP_KINDS, ENDS)
        )
        return next(filter(None, either), None)

    def stop_before(self, at_ns: int) -> Entry | None:
        """The last stop up to a time, unless the robot was engaged since."""
        found = (one for one in self.before(at_ns) if one.kind is EntryKind.ENGAGED or stops(one))
        last = next(found, None)
        return None if last is None or last.kind is EntryKind.ENGAGED else last

    def next_stop(self, from_ns: int) -> Entry | None:
        return next(filter(stops, self.after(from_ns - 1)), None)

    def latch_before(self, reason: Reason, at_ns: int) -> Entry | None:
        latches = (one for one in self.before(at_ns) if one.kind is EntryKind.LATCH)
        return next((one for one in latches if one.reason is reason), None)

    def reset_of(self, latch: Entry) -> Entry | None:
        """The first reset of a latch, in its run."""
        resets = (one for one in self.after(latch.time_ns) if one.kind is EntryKind.RESET)
        named = (one for one in resets if latch.reason.value in one.text.partition(": ")[2].split(", "))
        return next((one for one in named if None in (one.tick, latch.tick) or _of_run(one, latch.tick)), None)

    def of_run(self, tick: int) -> Iterator[Entry]:
        """The entries of a run up to its first engagement."""
        of_run = (one for one in self._entries if _of_run(one, tick))
        return takewhile(lambda one: one.kind is not EntryKind.ENGAGED, of_run)

    def before(self, at_ns: int) -> Iterator[Entry]:
        """The entries up to a time, the last one first."""
        return reversed(self._entries[: bisect_right(self._order_ns, self.order_ns(at_ns))])

    def after(self, at_ns: int) -> Iterator[Entry]:
        return iter(self._entries[bisect_right(self._order_ns, self.order_ns(at_ns)) :])


def stops(entry: Entry, kinds: frozenset[EntryKind] = ENDS) -> bool:
    """True if a stop begins or has a further cause; a guard's arrival or loss has no reason."""
    return entry.kind in kinds and entry.reason is not Reason.NONE and not entry.tells_of_guard


def _is_death(entry: Entry) -> bool:
    is_seen = entry.kind is EntryKind.GATEWAY and entry.source is EntrySource.RECORDER
    return is_seen and entry.severity is Severity.ERROR


def _of_run(entry: Entry, tick: int | None) -> bool:
    return entry.tick is not None and tick is not None and is_same_run(entry.tick, tick)
