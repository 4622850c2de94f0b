"""The entries of the timeline that ``cruiser review events`` shows."""

from __future__ import annotations

from enum import Enum
from typing import Final

import msgspec

from schemas.decisions import GUARD_STOP_ENDED, EventKind, Severity
from schemas.messages import Count, TimeNs
from schemas.reasons import AS_ASKED, Reason
from schemas.requests import Tick


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
"""Entries with which the robot is commanded no longer, though nobody wanted it so."""

ENDS: Final = STOPS | {EntryKind.END}
"""And with those that somebody asked for."""


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
        holder: the lease's holder then, as far as the log shows; empty if nobody.
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
