"""The outcome of a tick of the arbiter."""

from __future__ import annotations

import msgspec

from gateway.command.actuation import Actuation
from gateway.command.auxiliary import AuxiliaryFrame
from gateway.command.request import Judged, VerbAnswer
from schemas.decisions import EventKind, Severity
from schemas.reasons import Reason


class Event(msgspec.Struct, frozen=True):
    """An event for people; becomes a SafetyEvent."""

    severity: Severity
    kind: EventKind
    reason: Reason
    text: str
    operator: str = ""


class TickOutcome(msgspec.Struct, frozen=True):
    """The outcome of a tick.

    Attributes:
        actuation: the five motion frames; None for silence.
        auxiliary: lamps, horn and odometer, only ever together with the five.
        judged: the requests of this tick with their rulings.
        answers: replies that are due.
    """

    actuation: Actuation | None
    auxiliary: list[AuxiliaryFrame]
    judged: list[Judged]
    answers: list[VerbAnswer]
    events: list[Event]
