"""The chassis over time: standstill, bumpers, faults of feedback, other commanders, plausible motion. Pure.

``Plausibility`` compares the speeds with the command, with each other and with the limit, and checks direction and
steering. With the wrong speed scale a chassis moves 40 times as fast or slow as commanded; on a slope it moves
without a command.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from math import inf
from operator import sub
from typing import Final

import msgspec

from gateway.chassis.port import AT_REST, Actuation, Chassis, ChassisState
from gateway.command.rulings import BUMPERS
from schemas.messages import ControllerState, Mode, ParkingStatus, Variant
from schemas.reasons import Reason
from schemas.settings import (
    BUMPER_CLEAR_NS,
    COMMANDER_NS,
    CREEP_REST_NS,
    CREEPING_NS,
    DRIVE_LAG_S,
    FOUND_MOVING_NS,
    FROZEN_BODY_M,
    FROZEN_COMMAND_MPS,
    FROZEN_NS,
    FROZEN_STANDING_COMMAND_MPS,
    FROZEN_STANDING_KM,
    FROZEN_STILL_NS,
    GATHERING_MPS,
    IMPLAUSIBLE_MPS,
    IMPLAUSIBLE_NS,
    IMPLAUSIBLE_RATIO,
    LOOP_LATE_STOP_NS,
    NOT_MOVING_COMMAND_MPS,
    NOT_MOVING_MPS,
    NOT_MOVING_NS,
    OVERSPEED_MPS,
    OVERSPEED_NS,
    PULSES_REST_S,
    REFERENCE_DECELERATION_MPS2,
    ROLLING_MPS,
    ROLLING_NS,
    RUNAWAY_NS,
    RUNAWAY_RISE_MPS,
    RUNAWAY_WINDOW_NS,
    SEND_FAILURES,
    STANDSTILL_MPS,
    STANDSTILL_TICKS,
    STEERING_DEVIATION_DEG,
    STEERING_DEVIATION_NS,
    STEERING_FOLLOWS_DEGPS,
    STEERING_LAG_S,
)

_HAIR: Final = 1e-9
"""Tolerance against rounding, for speeds exactly on a bound."""


def exceeds(larger_mps: float, smaller_mps: float) -> bool:
    """The larger exceeds the smaller by more than the allowed difference and factor."""
    return larger_mps > smaller_mps + IMPLAUSIBLE_MPS and larger_mps > smaller_mps * IMPLAUSIBLE_RATIO


def fits(one_mps: float, other_mps: float) -> bool:
    return not exceeds(one_mps, other_mps) and not exceeds(other_mps, one_mps)


def fitting_scale(drive_mps: float, wheel_mps: float, scale_ratio: float) -> str:
    """Name the scale in which the drive frames would match the wheels; empty if they match, or none does."""
    if fits(drive_mps, wheel_mps):
        return ""
    for factor, words in ((scale_ratio, "the coarse scale"), (1 / scale_ratio, "the fine scale")):
        if fits(drive_mps * factor, wheel_mps):
            return f"; {words} of the drive frames would fit"
    return ""


class Envelope:
    """The speeds and angles that the robot may have under its commands, with the lag of a slow chassis.

    Attributes:
        forward_mps, backward_mps: the highest speed each way.
        lagging_mps: the speed of a chassis with the longest lag, forward positive.
        forward_rest_s, backward_rest_s: time at rest without a command that way; at most ``PULSES_REST_S``.
        left_deg, right_deg: the furthest angles, left positive.
    """

    def __init__(self, speed_mps: float, angle_deg: float) -> None:
        self.forward_mps = max(0.0, speed_mps)
        self.backward_mps = max(0.0, -speed_mps)
        self.lagging_mps = speed_mps
        self.forward_rest_s = self.backward_rest_s = PULSES_REST_S
        self.left_deg = self.right_deg = angle_deg

    def follow(self, told: Actuation, elapsed_s: float) -> None:
        """Advance the envelope by the time since the last call, under this command."""
        forward_mps, backward_mps = max(told.signed_speed_mps, 0.0), max(-told.signed_speed_mps, 0.0)
        self.lagging_mps += (told.signed_speed_mps - self.lagging_mps) * min(1.0, elapsed_s / DRIVE_LAG_S)
        self.forward_mps = _fallen(self.forward_mps, forward_mps, elapsed_s)
        self.backward_mps = _fallen(self.backward_mps, backward_mps, elapsed_s)
        self.forward_rest_s = _rested(self.forward_rest_s, forward_mps, self.forward_mps, elapsed_s)
        self.backward_rest_s = _rested(self.backward_rest_s, backward_mps, self.backward_mps, elapsed_s)
        self.left_deg = told.angle_deg + _turned(max(0.0, self.left_deg - told.angle_deg), elapsed_s)
        self.right_deg = told.angle_deg - _turned(max(0.0, told.angle_deg - self.right_deg), elapsed_s)


def _fallen(before_mps: float, told_mps: float, elapsed_s: float) -> float:
    """Return the speed that a slow chassis may still have while it slows down to the commanded one."""
    lag_mps = (before_mps - told_mps) * min(1.0, elapsed_s / DRIVE_LAG_S)
    return max(told_mps, before_mps - min(lag_mps, REFERENCE_DECELERATION_MPS2 * elapsed_s))


def _turned(off_deg: float, elapsed_s: float) -> float:
    """Return how far off slow wheels may still be while they turn to the commanded angle."""
    lag_deg = off_deg * min(1.0, elapsed_s / STEERING_LAG_S)
    return off_deg - min(lag_deg, STEERING_FOLLOWS_DEGPS * elapsed_s)


def _rested(before_s: float, told_mps: float, speed_mps: float, elapsed_s: float) -> float:
    """Return the time at rest, given the time before. A robot commanded to creep is never at rest."""
    return 0.0 if told_mps or speed_mps >= STANDSTILL_MPS else min(before_s + elapsed_s, PULSES_REST_S)


class Stillness:
    """Detects speeds that are frozen while the command, the pulses or the mileage change."""

    def __init__(self, lagging_mps: float) -> None:
        self._seen: tuple[float | None, ...] = ()
        self._since_ns = 0
        self._lowest_mps: tuple[float, ...]
        self._highest_mps: tuple[float, ...]
        self._lowest_mps = self._highest_mps = (lagging_mps, lagging_mps)
        self._commanded_mps = 0.0
        self._mileage_km: float | None = None

    def look(self, chassis: ChassisState, told: Actuation, lagging_mps: float, now_ns: int) -> None:
        """Update with the chassis, its command and the lagging command of this tick."""
        seen = (chassis.speed_mps, chassis.wheel_speed_mps, chassis.fastest_wheel_mps)
        # With the longest lag and with none, for a chassis that follows at once.
        commanded_mps = (told.signed_speed_mps, lagging_mps)
        if seen != self._seen:
            self._seen, self._since_ns = seen, now_ns
            self._lowest_mps = self._highest_mps = commanded_mps
        self._lowest_mps = tuple(map(min, self._lowest_mps, commanded_mps))
        self._highest_mps = tuple(map(max, self._highest_mps, commanded_mps))
        self._commanded_mps = min(told.speed_mps, abs(lagging_mps))
        mileage_km = chassis.total_mileage_km
        is_cleared = mileage_km is None or self._mileage_km is None or mileage_km < self._mileage_km
        if is_cleared or not chassis.reads_zero or self._commanded_mps <= FROZEN_STANDING_COMMAND_MPS:
            self._mileage_km = mileage_km

    def frozen(self, chassis: ChassisState, now_ns: int) -> str:
        """Return what contradicts the speeds, in words; empty if nothing."""
        if chassis.reads_zero:
            # At rest every reading is the same: only pulses or mileage show that the speeds are frozen.
            if self._commanded_mps <= FROZEN_STANDING_COMMAND_MPS:
                return ""
            counted_km = (chassis.total_mileage_km or 0.0) - (self._mileage_km or 0.0)
            if chassis.pulses:
                return "drive feedback and wheel speeds read zero, but the wheel pulses count"
            if counted_km >= FROZEN_STANDING_KM - _HAIR:
                return (
                    f"drive feedback and wheel speeds read zero, but the mileage rose by {counted_km * 1e3:.0f} m"
                )
            return ""
        changed_mps = min(map(sub, self._highest_mps, self._lowest_mps))
        if now_ns - self._since_ns < FROZEN_NS or changed_mps <= FROZEN_COMMAND_MPS or chassis.speed_mps is None:
            return ""
        return f"drive feedback and wheel speeds unchanged while the command changed by {changed_mps:.2f} m/s"


class Plausibility:
    """Watches a robot that is being commanded.

    Attributes:
        details: the contradictions in words, by reason.
        runs_away: the robot is faster than commanded, and accelerates: its motor does not hold it.
    """

    def __init__(self, chassis: Chassis) -> None:
        self._design = chassis
        # The way since the last change of the mileage survives an engagement.
        self._mileage_km: float | None = None
        self._driven_m = 0.0
        self.forget()

    def forget(self, speed_mps: float = 0.0, angle_deg: float = 0.0) -> None:
        """Start again with a robot that has this signed speed and this angle."""
        self.details: dict[Reason, str] = {}
        self.runs_away = False
        self._envelope = Envelope(speed_mps, angle_deg)
        self._stillness = Stillness(speed_mps)
        self._speeds: deque[tuple[int, float]] = deque()
        self._slowest_mps = inf
        self._since_ns: dict[str, int] = {}
        self._checked_ns: int | None = None

    def check(
        self, chassis: ChassisState, told: Actuation, limit_mps: float, now_ns: int, *, is_engaged: bool = True
    ) -> list[Reason]:
        """Return the reasons for which the motion has been implausible for too long."""
        elapsed_s = 0.0 if self._checked_ns is None else (now_ns - self._checked_ns) / 1e9
        self._checked_ns = now_ns
        self._envelope.follow(told, elapsed_s)
        self._count_way(chassis, elapsed_s)
        self._stillness.look(chassis, told, self._envelope.lagging_mps, now_ns)
        frozen = f"mileage unchanged over {self._driven_m:.1f} m" if self._driven_m > FROZEN_BODY_M else ""
        still = self._stillness.frozen(chassis, now_ns) if is_engaged else ""
        runs = self._runaway(chassis, now_ns)
        too_fast = Reason.OVERSPEED if self._overspeed(chassis, limit_mps) else Reason.IMPLAUSIBLE_SPEED
        found = (
            ("runs", too_fast, RUNAWAY_NS, runs),
            ("speeds", Reason.IMPLAUSIBLE_SPEED, IMPLAUSIBLE_NS, self._misfit(chassis)),
            ("rolls", Reason.ROLLING, ROLLING_NS, self._rolling(chassis, told, ROLLING_MPS)),
            ("creeps", Reason.ROLLING, CREEPING_NS, self._rolling(chassis, told, STANDSTILL_MPS)),
            ("overspeed", Reason.OVERSPEED, OVERSPEED_NS, self._overspeed(chassis, limit_mps)),
            ("steering", Reason.STEERING, STEERING_DEVIATION_NS, self._deviation(chassis)),
            ("frozen", Reason.FEEDBACK_FROZEN, 0, frozen),
            ("still", Reason.FEEDBACK_FROZEN, FROZEN_STILL_NS, still),
            ("blocked", Reason.NOT_MOVING, NOT_MOVING_NS, self._not_moving(chassis, told) if is_engaged else ""),
        )
        lasting = {
            check: reason
            for check, reason, least_ns, detail in found
            if self._lasts(check, reason, detail, now_ns) >= least_ns
        }
        self.runs_away = "runs" in lasting
        return list(dict.fromkeys(lasting.values()))

    def rolling_ns(self, now_ns: int) -> int:
        return now_ns - min(self._since_ns.get("rolls", now_ns), self._since_ns.get("creeps", now_ns))

    def _lasts(self, check: str, reason: Reason, detail: str, now_ns: int) -> int:
        """Return for how long the check has failed; -1 if it passes."""
        if not detail:
            self._since_ns.pop(check, None)
            return -1
        self.details[reason] = detail
        return now_ns - self._since_ns.setdefault(check, now_ns)

    def _misfit(self, chassis: ChassisState) -> str:
        wheel_mps, drive_mps = chassis.wheel_speed_mps, chassis.speed_mps
        if wheel_mps is None or drive_mps is None:
            return ""  # Missing feedback is a separate cause.
        envelope = self._envelope
        reference_mps = envelope.forward_mps if wheel_mps >= 0 else envelope.backward_mps
        way = "forward" if wheel_mps >= 0 else "backward"
        wheel_mps = abs(wheel_mps)
        ratio = self._design.scale_ratio
        fit = fitting_scale(drive_mps, wheel_mps, ratio) or fitting_scale(reference_mps, wheel_mps, ratio)
        if exceeds(wheel_mps, reference_mps):
            return f"the wheels turn {way} at {wheel_mps:.2f} m/s, commanded {reference_mps:.2f} m/s{fit}"
        if not fits(wheel_mps, drive_mps):
            return f"the wheels turn at {wheel_mps:.2f} m/s, drive feedback reads {drive_mps:.2f} m/s{fit}"
        return ""

    def _rolling(self, chassis: ChassisState, told: Actuation, bound_mps: float) -> str:
        """Describe motion in a direction that is not commanded, beyond the bound and the rest of a ramp."""
        told_mps, wheels_mps = told.signed_speed_mps, chassis.wheel_speed_mps or 0.0
        envelope = self._envelope
        for sign, way, left_mps, rest_s in (
            (1, "forward", envelope.forward_mps, envelope.forward_rest_s),
            (-1, "backward", envelope.backward_mps, envelope.backward_rest_s),
        ):
            if told_mps * sign > 0:
                continue
            if wheels_mps * sign > left_mps + bound_mps:
                return f"{way} at {abs(wheels_mps):.2f} m/s by the wheels"
            # Before that, half of the pulses may be of the ramp up and half of the ramp down, and look steady.
            if chassis.pulses == sign and rest_s >= PULSES_REST_S:
                return f"{way} by the wheel pulses"
            if chassis.creeps == sign and rest_s >= PULSES_REST_S:
                return f"{way} slowly, by the wheel pulses"
        fastest_mps = chassis.fastest_mps or 0.0
        if not told_mps and fastest_mps > max(envelope.forward_mps, envelope.backward_mps) + bound_mps:
            return f"at {fastest_mps:.2f} m/s"
        return ""

    def _overspeed(self, chassis: ChassisState, limit_mps: float) -> str:
        """Describe a speed over the limit; a limit that was just lowered has to be reached first."""
        speeds = (chassis.speed_mps or 0.0, abs(chassis.wheel_speed_mps or 0.0))
        bound_mps = max(limit_mps, self._envelope.forward_mps, self._envelope.backward_mps)
        if max(speeds) < bound_mps + OVERSPEED_MPS - _HAIR:
            return ""
        return f"{max(speeds):.2f} m/s, the limit is {limit_mps:.2f} m/s"

    def _runaway(self, chassis: ChassisState, now_ns: int) -> str:
        """Describe a speed above the command that still rises: no ramp explains that, only a dead motor."""
        speed_mps, speeds = chassis.fastest_mps or 0.0, self._speeds
        speeds.append((now_ns, speed_mps))
        while now_ns - speeds[0][0] > RUNAWAY_WINDOW_NS:
            speeds.popleft()
        commanded_mps = max(self._envelope.forward_mps, self._envelope.backward_mps)
        is_over = speed_mps >= commanded_mps + OVERSPEED_MPS - _HAIR
        if not is_over or speed_mps <= min(before_mps for _, before_mps in speeds) + RUNAWAY_RISE_MPS + _HAIR:
            return ""
        return f"{speed_mps:.2f} m/s and rising, commanded {commanded_mps:.2f} m/s"

    def _not_moving(self, chassis: ChassisState, told: Actuation) -> str:
        """Describe a robot that stands although commanded to move for long enough."""
        commanded_mps, fastest_mps = min(told.speed_mps, abs(self._envelope.lagging_mps)), chassis.fastest_mps
        if fastest_mps is None or fastest_mps >= NOT_MOVING_MPS or commanded_mps <= NOT_MOVING_COMMAND_MPS:
            self._slowest_mps = inf
            return ""
        if self._slowest_mps == inf:
            self._slowest_mps = fastest_mps
        elif fastest_mps > self._slowest_mps + GATHERING_MPS:
            # Heavy and uphill it gains speed slowly, so it does not stand. Noise does so once.
            self._slowest_mps = fastest_mps
            return ""
        return f"commanded {told.speed_mps:.2f} m/s, measured {fastest_mps:.2f} m/s"

    def _deviation(self, chassis: ChassisState) -> str:
        angle_deg = chassis.angle_deg
        if angle_deg is None:
            return ""
        envelope = self._envelope
        off_deg = max(angle_deg - envelope.left_deg, envelope.right_deg - angle_deg)
        return f"off by {off_deg:.1f} deg, at {angle_deg:.1f} deg" if off_deg > STEERING_DEVIATION_DEG else ""

    def _count_way(self, chassis: ChassisState, elapsed_s: float) -> None:
        """Add up the least way driven since the mileage changed."""
        if chassis.total_mileage_km != self._mileage_km or chassis.total_mileage_km is None:
            self._mileage_km = chassis.total_mileage_km
            self._driven_m = 0.0
        if not chassis.reads_zero:
            # One noisy bit at standstill is no way.
            self._driven_m += chassis.slowest_mps * elapsed_s


class ChassisMonitor:
    """The arbiter's view of the chassis, updated each tick.

    Attributes:
        stands: the robot was seen to stand for long enough. False also if that cannot be seen.
        pressed: bumpers that are pressed, or have not read clear for long enough.
        struck: those of them that were clear a tick before.
        is_rest_confirmed: since the last commanded speed, a measured speed rose and fell, or the parking brake
            read applied after it was requested. Until then a speed of zero may be frozen.
        send_failures: consecutive ticks whose frames the bus did not accept.
    """

    def __init__(self, chassis: Chassis) -> None:
        self._design = chassis
        self.chassis = ChassisState()
        self.stands = False
        self.pressed: set[Reason] = set()
        self.struck: set[Reason] = set()
        self.is_rest_confirmed = True
        self.plausibility = Plausibility(chassis)
        self.send_failures = 0
        self._has_risen = self._was_released = self._is_parking_asked = False
        self._speeds: tuple[float | None, ...] = ()
        self._unchanged_ns = 0
        self._slow_ticks = 0
        self._moving_since_ns: int | None = None
        self._driven_ns: int | None = None
        self._acknowledged: set[Reason] = set()
        self._pressed_ns: dict[Reason, int] = {}

    def update(self, chassis: ChassisState, now_ns: int, told: Actuation = AT_REST) -> None:
        """Update with the chassis and its command at this tick."""
        is_fast = (chassis.fastest_mps or 0.0) >= STANDSTILL_MPS
        if told.speed_mps or is_fast or chassis.mode is Mode.REMOTE or self._driven_ns is None:
            self._driven_ns = now_ns
        if chassis.creeps and now_ns - self._driven_ns < CREEP_REST_NS:
            # These may be the last centimetres of a slow drive.
            chassis = msgspec.structs.replace(chassis, creeps=0)
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
        # After a reset, a hit counts again once the bumper has been clear.
        if self._acknowledged:
            self._acknowledged &= self.pressed

    def rest(self, now_ns: int) -> str:
        """Describe whether the robot stands."""
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
        """Rest is confirmed, or the speeds have answered and only have to read slow for long enough."""
        return self.is_rest_confirmed or (self._has_risen and not self.stands)

    @property
    def hits(self) -> list[Reason]:
        """The pressed bumpers that no reset has acknowledged."""
        return (
            [bumper for bumper in BUMPERS if bumper in self.pressed - self._acknowledged] if self.pressed else []
        )

    def acknowledge(self, latched: Iterable[Reason]) -> None:
        """Note a reset: while pressed, these bumpers now only forbid their direction."""
        self._acknowledged |= self.pressed.intersection(latched)

    def is_commanded_by_other(self, now_ns: int) -> bool:
        """Another computer sends command frames on the bus."""
        received_ns = self.chassis.commander_ns
        return received_ns is not None and now_ns - received_ns < COMMANDER_NS

    def chassis_faults(self) -> list[Reason]:
        """Return the faults that forbid commanding the chassis, apart from its mode."""
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
        """Return the causes to stop a robot with this command and speed limit."""
        chassis = self.chassis
        found = self.chassis_faults()
        if chassis.absurd and not set(self._design.scaled_frames).isdisjoint(chassis.absurd):
            # In the wrong scale a speed reads 40 times too high, as in no other fault.
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
        """Return the figures that the reason's text lacks."""
        return {
            Reason.FEEDBACK_MISSING: ", ".join(self.chassis.missing),
            Reason.FEEDBACK_FAULTY: ", ".join([*self.chassis.faulty, *self.chassis.absurd]),
            Reason.LOOP_LATE: f"by {late_ns / 1e6:.0f} ms",
        }.get(reason) or self.plausibility.details.get(reason, self._absurd_speed(reason))

    def _absurd_speed(self, reason: Reason) -> str:
        if reason is not Reason.IMPLAUSIBLE_SPEED:
            return ""
        frames = ", ".join(name for name in self.chassis.absurd if name in self._design.scaled_frames)
        other = {Variant.COARSE: "the fine scale", Variant.FINE: "the coarse scale"}.get(self.chassis.variant)
        return f"{frames} reads beyond what the chassis can do" + (f"; {other} may fit" if other else "")

    def found_moving(self, now_ns: int) -> bool:
        """The chassis has moved for long enough without a commander."""
        adrift = self.chassis.mode is not Mode.REMOTE and not self.is_commanded_by_other(now_ns)
        if not adrift or not self.chassis.moves:
            self._moving_since_ns = None
            return False
        if self._moving_since_ns is None:
            self._moving_since_ns = now_ns
        return now_ns - self._moving_since_ns >= FOUND_MOVING_NS
