"""Events derived from two successive states of the arbiter.

If the log holds the events themselves, they say it better, and the derived ones are dropped. Without them (samples
were lost, or the gateway is an older one) the derived ones remain.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from collections.abc import Iterator
from typing import Final

import msgspec

from recorder.review.timeline.entries import Entry, EntryKind, EntrySource, kind_of
from schemas.decisions import COMMANDING, ArbiterState, SafetyState, Severity
from schemas.reasons import TEXTS, Reason
from schemas.settings import SAFETY_STATE_PERIOD_NS

YIELDS: Final = frozenset({Reason.HAND_TRANSMITTER, Reason.MODE_NOT_AUTO, Reason.BUS_DOWN, Reason.GUARD})
"""Reasons for which the output ceases at once, without a stop sequence."""

TICKS_MAX: Final = 100_000
"""Ticks of events that are remembered, of each kind."""


class Change(msgspec.Struct, frozen=True):
    """A change between two states.

    Attributes:
        after_tick: the tick of the first of them; what happened, did after it...
        tick: ...and up to this one.
    """

    kind: EntryKind
    severity: Severity
    reason: Reason
    operator: str
    text: str
    after_tick: int
    tick: int


def changes(before: SafetyState, now: SafetyState) -> Iterator[Change]:
    """Return the changes between two states of one run."""
    silent_ns = now.time_ns - before.time_ns
    said = ""
    if silent_ns > 4 * SAFETY_STATE_PERIOD_NS:
        said = f" (within {silent_ns / 1e9:.1f} s of which the log holds no state)"
    for looks in (_lease, _latches, _guard, _of_states):
        for kind, severity, reason, operator, text in looks(before, now):
            yield Change(kind, severity, reason, operator, text + said, before.tick, now.tick)


_Told = Iterator[tuple[EntryKind, Severity, Reason, str, str]]
"""Kind, severity, reason, operator, text."""


def _lease(before: SafetyState, now: SafetyState) -> _Told:
    was, holder = before.lease_holder, now.lease_holder
    if holder == was:
        return
    text = f"{holder} holds the lease as {now.lease_role.value}" if holder else f"{was} no longer holds the lease"
    text += f", {was} before" if holder and was else ""
    yield EntryKind.LEASE, Severity.INFO, Reason.NONE, holder or was, text


def _latches(before: SafetyState, now: SafetyState) -> _Told:
    for reason in now.latched:
        if reason not in before.latched:
            yield EntryKind.LATCH, Severity.ERROR, reason, "", f"latched until a reset: {TEXTS[reason].means}"
    cleared = [reason.value for reason in before.latched if reason not in now.latched]
    if cleared:
        text = f"reset: {', '.join(cleared)}"
        yield EntryKind.RESET, Severity.INFO, Reason.NONE, now.lease_holder, text


def _guard(before: SafetyState, now: SafetyState) -> _Told:
    if now.guarded and not before.guarded:
        yield EntryKind.GUARD, Severity.INFO, Reason.NONE, "", "a guard watches the gateway"
    if before.guarded and not now.guarded:
        yield EntryKind.GUARD, Severity.WARNING, Reason.NONE, "", "no guard watches the gateway any more"


def _of_states(before: SafetyState, now: SafetyState) -> _Told:
    if now.state is before.state:
        return
    reason = now.stop_reason
    why = TEXTS[reason].means
    match now.state:
        case ArbiterState.ENGAGED:
            text = "engaged: the chassis reads auto"
            yield EntryKind.ENGAGED, Severity.INFO, Reason.NONE, now.lease_holder, text
        case ArbiterState.STOPPING:
            yield EntryKind.STOP, Severity.WARNING, reason, "", f"stopping: {why}"
        case ArbiterState.STANDBY if reason in YIELDS:
            kind = EntryKind.GUARD if reason is Reason.GUARD else EntryKind.TAKEOVER
            yield kind, Severity.WARNING, reason, "", f"nothing is sent any more: {why}"
        case ArbiterState.STANDBY:
            if before.state in COMMANDING:
                yield EntryKind.STOP, Severity.WARNING, reason, "", f"stopping: {why}"
            yield EntryKind.STOPPED, Severity.INFO, reason, "", "stopped: the robot is told nothing"
        case _:
            pass


def entry_of(change: Change, robot: str, time_ns: int, holder: str) -> Entry:
    """The entry of a change."""
    return Entry(
        time_ns=time_ns,
        last_ns=time_ns,
        robot=robot,
        kind=kind_of(change.kind, change.reason),
        severity=change.severity,
        source=EntrySource.STATE,
        text=change.text,
        reason=change.reason,
        operator=change.operator,
        holder=holder,
        tick=change.tick,
    )


class EventTicks:
    """In which ticks there were events, of each kind: what need not be derived."""

    def __init__(self) -> None:
        self._ticks: dict[EntryKind, list[int]] = {}

    def add(self, kind: EntryKind, tick: int) -> None:
        """An event is there."""
        ticks = self._ticks.setdefault(kind, [])
        insort(ticks, tick)
        if len(ticks) > TICKS_MAX:
            del ticks[0]

    def tells(self, kind: EntryKind, after_tick: int, tick: int) -> bool:
        """There is an event of this kind behind the one tick, and not behind the other."""
        ticks = self._ticks.get(kind, [])
        at = bisect_right(ticks, after_tick)
        return at < len(ticks) and ticks[at] <= tick
