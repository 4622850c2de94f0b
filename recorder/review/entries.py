"""Entries of ``cruiser review events``, and the entries that two successive messages make.

A change between two states of the arbiter, or between two messages of ``gateway/health``. Where the log holds the
event itself it says more, and the change is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import Enum
from typing import Final

import msgspec

from schemas.decisions import COMMANDING, GUARD_STOP_ENDED, ArbiterState, EventKind, SafetyState, Severity
from schemas.messages import ControllerState, Count, GatewayHealth, TimeNs
from schemas.reasons import AS_ASKED, TEXTS, Reason
from schemas.requests import Tick
from schemas.settings import SAFETY_STATE_PERIOD_NS


class EntryKind(Enum):
    """The kind of an entry: those of ``safety/event``, and others that a log reveals."""

    LEASE = "lease"
    ENGAGED = "engaged"
    STOP = "stop"
    STOPPED = "stopped"
    LATCH = "latch"
    RESET = "reset"
    TAKEOVER = "takeover"
    FAULT = "fault"
    GUARD = "guard"
    REFUSAL = "refusal"
    REQUEST = "request"
    GATEWAY = "gateway"
    RECORDER = "recorder"
    GAP = "gap"
    CLOCK = "clock"
    END = "end"


OF_EVENT: Final = {kind: EntryKind(kind.value) for kind in EventKind}

STOPS: Final = frozenset({EntryKind.STOP, EntryKind.TAKEOVER, EntryKind.GUARD})
"""Entries that end the command of the robot, though no client asked for that."""

ENDS: Final = STOPS | {EntryKind.END}
"""And those that a client asked for."""

YIELDS: Final = frozenset({Reason.HAND_TRANSMITTER, Reason.MODE_NOT_AUTO, Reason.BUS_DOWN, Reason.GUARD})
"""Reasons for which the output ceases at once, without a stop sequence."""


def kind_of(kind: EntryKind, reason: Reason) -> EntryKind:
    """The kind of an entry for this reason: what was asked for is no stop."""
    return EntryKind.END if kind is EntryKind.STOP and reason in AS_ASKED else kind


class EntrySource(Enum):
    """The part of the log that an entry was read from.

    ``state``: no message says so; it was derived from two states of the arbiter, one after the other.
    """

    EVENT = "event"
    STATE = "state"
    DECISION = "decision"
    HEALTH = "health"
    RECORDER = "recorder"
    LOG = "log"


class Entry(msgspec.Struct, frozen=True, kw_only=True):
    """An entry of the timeline.

    Attributes:
        time_ns: when, in nanoseconds since 1970, by the robot's clock; by the recorder's where the two differ
            by over a second. Of an entry from ``gateway/health``, which comes once a second, it is the time of the
            health before: what went wrong did so between that and ``last_ns``.
        last_ns: when the last of ``count`` alike ones was, or how long it lasted; else as ``time_ns``.
        robot: whose; empty where it is about all.
        count: number of alike ones that are shown as one.
        reason: why; ``none`` where nothing is wrong.
        operator: the operator behind it; empty if there is none.
        holder: the lease's holder then, as far as the log shows; empty if there was none.
        request: the verb; empty where it is about none.
        tick: the arbiter's; None where there is none.
        text: the event in a sentence.
        is_late: entries that happened later come before it.
        is_stop: a stop begins with it; what is said of that stop afterwards is none.
    """

    time_ns: TimeNs
    last_ns: TimeNs
    robot: str
    kind: EntryKind
    severity: Severity
    source: EntrySource
    text: str
    count: Count = 1
    reason: Reason = Reason.NONE
    operator: str = ""
    holder: str = ""
    request: str = ""
    tick: Tick | None = None
    is_late: bool = False
    is_stop: bool = False

    @property
    def is_derived(self) -> bool:
        """No message says so."""
        return self.source is EntrySource.STATE

    @property
    def tells_of_guard(self) -> bool:
        """It says how a stop by the guard ended, which is no stop itself."""
        return self.kind is EntryKind.GUARD and self.text.startswith(GUARD_STOP_ENDED)


class Change(msgspec.Struct, frozen=True):
    """A change between two states, after the one tick and up to the other. An end that was asked for is a stop."""

    kind: EntryKind
    severity: Severity
    reason: Reason
    operator: str
    text: str
    after_tick: int = 0
    tick: int = 0


def changes(before: SafetyState, now: SafetyState) -> Iterator[Change]:
    """Return the changes between two states of one run."""
    silent_ns = now.time_ns - before.time_ns
    said = f" (within {silent_ns / 1e9:.1f} s without a state in the log)"
    for change in (*_lease(before, now), *_latches(before, now), *_guard(before, now), *_states(before, now)):
        text = change.text + (said if silent_ns > 4 * SAFETY_STATE_PERIOD_NS else "")
        yield msgspec.structs.replace(change, text=text, after_tick=before.tick, tick=now.tick)


def _lease(before: SafetyState, now: SafetyState) -> Iterator[Change]:
    was, holder = before.lease_holder, now.lease_holder
    if holder != was:
        text = (
            f"{holder} holds the lease as {now.lease_role.value}" if holder else f"{was} no longer holds the lease"
        )
        text += f", {was} before" if holder and was else ""
        yield Change(EntryKind.LEASE, Severity.INFO, Reason.NONE, holder or was, text)


def _latches(before: SafetyState, now: SafetyState) -> Iterator[Change]:
    for reason in now.latched:
        if reason not in before.latched:
            text = f"latched until a reset: {TEXTS[reason].means}"
            yield Change(EntryKind.LATCH, Severity.ERROR, reason, "", text)
    cleared = [reason.value for reason in before.latched if reason not in now.latched]
    if cleared:
        text = f"reset: {', '.join(cleared)}"
        yield Change(EntryKind.RESET, Severity.INFO, Reason.NONE, now.lease_holder, text)


def _guard(before: SafetyState, now: SafetyState) -> Iterator[Change]:
    if now.guarded and not before.guarded:
        yield Change(EntryKind.GUARD, Severity.INFO, Reason.NONE, "", "a guard watches the gateway")
    if before.guarded and not now.guarded:
        yield Change(EntryKind.GUARD, Severity.WARNING, Reason.NONE, "", "the guard is gone")


def _states(before: SafetyState, now: SafetyState) -> Iterator[Change]:
    reason, why = now.stop_reason, TEXTS[now.stop_reason].means
    match now.state:
        case same if same is before.state:
            pass
        case ArbiterState.ENGAGED:
            text = "engaged: the chassis reads auto"
            yield Change(EntryKind.ENGAGED, Severity.INFO, Reason.NONE, now.lease_holder, text)
        case ArbiterState.STOPPING:
            yield Change(EntryKind.STOP, Severity.WARNING, reason, "", f"stopping: {why}")
        case ArbiterState.STANDBY if reason in YIELDS:
            kind = EntryKind.GUARD if reason is Reason.GUARD else EntryKind.TAKEOVER
            yield Change(kind, Severity.WARNING, reason, "", f"no commands sent any more: {why}")
        case ArbiterState.STANDBY:
            if before.state in COMMANDING:
                yield Change(EntryKind.STOP, Severity.WARNING, reason, "", f"stopping: {why}")
            yield Change(EntryKind.STOPPED, Severity.INFO, reason, "", "stopped: no commands sent")
        case _:
            pass


FAILURES_IN_WORDS: Final = {
    "checksum": "checksums fail",
    "implausible": "values beyond what the chassis can have",
    "alive_counter": "alive counter fails",
    "period": "wrong period",
    "silence": "silent",
}

FRAME_COUNTS: Final[tuple[tuple[str, str, str], ...]] = (
    ("checksum_faults", "checksum", "frames with a wrong checksum"),
    ("implausible", "implausible", "frames with a value that the chassis cannot have"),
    ("lost", "alive_lost", "missing frames"),
)
"""Counters of each frame whose rise makes an entry, and the kind of fault that then needs none of its own."""

DROPPED: Final = "inbox_drops"

_COUNTS: Final[tuple[tuple[str, str], ...]] = (
    ("bus_losses", "the CAN bus was lost"),
    ("bus_drops", "frames were dropped: not read in time, or garbled"),
    ("publish_failures", "Zenoh did not take samples"),
    (DROPPED, "requests were dropped unread: too many came"),
)
"""Counters since the start whose rise makes an entry."""

_HARMLESS: Final = frozenset({"unknown_identifier", "remote_frame", "error_frame", "fd_frame"})
"""Frames of others on the bus, mostly."""

_FAULTS: Final = {"period": "frames came irregularly", "silence": "frames stayed away"}
"""In words, where no frame is named."""


def fault_words(kind: str) -> str:
    """The words for faults of this kind, of all frames together."""
    return f"faults of frames: {kind}"


class Risen(msgspec.Struct, frozen=True):
    """A fault that is new, or over, since the health before.

    Attributes:
        what: alike ones have the same.
        count: so many since the health before.
        about: the feedback frames that it is about; empty if it is about none.
        is_end: the end of something, which is known to be over at this health. Else it began, at an unknown time,
            behind the health before.
    """

    what: str
    kind: EntryKind
    severity: Severity
    text: str
    count: int = 1
    about: tuple[str, ...] = ()
    is_end: bool = False


def risen(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    """Return the faults that are new since the message before.

    Args:
        before: the one before of the same run; None if the log holds none: then the faults of now are returned.
        now: the newest.
    """
    yield from _bus(before, now)
    yield from _failures(before, now)
    if before is not None:
        yield from _counts(before, now)


def _failures(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    """Of all frames together, since a cable that is pulled out silences all of them."""
    were = {} if before is None else {frame.name: frame.failures for frame in before.feedback}
    are = {frame.name: frame.failures for frame in now.feedback}
    for failure, names in _by_failure((name, one, were.get(name, ())) for name, one in are.items()).items():
        words = FAILURES_IN_WORDS.get(failure, failure)
        yield Risen(failure, EntryKind.FAULT, Severity.WARNING, words, len(names), tuple(names))
    for failure, names in _by_failure((name, were.get(name, ()), one) for name, one in are.items()).items():
        text = f"no longer at fault ({failure})"
        what = f"{failure} over"
        yield Risen(what, EntryKind.FAULT, Severity.INFO, text, len(names), tuple(names), is_end=True)


def _by_failure(frames: Iterable[tuple[str, Iterable[str], Iterable[str]]]) -> dict[str, list[str]]:
    """The frames that have a failure in the one list, and not in the other."""
    found: dict[str, list[str]] = {}
    for name, failures, others in frames:
        for failure in failures:
            if failure not in others:
                found.setdefault(failure, []).append(name)
    return found


def _counts(before: GatewayHealth, now: GatewayHealth) -> Iterator[Risen]:
    pairs = [(frame, was) for frame in now.feedback for was in before.feedback if was.name == frame.name]
    said = {failure for frame, was in pairs for failure in frame.failures if failure not in was.failures}
    for field, kind, words in FRAME_COUNTS:
        grown = {frame.name: getattr(frame, field) - getattr(was, field) for frame, was in pairs}
        rises = {name: rise for name, rise in grown.items() if rise > 0}
        if rises:
            said.add(kind)
            # A frame may only be late: the gateway knows that it is lost some seconds after its time.
            count, is_end = sum(rises.values()), field == "lost"
            yield Risen(words, EntryKind.FAULT, Severity.WARNING, words, count, tuple(rises), is_end=is_end)
    for kind, count in now.faults.items():
        rise = count - before.faults.get(kind, 0)
        if rise > 0 and kind not in said:
            severity = Severity.INFO if kind in _HARMLESS else Severity.WARNING
            yield Risen(f"fault {kind}", EntryKind.FAULT, severity, _FAULTS.get(kind, fault_words(kind)), rise)
    for field, words in _COUNTS:
        rise = getattr(now, field) - getattr(before, field)
        if rise > 0:
            yield Risen(field, EntryKind.FAULT, Severity.WARNING, words, rise)


def _bus(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    if not now.bus_up and (before is None or before.bus_up):
        detail = f": {now.bus_detail}" if now.bus_detail else ""
        yield Risen("bus down", EntryKind.FAULT, Severity.ERROR, f"the CAN bus {now.bus} is not there{detail}")
    if before is not None and now.bus_up and not before.bus_up:
        yield Risen("bus up", EntryKind.FAULT, Severity.INFO, f"the CAN bus {now.bus} is back", is_end=True)
    if before is not None and now.variant is not before.variant:
        text = f"the firmware variant: {before.variant.value} before, {now.variant.value} now"
        yield Risen("variant", EntryKind.GATEWAY, Severity.INFO, text, is_end=True)
    was = ControllerState.UNKNOWN if before is None else before.controller
    if now.controller is not was and now.controller is not ControllerState.UNKNOWN:
        text = f"the CAN controller: {was.value} before, {now.controller.value} now"
        yield Risen("controller", EntryKind.FAULT, Severity.WARNING, text)
