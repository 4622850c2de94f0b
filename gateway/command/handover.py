"""Handover of the chassis to others: when our output has to cease, and which command remains active. Pure."""

from __future__ import annotations

import msgspec

from gateway.command.actuation import Actuation
from gateway.command.chassis_state import ChassisState
from schemas.messages import Mode, ParkingStatus
from schemas.reasons import Reason
from schemas.settings import LEFT_BLIND_NS, YIELD_BURSTS


def may_obey(chassis: ChassisState) -> bool:
    """Return True if the chassis may be in auto with an old command, and nobody else stops it."""
    return chassis.bus_up and chassis.mode in {Mode.AUTO, Mode.UNDEFINED} and not chassis.guard_sends


def may_be_stopped(chassis: ChassisState) -> bool:
    """Return True if a stop can be sent: the chassis may have an old command, or is in mode stop and not held."""
    is_loose = chassis.mode is Mode.STOP and (chassis.moves or chassis.brake is ParkingStatus.RELEASED)
    return may_obey(chassis) or (chassis.bus_up and is_loose and not chassis.guard_sends)


class Handover:
    """The handover of a chassis to others, and back.

    Attributes:
        left: the command that the chassis had when it was left to somebody else, unless that has been ended since.
            It may execute that again.
        is_cut_off: our way to the bus was lost while the chassis was under command, and is not back. The chassis
            keeps moving: only the guard, which has a way of its own, can stop it.
    """

    def __init__(self) -> None:
        self.left: Actuation | None = None
        self.is_cut_off = False
        self._partings = 0
        self._is_remote = self._is_held_by_motor = False
        self._left_ns = 0
        self._was_auto = False
        self._bus_losses = self._guard_stops = 0

    def begin(self, chassis: ChassisState) -> None:
        """Note that we command the chassis from here on."""
        self.left = None
        self._partings = 0
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

    def leave(
        self,
        told: Actuation,
        reason: Reason,
        chassis: ChassisState,
        now_ns: int,
        *,
        is_held_by_motor: bool = False,
    ) -> None:
        """Note that our output ceases, for this reason; lamps and horn stay as they are in the chassis."""
        self.left = told
        self._is_held_by_motor = is_held_by_motor
        self._partings = YIELD_BURSTS if reason is Reason.HAND_TRANSMITTER and told.enabled else 0
        self._left_ns = now_ns
        self.is_cut_off = reason is Reason.BUS_DOWN and not chassis.bus_up

    def part(self, chassis: ChassisState) -> Actuation | None:
        """Return the next command that leaves no speed in a chassis which the remote control has; None at the end.

        The chassis keeps its last command, and executes it when the remote control gives it back.
        """
        is_theirs = chassis.mode is Mode.REMOTE and chassis.bus_up and not chassis.guard_sends
        if not self._partings or self.left is None or not is_theirs:
            self._partings = 0
            return None
        self._partings -= 1
        # Where the motor alone held it, the parking brake would let it roll once it is given back.
        parking = not self._is_held_by_motor
        return msgspec.structs.replace(self.left, speed_mps=0.0, parking=parking)

    def is_given_back(self, chassis: ChassisState) -> bool:
        """Return True in the tick in which the remote control gives the chassis back. For each tick in standby."""
        was_remote = self._is_remote
        if chassis.mode is not Mode.UNDEFINED:
            self._is_remote = chassis.mode is Mode.REMOTE
        return was_remote and not self._is_remote

    def is_blind(self, chassis: ChassisState, now_ns: int) -> bool:
        """Return True if the mode is unknown, and a body frame may still come: the bus has only just returned."""
        return chassis.mode is Mode.UNDEFINED and now_ns - self._left_ns < LEFT_BLIND_NS

    def is_obeyed_again(self, chassis: ChassisState, now_ns: int, *, is_taken: bool) -> bool:
        """Return True if the chassis may execute the command it was left with. For each tick without output.

        Args:
            chassis: the chassis now.
            now_ns: monotonic.
            is_taken: another computer commands it.
        """
        if is_taken:
            self.left = None
        if not chassis.bus_up:
            self._left_ns = now_ns
        return self.left is not None and may_be_stopped(chassis) and not self.is_blind(chassis, now_ns)
