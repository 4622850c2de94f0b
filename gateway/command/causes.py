"""What stops the robot: one table of causes, and the watch that finds them in what is observed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import msgspec

from gateway.command.actuation import Actuation
from gateway.command.observed import Observed
from gateway.command.plausibility import Plausibility
from schemas.messages import ControllerState, Mode, Variant
from schemas.reasons import Reason
from schemas.settings import (
    BUMPER_CLEAR_NS,
    COMMANDER_NS,
    FOUND_MOVING_NS,
    LOOP_LATE_STOP_NS,
    SEND_FAILURES,
    STANDSTILL_TICKS,
)


class Stop(msgspec.Struct, frozen=True):
    """How a cause stops the robot.

    Attributes:
        at_once: with the emergency deceleration; else with the normal one.
        latched: the robot cannot be engaged again before a reset.
        ramps: the commanded speed goes to zero by that deceleration. Where its scale is in doubt it is zero at
            once: a ramp in the wrong scale would ask for 40 times the speed.
        parks: the parking brake is applied at once, at whatever speed.
    """

    at_once: bool
    latched: bool = False
    ramps: bool = True
    parks: bool = False


STOPS: Final[dict[Reason, Stop]] = {
    Reason.REMOTE_STOP: Stop(at_once=True, latched=True),
    Reason.FRONT_BUMPER: Stop(at_once=True, latched=True),
    Reason.REAR_BUMPER: Stop(at_once=True, latched=True),
    Reason.ROLLING: Stop(at_once=True, latched=True, parks=True),
    Reason.IMPLAUSIBLE_SPEED: Stop(at_once=True, latched=True, ramps=False),
    Reason.OVERSPEED: Stop(at_once=True, latched=True),
    Reason.STEERING: Stop(at_once=True, latched=True),
    Reason.FEEDBACK_FROZEN: Stop(at_once=True, latched=True),
    Reason.GATE: Stop(at_once=True, latched=True, parks=True),
    Reason.GUARD: Stop(at_once=True, latched=True),
    Reason.MODE_NOT_AUTO: Stop(at_once=True, parks=True),
    Reason.BUS_OFF: Stop(at_once=True),
    Reason.FEEDBACK_MISSING: Stop(at_once=True),
    Reason.FEEDBACK_FAULTY: Stop(at_once=True),
    Reason.FEEDBACK_LATE: Stop(at_once=True),
    Reason.VARIANT_UNKNOWN: Stop(at_once=True, ramps=False),
    Reason.OTHER_COMMANDER: Stop(at_once=True),
    Reason.LOOP_LATE: Stop(at_once=True),
    Reason.SEND_FAILED: Stop(at_once=True),
    Reason.UNGUARDED: Stop(at_once=False),
    Reason.DEADMAN: Stop(at_once=False),
    Reason.DISENGAGED: Stop(at_once=False),
    Reason.LEASE_EXPIRED: Stop(at_once=False),
    Reason.LEASE_RELEASED: Stop(at_once=False),
    Reason.LEASE_TAKEN: Stop(at_once=False),
    Reason.NOT_CONFIRMED: Stop(at_once=False),
    Reason.FOUND_MOVING: Stop(at_once=False),
    Reason.SHUTDOWN: Stop(at_once=False),
}
"""Every cause to stop, the gravest first."""

AS_ASKED: Final = frozenset({Reason.DISENGAGED, Reason.LEASE_RELEASED, Reason.SHUTDOWN})
"""Stops that the driver, or who runs the gateway, asked for: nothing is wrong, at whatever speed."""

SPEED_FRAMES: Final = frozenset({"Auto_DriveFeedBack", "Auto_WheelSpdFeedback"})

BUMPERS: Final = (Reason.FRONT_BUMPER, Reason.REAR_BUMPER)


class Watch:
    """Looks at the chassis each tick.

    Attributes:
        stands: the robot was seen to stand for long enough. False also when that cannot be seen.
        observed: the chassis at this tick.
        pressed: the bumpers that are pressed, or have not read clear for long enough.
        struck: those that were clear, a tick before.
        plausibility: does the robot do what it is told.
        send_failures: ticks in a row whose frames the bus did not take.
    """

    def __init__(self) -> None:
        self.observed = Observed()
        self.stands = False
        self.pressed: set[Reason] = set()
        self.struck: set[Reason] = set()
        self.plausibility = Plausibility()
        self.send_failures = 0
        self._slow_ticks = 0
        self._moving_since_ns: int | None = None
        self._acknowledged: set[Reason] = set()
        self._pressed_ns: dict[Reason, int] = {}

    def observe(self, observed: Observed, now_ns: int) -> None:
        """Take in the chassis at this tick."""
        self.observed = observed
        self._slow_ticks = self._slow_ticks + 1 if observed.is_slow else 0
        self.stands = self._slow_ticks >= STANDSTILL_TICKS
        for bumper, is_pressed in zip(BUMPERS, (observed.front_bumper, observed.rear_bumper), strict=True):
            if is_pressed:
                self._pressed_ns[bumper] = now_ns
        before = self.pressed
        self.pressed = {b for b, pressed_ns in self._pressed_ns.items() if now_ns - pressed_ns < BUMPER_CLEAR_NS}
        self.struck = self.pressed - before
        # A hit that was reset counts as a new one once the bumper has been clear.
        if self._acknowledged:
            self._acknowledged &= self.pressed

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
        heard_ns = self.observed.commander_ns
        return heard_ns is not None and now_ns - heard_ns < COMMANDER_NS

    def chassis_faults(self) -> list[Reason]:
        """What speaks against commanding the chassis, but for its mode."""
        observed = self.observed
        faults = (
            (Reason.BUS_OFF, observed.controller is ControllerState.BUS_OFF),
            (Reason.FEEDBACK_MISSING, observed.missing),
            (Reason.FEEDBACK_FAULTY, observed.faulty or observed.absurd),
            (Reason.FEEDBACK_LATE, observed.is_behind),
            (Reason.VARIANT_UNKNOWN, observed.variant is Variant.UNKNOWN or not observed.confirmed),
        )
        return [reason for reason, is_so in faults if is_so]

    def faults(self, told: Actuation, limit_mps: float, late_ns: int, now_ns: int) -> list[Reason]:
        """The causes to stop a robot that is being told this, under this speed limit."""
        observed = self.observed
        found = self.chassis_faults()
        if observed.absurd and not SPEED_FRAMES.isdisjoint(observed.absurd):
            # Read in the wrong scale a speed is 40 times too high: no other fault looks like it.
            found.insert(0, Reason.IMPLAUSIBLE_SPEED)
        found += self.plausibility.observe(observed, told, limit_mps, now_ns)
        if late_ns > LOOP_LATE_STOP_NS:
            found.append(Reason.LOOP_LATE)
        if self.send_failures >= SEND_FAILURES:
            found.append(Reason.SEND_FAILED)
        if self.is_commanded_by_other(now_ns):
            found.append(Reason.OTHER_COMMANDER)
        return found

    def fault_detail(self, reason: Reason, late_ns: int) -> str:
        """What a reason's own text does not say."""
        return {
            Reason.FEEDBACK_MISSING: ", ".join(self.observed.missing),
            Reason.FEEDBACK_FAULTY: ", ".join([*self.observed.faulty, *self.observed.absurd]),
            Reason.LOOP_LATE: f"by {late_ns / 1e6:.0f} ms",
        }.get(reason) or self.plausibility.details.get(reason, self._absurd_speed(reason))

    def _absurd_speed(self, reason: Reason) -> str:
        if reason is not Reason.IMPLAUSIBLE_SPEED:
            return ""
        frames = ", ".join(name for name in self.observed.absurd if name in SPEED_FRAMES)
        other = {Variant.COARSE: "the fine scale", Variant.FINE: "the coarse scale"}.get(self.observed.variant)
        return f"{frames} reads beyond what the chassis can do" + (f"; {other} may fit" if other else "")

    def found_moving(self, now_ns: int) -> bool:
        """The chassis moves, nobody commands it, the remote control neither, and that is no accident."""
        adrift = self.observed.mode is not Mode.REMOTE and not self.is_commanded_by_other(now_ns)
        if not adrift or not self.observed.moves:
            self._moving_since_ns = None
            return False
        if self._moving_since_ns is None:
            self._moving_since_ns = now_ns
        return now_ns - self._moving_since_ns >= FOUND_MOVING_NS
