"""Requests and their rulings: states, causes of stops, latches, and the outcome of a tick. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import Enum
from typing import Final

import msgspec

from gateway.chassis.port import Actuation, AuxiliaryFrame, ChassisState
from gateway.command.motion import Target
from schemas.decisions import GUARD_STOP_ENDED, ArbiterState, EventKind, Severity
from schemas.messages import ControllerState
from schemas.reasons import TEXTS, Reason
from schemas.requests import Role
from schemas.settings import COMMANDER_QUIET_NS, LATE_NS, LATE_TOLD_NS


class Credentials(msgspec.Struct, frozen=True, array_like=True):
    """The proven facts about a request's sender. An array in the journal.

    Attributes:
        reason: NONE if the proof is valid; otherwise all below is empty.
        detail: figures that the reason's text lacks.
        serial: of the grant, for people.
        role, override, speed_limit_mps: what the grant allows.
    """

    reason: Reason
    detail: str = ""
    serial: int = 0
    role: Role = Role.PROGRAM
    override: bool = False
    speed_limit_mps: float | None = None


class RawRequest(msgspec.Struct, frozen=True):
    """A request, untrusted.

    Attributes:
        handle: number by which the port finds the receiver of the reply; 0 for a put, which has no reply.
        verb: the last chunk of the key.
        operator: the chunk before it; empty if it is no valid name.
        payload: empty if it is longer than any request.
        size: of the whole payload, in bytes.
        fault: why the payload cannot be read, if that was found before the core; the payload is empty then.
        attachment: see ``schemas.authority.proof``.
        credentials: None where no proof is needed.
    """

    handle: int
    verb: str
    operator: str
    payload: bytes
    size: int
    fault: str = ""
    attachment: bytes = b""
    credentials: Credentials | None = None

    @property
    def is_query(self) -> bool:
        return self.handle != 0


class Ruling(msgspec.Struct, frozen=True):
    """The ruling on a request.

    Attributes:
        reason: NONE if it was accepted.
        detail: figures that the reason's text lacks.
        is_pending: accepted; the reply follows with the result.
        lease: identifier of the lease that the request names or was given.
        expires_ns: the remaining duration of the lease.
        sequence, asked: of a drive command.
        cure: in place of the reason's cure, if not empty.
        age_ns: the greatest possible age, if it echoes a known challenge.
    """

    reason: Reason = Reason.NONE
    detail: str = ""
    is_pending: bool = False
    lease: int | None = None
    expires_ns: int = 0
    sequence: int | None = None
    age_ns: int | None = None
    asked: Target | None = None
    cure: str = ""

    @property
    def text(self) -> str:
        """The reason in words, with the figures."""
        means = TEXTS[self.reason].means if self.reason is not Reason.NONE else ""
        return "; ".join(filter(None, (means, self.detail)))


class Judged(msgspec.Struct, frozen=True):
    """A request and its ruling."""

    request: RawRequest
    ruling: Ruling


class VerbAnswer(msgspec.Struct, frozen=True):
    """A ruling to send back as a reply."""

    handle: int
    verb: str
    ruling: Ruling


class Trigger(Enum):
    """Triggers of state changes, in words."""

    ENGAGE = "engage is accepted"
    CONFIRMED = "the chassis reads auto"
    STOP = "a cause to stop"
    YIELD = "the remote control or the guard takes over, the mode leaves auto at rest, or the bus is lost"
    REST = "the stop sequence has ended"


_STANDBY, _ENGAGING = ArbiterState.STANDBY, ArbiterState.ENGAGING
_ENGAGED, _STOPPING = ArbiterState.ENGAGED, ArbiterState.STOPPING

TRANSITIONS: Final[dict[tuple[ArbiterState, Trigger], ArbiterState]] = {
    (_STANDBY, Trigger.ENGAGE): _ENGAGING,
    (_STANDBY, Trigger.STOP): _STOPPING,
    (_ENGAGING, Trigger.CONFIRMED): _ENGAGED,
    (_ENGAGING, Trigger.STOP): _STOPPING,
    (_ENGAGING, Trigger.YIELD): _STANDBY,
    (_ENGAGED, Trigger.STOP): _STOPPING,
    (_ENGAGED, Trigger.YIELD): _STANDBY,
    (_STOPPING, Trigger.STOP): _STOPPING,
    (_STOPPING, Trigger.YIELD): _STANDBY,
    (_STOPPING, Trigger.REST): _STANDBY,
}
"""There are no other transitions. Only ENGAGE leads from standby to motion, and only a request of the lease's
holder triggers it: motion never resumes automatically."""


def diagram() -> str:
    """The table as a Mermaid state diagram."""
    lines = ["stateDiagram-v2", f"    [*] --> {ArbiterState.STANDBY.value}"]
    lines += [
        f"    {before.value} --> {after.value}: {trigger.value}"
        for (before, trigger), after in TRANSITIONS.items()
    ]
    return "\n".join(lines)


class StopRule(msgspec.Struct, frozen=True):
    """The rule by which a cause stops the robot.

    Attributes:
        at_once: with the emergency deceleration, not the normal one.
        latched: the robot cannot be engaged again before a reset.
        ramps: the commanded speed ramps down. If its scale is in doubt it is zero at once, because a ramp in the
            wrong scale would command 40 times the speed.
        parks: the parking brake is applied at once, at any speed.
    """

    at_once: bool
    latched: bool = False
    ramps: bool = True
    parks: bool = False


STOPS: Final[dict[Reason, StopRule]] = {
    Reason.REMOTE_STOP: StopRule(at_once=True, latched=True),
    Reason.FRONT_BUMPER: StopRule(at_once=True, latched=True),
    Reason.REAR_BUMPER: StopRule(at_once=True, latched=True),
    Reason.ROLLING: StopRule(at_once=True, latched=True, parks=True),
    Reason.BRAKE_SLIPS: StopRule(at_once=True, latched=True),
    Reason.IMPLAUSIBLE_SPEED: StopRule(at_once=True, latched=True, ramps=False),
    Reason.OVERSPEED: StopRule(at_once=True, latched=True),
    Reason.STEERING: StopRule(at_once=True, latched=True),
    Reason.NOT_MOVING: StopRule(at_once=True, latched=True),
    Reason.FEEDBACK_FROZEN: StopRule(at_once=True, latched=True),
    Reason.GATE: StopRule(at_once=True, latched=True, parks=True),
    Reason.GUARD: StopRule(at_once=True, latched=True),
    Reason.MODE_NOT_AUTO: StopRule(at_once=True, parks=True),
    Reason.BUS_OFF: StopRule(at_once=True),
    Reason.FEEDBACK_MISSING: StopRule(at_once=True),
    Reason.FEEDBACK_FAULTY: StopRule(at_once=True),
    Reason.FEEDBACK_LATE: StopRule(at_once=True),
    Reason.VARIANT_UNKNOWN: StopRule(at_once=True, ramps=False),
    Reason.OTHER_COMMANDER: StopRule(at_once=True),
    Reason.LOOP_LATE: StopRule(at_once=True),
    Reason.SEND_FAILED: StopRule(at_once=True),
    Reason.UNGUARDED: StopRule(at_once=False),
    Reason.DEADMAN: StopRule(at_once=False),
    Reason.DISENGAGED: StopRule(at_once=False),
    Reason.IDLE: StopRule(at_once=False),
    Reason.LEASE_EXPIRED: StopRule(at_once=False),
    Reason.LEASE_RELEASED: StopRule(at_once=False),
    Reason.LEASE_TAKEN: StopRule(at_once=False),
    Reason.GRANT_EXPIRED: StopRule(at_once=False),
    Reason.GRANT_REVOKED: StopRule(at_once=False),
    Reason.NOT_CONFIRMED: StopRule(at_once=False),
    Reason.FOUND_MOVING: StopRule(at_once=False),
    Reason.SHUTDOWN: StopRule(at_once=False),
}
"""Every cause to stop, the most severe first."""

BUMPERS: Final = (Reason.FRONT_BUMPER, Reason.REAR_BUMPER)


class Event(msgspec.Struct, frozen=True):
    """The contents of a SafetyEvent."""

    severity: Severity
    kind: EventKind
    reason: Reason
    text: str
    operator: str = ""


class TickOutcome(msgspec.Struct, frozen=True):
    """The outcome of a tick.

    Attributes:
        actuation: the five motion frames; None for silence.
        auxiliary: lamps, horn and odometer; sent only together with the five.
    """

    actuation: Actuation | None
    auxiliary: list[AuxiliaryFrame]
    judged: list[Judged]
    answers: list[VerbAnswer]
    events: list[Event]


NAMED: Final = 4
"""Most names of operators who stopped a robot."""

OTHERS: Final = "others"
"""Stands for all further names."""

_BY: Final = "by "
_AND: Final = ", "


class Latches:
    """Latched causes.

    Attributes:
        details: the latched causes, oldest first, each with its detail. The detail of a remote stop is the names
            of its senders, newest first.
        newest_ns: time of the newest latch, monotonic.
    """

    def __init__(self) -> None:
        self.details: dict[Reason, str] = {}
        self.newest_ns = 0

    def add(self, reason: Reason, detail: str, now_ns: int, *, is_new_hit: bool) -> bool:
        """Latch a cause. Returns True if it was not latched before.

        The first detail stays, and all senders of remote stops. A new hit invalidates a reset sent before it.
        """
        is_new = reason not in self.details
        if is_new:
            self.details[reason] = detail
        elif reason is Reason.REMOTE_STOP:
            self._name(_names(detail) + [name for name in self.stopped_by if name not in _names(detail)])
        if is_new or is_new_hit:
            self.newest_ns = now_ns
        return is_new

    @property
    def stopped_by(self) -> list[str]:
        """Operators whose remote stops are latched, newest first; after four of them "others"."""
        return _names(self.details.get(Reason.REMOTE_STOP, ""))

    def withdraw(self, detail: str) -> bool:
        """Remove this name from the senders of stops, unless it is the only one. Returns True if it was there."""
        left = [name for name in self.stopped_by if name not in _names(detail)]
        is_there = 0 < len(left) < len(self.stopped_by)
        if is_there:
            self._name(left)
        return is_there

    def _name(self, names: list[str]) -> None:
        kept = names if len(names) <= NAMED else [*names[:NAMED], OTHERS]
        self.details[Reason.REMOTE_STOP] = _BY + _AND.join(kept)

    @property
    def newest(self) -> Reason:
        """The cause latched last. There must be one."""
        return [*self.details][-1]


def _names(detail: str) -> list[str]:
    return detail.removeprefix(_BY).split(_AND) if detail.startswith(_BY) else []


class Outbox:
    """Replies and events that are due."""

    def __init__(self) -> None:
        self._pending: dict[str, int] = {}
        self._answers: list[VerbAnswer] = []
        self._events: list[Event] = []

    def take(self) -> tuple[list[VerbAnswer], list[Event]]:
        """Return what is due. Requests without a ruling stay pending."""
        due = self._answers, self._events
        self._answers, self._events = [], []
        return due

    def add_event(
        self, severity: Severity, kind: EventKind, reason: Reason, text: str, operator: str = ""
    ) -> None:
        self._events.append(Event(severity, kind, reason, text, operator))

    def add_events(self, events: Iterable[Event]) -> None:
        self._events += events

    def answer(self, request: RawRequest, ruling: Ruling) -> None:
        """Answer a query now; if its ruling is pending, ``settle`` does it later."""
        if ruling.is_pending:
            self._pending[request.verb] = request.handle
        elif request.is_query:
            self._answers.append(VerbAnswer(request.handle, request.verb, ruling))

    def settle(self, verb: str, ruling: Ruling) -> None:
        """Answer the pending request of this verb, if any."""
        handle = self._pending.pop(verb, None)
        if handle is not None:
            self._answers.append(VerbAnswer(handle, verb, ruling))

    def refuse_pending(self, reason: Reason, detail: str) -> None:
        """Refuse all pending requests."""
        for verb in list(self._pending):
            self.settle(verb, Ruling(reason, detail))


_GRAVITY = {
    ControllerState.WARNING: Severity.WARNING,
    ControllerState.PASSIVE: Severity.WARNING,
    ControllerState.BUS_OFF: Severity.ERROR,
}


class Notices:
    """Reports changes of the chassis since the last tick as events."""

    def __init__(self) -> None:
        self._late_told_ns = -LATE_TOLD_NS
        self._controller = ControllerState.UNKNOWN
        self._guard_says = ""
        self._is_realtime = False
        self._commander_ns: int | None = None

    def look(self, chassis: ChassisState, now_ns: int, late_ns: int, *, is_idle: bool = False) -> Iterator[Event]:
        """Yield the events of this tick. A late tick of an idle robot is no fault."""
        if late_ns > LATE_NS and now_ns - self._late_told_ns >= LATE_TOLD_NS:
            self._late_told_ns = now_ns
            severity = Severity.INFO if is_idle else Severity.WARNING
            text = f"the loop was {late_ns / 1e6:.0f} ms late"
            yield Event(severity, EventKind.FAULT, Reason.LOOP_LATE, text)
        before, self._controller = self._controller, chassis.controller
        if self._controller is not before:
            yield Event(
                _GRAVITY.get(self._controller, Severity.INFO),
                EventKind.FAULT,
                Reason.BUS_OFF if self._controller is ControllerState.BUS_OFF else Reason.BUS_ERRORS,
                f"the CAN controller: {before.value} before, {self._controller.value} now",
            )
        received_ns, last_ns = chassis.commander_ns, self._commander_ns
        if received_ns is not None:
            self._commander_ns = received_ns
            if last_ns is None or received_ns - last_ns > COMMANDER_QUIET_NS:
                yield Event(
                    Severity.WARNING, EventKind.FAULT, Reason.OTHER_COMMANDER, TEXTS[Reason.OTHER_COMMANDER].means
                )
        was_realtime, self._is_realtime = self._is_realtime, chassis.realtime
        if was_realtime and not chassis.realtime:
            yield Event(Severity.WARNING, EventKind.FAULT, Reason.NO_REALTIME, TEXTS[Reason.NO_REALTIME].means)
        if not chassis.guard_sends and chassis.guard_says != self._guard_says:
            self._guard_says = chassis.guard_says
            if chassis.guard_says:
                text = f"{GUARD_STOP_ENDED}{chassis.guard_says}"
                yield Event(Severity.WARNING, EventKind.GUARD, Reason.GUARD, text)
