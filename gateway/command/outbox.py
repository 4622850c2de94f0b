"""Replies and events of a tick, until they are taken. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from gateway.command.outcome import Event
from gateway.command.request import RawRequest, Ruling, VerbAnswer
from schemas.decisions import EventKind, Severity
from schemas.reasons import Reason


class Outbox:
    """Answers to whom waits for one, and events for people."""

    def __init__(self) -> None:
        self._pending: dict[str, int] = {}
        self._answers: list[VerbAnswer] = []
        self._events: list[Event] = []

    def take(self) -> tuple[list[VerbAnswer], list[Event]]:
        """Return what is due, and keep only the requests that are still to be answered."""
        due = self._answers, self._events
        self._answers, self._events = [], []
        return due

    def add_event(
        self, severity: Severity, kind: EventKind, reason: Reason, text: str, operator: str = ""
    ) -> None:
        """Report to people."""
        self._events.append(Event(severity, kind, reason, text, operator))

    def add_events(self, events: Iterable[Event]) -> None:
        """Report these to people."""
        self._events += events

    def answer(self, request: RawRequest, ruling: Ruling) -> None:
        """Answer a query, now or, if its ruling is pending, by ``settle``."""
        if ruling.is_pending:
            self._pending[request.verb] = request.handle
        elif request.is_query:
            self._answers.append(VerbAnswer(request.handle, request.verb, ruling))

    def settle(self, verb: str, ruling: Ruling) -> None:
        """Answer the pending request of this verb, if there is one."""
        handle = self._pending.pop(verb, None)
        if handle is not None:
            self._answers.append(VerbAnswer(handle, verb, ruling))

    def refuse_pending(self, reason: Reason, detail: str) -> None:
        """Answer all pending requests: what they asked for has failed."""
        for verb in list(self._pending):
            self.settle(verb, Ruling(reason, detail))
