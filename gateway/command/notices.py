"""Events that stop nothing.

A late loop, a CAN controller in trouble, another computer's commands, a guard's end.
"""

from __future__ import annotations

from collections.abc import Iterator

from gateway.command.chassis_state import ChassisState
from gateway.command.outcome import Event
from schemas.decisions import GUARD_STOP_ENDED, EventKind, Severity
from schemas.messages import ControllerState
from schemas.reasons import TEXTS, Reason
from schemas.settings import COMMANDER_QUIET_NS, LATE_NS, LATE_TOLD_NS

_GRAVITY = {
    ControllerState.WARNING: Severity.WARNING,
    ControllerState.PASSIVE: Severity.WARNING,
    ControllerState.BUS_OFF: Severity.ERROR,
}


class Notices:
    """Compares the chassis with the tick before, and reports changes as events."""

    def __init__(self) -> None:
        self._late_told_ns = -LATE_TOLD_NS
        self._controller = ControllerState.UNKNOWN
        self._guard_says = ""
        self._is_realtime = False
        self._commander_ns: int | None = None

    def look(self, chassis: ChassisState, now_ns: int, late_ns: int, *, is_idle: bool = False) -> Iterator[Event]:
        """Yield what is new at this tick, which began so late. Of a robot that is idle a late one is no fault."""
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
