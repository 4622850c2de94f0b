"""The chassis over time: standstill, bumpers, faults, who else commands it. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from gateway.chassis.cruiser.frames import SCALED_BY_VARIANT
from gateway.command.actuation import AT_REST, Actuation
from gateway.command.causes import BUMPERS
from gateway.command.chassis_state import ChassisState
from gateway.command.plausibility import Plausibility
from schemas.messages import ControllerState, Mode, ParkingStatus, Variant
from schemas.reasons import Reason
from schemas.settings import (
    BUMPER_CLEAR_NS,
    COMMANDER_NS,
    FOUND_MOVING_NS,
    LOOP_LATE_STOP_NS,
    SEND_FAILURES,
    STANDSTILL_TICKS,
)


class ChassisMonitor:
    """The arbiter's view of the chassis, updated each tick.

    Attributes:
        stands: the robot was seen to stand for long enough. False also when that cannot be seen.
        chassis: the chassis at this tick.
        pressed: the bumpers that are pressed, or have not read clear for long enough.
        struck: those that were clear, a tick before.
        is_rest_confirmed: feedback has answered since a speed was last commanded: a speed that rose and fell, or a
            parking brake that reads applied since it was asked for. Until then a speed of zero may be frozen.
        plausibility: compares the robot's motion with its command.
        send_failures: ticks in a row whose frames the bus did not take.
    """

    def __init__(self) -> None:
        self.chassis = ChassisState()
        self.stands = False
        self.pressed: set[Reason] = set()
        self.struck: set[Reason] = set()
        self.is_rest_confirmed = True
        self.plausibility = Plausibility()
        self.send_failures = 0
        self._has_risen = self._was_released = self._is_parking_asked = False
        self._speeds: tuple[float | None, ...] = ()
        self._unchanged_ns = 0
        self._slow_ticks = 0
        self._moving_since_ns: int | None = None
        self._acknowledged: set[Reason] = set()
        self._pressed_ns: dict[Reason, int] = {}

    def update(self, chassis: ChassisState, now_ns: int, told: Actuation = AT_REST) -> None:
        """Take in the chassis at this tick, and the command that it has."""
        self.chassis = chassis
        self._slow_ticks = self._slow_ticks + 1 if chassis.is_slow else 0
        self.stands = self._slow_ticks >= STANDSTILL_TICKS
        self._confirm_rest(told, now_ns)
        for bumper, is_pressed in zip(BUMPERS, (chassis.front_bumper, chassis.rear_bumper), strict=True):
            if is_pressed:
                self._pressed_ns[bumper] = now_ns
        before = self.pressed
        self.pressed = {b for b, pressed_ns in self._pressed_ns.items() if now_ns - pressed_ns < BUMPER_CLEAR_NS}
        self.struck = self.pressed - before
        # A hit that was reset counts as a new one once the bumper has been clear.
        if self._acknowledged:
            self._acknowledged &= self.pressed

    def rest(self, now_ns: int) -> str:
        """Return whether the robot stands, in words."""
        chassis = self.chassis
        if chassis.is_slow and self.is_rest_confirmed:
            return "the robot stands"
        if chassis.is_slow and self.is_rest_answered:
            return "the robot comes to rest"
        if chassis.is_slow:
            return f"the speed reads 0, unchanged for {(now_ns - self._unchanged_ns) / 1e9:.1f} s, not confirmed"
        if not chassis.moves or chassis.fastest_mps is None:
            return "the robot is not seen to stand"
        return f"the robot moves at {chassis.fastest_mps:.2f} m/s"

    def _confirm_rest(self, told: Actuation, now_ns: int) -> None:
        chassis = self.chassis
        speeds = (chassis.speed_mps, chassis.wheel_speed_mps, chassis.fastest_wheel_mps)
        if speeds != self._speeds:
            self._speeds, self._unchanged_ns = speeds, now_ns
        is_released = chassis.brake is ParkingStatus.RELEASED
        if told.speed_mps:
            self.is_rest_confirmed = self._is_parking_asked = False
            self._has_risen, self._was_released = chassis.moves, is_released
        elif not self.is_rest_confirmed:
            self._has_risen |= chassis.moves
            self._was_released |= is_released
            self._is_parking_asked |= told.parking
            is_braked = self._was_released and self._is_parking_asked and chassis.brake is ParkingStatus.APPLIED
            self.is_rest_confirmed = self.stands and (self._has_risen or is_braked)

    @property
    def is_rest_answered(self) -> bool:
        """Rest is confirmed, or only waits for speeds that answered the command to read slow for long enough."""
        return self.is_rest_confirmed or (self._has_risen and not self.stands)

    @property
    def hits(self) -> list[Reason]:
        """The bumpers that are pressed and that nobody has acknowledged by a reset."""
        return (
            [bumper for bumper in BUMPERS if bumper in self.pressed - self._acknowledged] if self.pressed else []
        )

    def acknowledge(self, latched: Iterable[Reason]) -> None:
        """A reset of these: from now on such a bumper, while pressed, forbids its direction and nothing more."""
        self._acknowledged |= self.pressed.intersection(latched)

    def is_commanded_by_other(self, now_ns: int) -> bool:
        """Another computer's command frames are on the bus."""
        received_ns = self.chassis.commander_ns
        return received_ns is not None and now_ns - received_ns < COMMANDER_NS

    def chassis_faults(self) -> list[Reason]:
        """Return what speaks against commanding the chassis, but for its mode."""
        chassis = self.chassis
        faults = (
            (Reason.BUS_OFF, chassis.controller is ControllerState.BUS_OFF),
            (Reason.FEEDBACK_MISSING, chassis.missing),
            (Reason.FEEDBACK_FAULTY, chassis.faulty or chassis.absurd),
            (Reason.FEEDBACK_LATE, chassis.is_behind),
            (Reason.VARIANT_UNKNOWN, chassis.variant is Variant.UNKNOWN or not chassis.confirmed),
        )
        return [reason for reason, is_so in faults if is_so]

    def faults(
        self, told: Actuation, limit_mps: float, late_ns: int, now_ns: int, *, is_engaged: bool
    ) -> list[Reason]:
        """Return the causes to stop a robot that has this command, under this speed limit."""
        chassis = self.chassis
        found = self.chassis_faults()
        if chassis.absurd and not set(SCALED_BY_VARIANT).isdisjoint(chassis.absurd):
            # Read in the wrong scale a speed is 40 times too high: no other fault looks like it.
            found.insert(0, Reason.IMPLAUSIBLE_SPEED)
        found += self.plausibility.check(chassis, told, limit_mps, now_ns, is_engaged=is_engaged)
        if late_ns > LOOP_LATE_STOP_NS:
            found.append(Reason.LOOP_LATE)
        if self.send_failures >= SEND_FAILURES:
            found.append(Reason.SEND_FAILED)
        if self.is_commanded_by_other(now_ns):
            found.append(Reason.OTHER_COMMANDER)
        return found

    def fault_detail(self, reason: Reason, late_ns: int) -> str:
        """Return the figures that a reason's own text does not have."""
        return {
            Reason.FEEDBACK_MISSING: ", ".join(self.chassis.missing),
            Reason.FEEDBACK_FAULTY: ", ".join([*self.chassis.faulty, *self.chassis.absurd]),
            Reason.LOOP_LATE: f"by {late_ns / 1e6:.0f} ms",
        }.get(reason) or self.plausibility.details.get(reason, self._absurd_speed(reason))

    def _absurd_speed(self, reason: Reason) -> str:
        if reason is not Reason.IMPLAUSIBLE_SPEED:
            return ""
        frames = ", ".join(name for name in self.chassis.absurd if name in SCALED_BY_VARIANT)
        other = {Variant.COARSE: "the fine scale", Variant.FINE: "the coarse scale"}.get(self.chassis.variant)
        return f"{frames} reads beyond what the chassis can do" + (f"; {other} may fit" if other else "")

    def found_moving(self, now_ns: int) -> bool:
        """The chassis moves, nobody commands it, the remote control neither, and that is no accident."""
        adrift = self.chassis.mode is not Mode.REMOTE and not self.is_commanded_by_other(now_ns)
        if not adrift or not self.chassis.moves:
            self._moving_since_ns = None
            return False
        if self._moving_since_ns is None:
            self._moving_since_ns = now_ns
        return now_ns - self._moving_since_ns >= FOUND_MOVING_NS
