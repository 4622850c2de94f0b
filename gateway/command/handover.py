"""The chassis in others' hands: when our output has to cease, and what may be obeyed after that. Pure."""

from __future__ import annotations

from gateway.command.actuation import Actuation
from gateway.command.chassis_state import ChassisState
from schemas.messages import Mode, ParkingStatus
from schemas.reasons import Reason
from schemas.settings import LEFT_BLIND_NS


def may_obey(chassis: ChassisState) -> bool:
    """The chassis may be in auto and obey an old command, and nobody else sees to it."""
    return chassis.bus_up and chassis.mode in {Mode.AUTO, Mode.UNDEFINED} and not chassis.guard_sends


def may_be_stopped(chassis: ChassisState) -> bool:
    """A stop can be told: to a chassis that may obey a command, and to one in mode stop that is not held."""
    is_loose = chassis.mode is Mode.STOP and (chassis.moves or chassis.brake is ParkingStatus.RELEASED)
    return may_obey(chassis) or (chassis.bus_up and is_loose and not chassis.guard_sends)


class Handover:
    """The way of a chassis from us to others, and back.

    Attributes:
        left: what the chassis had been told when it was left to somebody else, unless that has been ended since.
            It may obey that again.
        is_cut_off: our way to the bus was lost while the chassis was being told something, and is not back. The
            chassis obeys on: only the guard, which has a way of its own, can stop it.
    """

    def __init__(self) -> None:
        self.left: Actuation | None = None
        self.is_cut_off = False
        self._left_ns = 0
        self._was_auto = False
        self._bus_losses = self._guard_stops = 0

    def begin(self, chassis: ChassisState) -> None:
        """From here on we tell the chassis something."""
        self.left = None
        self._was_auto = False
        self._bus_losses = chassis.bus_losses
        self._guard_stops = chassis.guard_stops

    def reason_to_yield(self, chassis: ChassisState) -> Reason:
        """Return why the output to the chassis has to cease now; NONE if it need not."""
        self._was_auto = self._was_auto or chassis.mode is Mode.AUTO
        if chassis.guard_sends or chassis.guard_stops != self._guard_stops:
            # Also when it has ended by now: this process was stopped meanwhile, and what it knows is old.
            return Reason.GUARD
        if not chassis.bus_up or chassis.bus_losses != self._bus_losses:
            return Reason.BUS_DOWN
        if chassis.mode is Mode.REMOTE:
            return Reason.HAND_TRANSMITTER
        if chassis.mode is Mode.STOP and self._was_auto:
            return Reason.MODE_NOT_AUTO
        return Reason.NONE

    def leave(self, told: Actuation, reason: Reason, chassis: ChassisState, now_ns: int) -> None:
        """Nothing is told any more, for this reason; lamps and horn stay as they are in the chassis."""
        self.left = told
        self._left_ns = now_ns
        self.is_cut_off = reason is Reason.BUS_DOWN and not chassis.bus_up

    def is_obeyed_again(self, chassis: ChassisState, now_ns: int, *, is_taken: bool) -> bool:
        """Return whether the chassis may obey what it was left on. Asked each tick while nothing is sent.

        Args:
            chassis: the chassis now.
            now_ns: monotonic.
            is_taken: another computer commands it.
        """
        if is_taken:
            self.left = None
        # What is not seen right after the bus has come back may be seen in a moment.
        is_blind = chassis.mode is Mode.UNDEFINED and now_ns - self._left_ns < LEFT_BLIND_NS
        if not chassis.bus_up:
            self._left_ns = now_ns
        return self.left is not None and may_be_stopped(chassis) and not is_blind
