"""The command to the chassis in each tick: motion, stop, handover to the remote control. Pure.

- ``Handover``: when our output must end, and which command remains active then.
- ``inferred_actuation``: the command that a chassis must have had, by its feedback: where the stop of a robot that
  was found in motion begins.
- ``Output``: tick by tick; a step that the bus did not accept is undone.
"""

from __future__ import annotations

from copy import copy
from typing import Final

import msgspec

from gateway.chassis.port import AT_REST, Actuation, Chassis, ChassisState, toward_zero
from gateway.command.lease import LinkAge
from gateway.command.monitor import ChassisMonitor
from gateway.command.motion import MotionConstraints, MotionLimits, MotionProfile, Setpoint, Target
from gateway.command.stop import StopFeedback, StopSequence
from schemas.decisions import Bound, StopPhase
from schemas.messages import GearPosition, Mode, ParkingStatus, Variant
from schemas.reasons import Reason
from schemas.settings import LEFT_BLIND_NS, STEERING_DEVIATION_DEG, TICK_NS, TOLD_LONG_AGO_NS, YIELD_BURSTS


def may_obey(chassis: ChassisState) -> bool:
    """Return True if the chassis may be in auto with an old command, and the guard does not stop it."""
    return chassis.bus_up and chassis.mode in {Mode.AUTO, Mode.UNDEFINED} and not chassis.guard_sends


def may_be_stopped(chassis: ChassisState) -> bool:
    """Return True if a stop is to be sent: for an old command, or in mode stop without a brake."""
    is_loose = chassis.mode is Mode.STOP and (chassis.moves or chassis.brake is ParkingStatus.RELEASED)
    return may_obey(chassis) or (chassis.bus_up and is_loose and not chassis.guard_sends)


class Handover:
    """The handover of a chassis to others, and back.

    Attributes:
        left: the command that the chassis had at the handover, which it may execute again; None once that is
            ended.
        is_cut_off: our connection to the bus was lost while the chassis was under command. It keeps moving: only
            the guard, with its own connection, can stop it.
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
        """Note that we command the chassis from now on."""
        self.left = None
        self._partings = 0
        self._was_auto = False
        self._bus_losses = chassis.bus_losses
        self._guard_stops = chassis.guard_stops

    def reason_to_yield(self, chassis: ChassisState) -> Reason:
        """Return why the output must end now; NONE if it need not."""
        self._was_auto = self._was_auto or chassis.mode is Mode.AUTO
        if chassis.guard_sends or chassis.guard_stops != self._guard_stops:
            # Even if that has ended: this process was paused meanwhile, and its view is old.
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
        """Note that our output ends for this reason; lamps and horn stay as they are in the chassis."""
        self.left = told
        self._is_held_by_motor = is_held_by_motor
        self._partings = YIELD_BURSTS if reason is Reason.HAND_TRANSMITTER and told.enabled else 0
        self._left_ns = now_ns
        self.is_cut_off = reason is Reason.BUS_DOWN and not chassis.bus_up

    def part(self, chassis: ChassisState) -> Actuation | None:
        """Return the next zero-speed command to a chassis that the remote control took; None at the end.

        The chassis would execute its last command when the remote control gives it back.
        """
        is_theirs = chassis.mode is Mode.REMOTE and chassis.bus_up and not chassis.guard_sends
        if not self._partings or self.left is None or not is_theirs:
            self._partings = 0
            return None
        self._partings -= 1
        # If only the motor held it, it would roll with the parking brake once it is given back.
        parking = not self._is_held_by_motor
        return msgspec.structs.replace(self.left, speed_mps=0.0, parking=parking)

    def is_given_back(self, chassis: ChassisState) -> bool:
        """Return True in the tick in which the remote control returns the chassis. Call each tick of standby."""
        was_remote = self._is_remote
        if chassis.mode is not Mode.UNDEFINED:
            self._is_remote = chassis.mode is Mode.REMOTE
        return was_remote and not self._is_remote

    def is_blind(self, chassis: ChassisState, now_ns: int) -> bool:
        """Return True if the mode is unknown because the bus has only just returned."""
        return chassis.mode is Mode.UNDEFINED and now_ns - self._left_ns < LEFT_BLIND_NS

    def is_obeyed_again(self, chassis: ChassisState, now_ns: int, *, is_taken: bool) -> bool:
        """Return True if the chassis may execute the command it was left with. Call each tick without output."""
        if is_taken:
            self.left = None
        if not chassis.bus_up:
            self._left_ns = now_ns
        return self.left is not None and may_be_stopped(chassis) and not self.is_blind(chassis, now_ns)


IN_GEAR = frozenset({GearPosition.DRIVE, GearPosition.REVERSE})


def inferred_angle_deg(chassis: ChassisState, limits: MotionLimits) -> float:
    """The measured steering angle within the limit; 0 if unknown."""
    return max(-limits.steering_deg, min(limits.steering_deg, chassis.angle_deg or 0.0))


def inferred_actuation(
    chassis: ChassisState, limits: MotionLimits, wheelbase_m: float, left: Actuation | None = None
) -> Actuation:
    """Infer the command that the chassis must have had, within the configured limits.

    The speed never exceeds that of the command that we left. If others left the chassis, the parking brake is
    applied in gear park or an unknown gear, because its release could set a standing robot in motion.
    """
    rolls = chassis.gear in IN_GEAR
    angle_deg = inferred_angle_deg(chassis, limits)
    # The feedback is off by a degree: keep the commanded angle if the wheels are still there.
    if left is not None and abs(left.angle_deg - angle_deg) <= STEERING_DEVIATION_DEG:
        angle_deg = left.angle_deg
    gear = GearPosition.NEUTRAL if left is None else left.gear
    parking = chassis.gear in {GearPosition.PARK, GearPosition.UNDEFINED} if left is None else left.parking
    furthest_deg = max(abs(angle_deg), abs(chassis.angle_deg or 0.0))
    speed_mps = min(chassis.slowest_mps, limits.speed_at(furthest_deg, wheelbase_m))
    if left is not None:
        speed_mps = min(speed_mps, left.speed_mps) if left.gear is chassis.gear else 0.0
    return Actuation(
        enabled=True,
        gear=chassis.gear if rolls else gear,
        speed_mps=speed_mps if rolls and not parking else 0.0,
        angle_deg=angle_deg,
        parking=parking,
    )


_NS_PER_S: Final = 1_000_000_000
_TICK_S: Final = TICK_NS / _NS_PER_S
LATE_STEP_S: Final = 10 * _TICK_S
"""Longest time by which the speed falls after a pause."""


class Output:
    """The command that the chassis has.

    Attributes:
        actuation: None while it is not commanded.
        variant: of the encoded speeds; UNKNOWN after any doubt, until the next engagement.
        begun: how often commanding has begun.
        told_ns: when the bus last accepted a whole burst, monotonic.
    """

    def __init__(self, chassis: Chassis) -> None:
        self._design = chassis
        self.actuation: Actuation | None = None
        self.variant = Variant.UNKNOWN
        self.begun = 0
        self.told_ns = 0
        self.motion = MotionProfile()
        self.sequence: StopSequence | None = None
        self._before: tuple[MotionProfile, StopSequence | None, Actuation | None] = (self.motion, None, None)

    @property
    def stop_phase(self) -> StopPhase:
        """IDLE if there is no stop."""
        return StopPhase.IDLE if self.sequence is None else self.sequence.phase

    @property
    def told(self) -> Actuation:
        """The command as in the frames, rounded down to the bit; at rest if there is none."""
        actuation = self.actuation or AT_REST
        bit_mps = self._design.speed_bit_mps.get(self.variant)
        if bit_mps is None or not actuation.speed_mps:
            return actuation
        return msgspec.structs.replace(actuation, speed_mps=toward_zero(actuation.speed_mps, bit_mps))

    def begin(self, variant: Variant) -> None:
        self.variant = variant
        self.begun += 1

    def cease(self) -> None:
        """End commanding. From now on the measured speed counts, not the commanded one."""
        self.actuation = None
        self.sequence = None

    def begin_step(self) -> None:
        """Prepare a step on copies, so that it can be undone if the bus does not accept the burst."""
        self._before = (self.motion, self.sequence, self.actuation)
        self.motion, self.sequence = copy(self.motion), copy(self.sequence)

    def undo_step(self, *, is_speed_told: bool = False) -> None:
        """Undo the step of this tick, because the bus did not accept the whole burst.

        Otherwise the next command would be several steps from the last one, or a stop that the chassis never
        received would proceed to neutral. A ramp whose speed frame was accepted continues.
        """
        told, stepped = self.actuation, self.sequence
        self.motion, self.sequence, self.actuation = self._before
        if is_speed_told and told is not None and stepped is not None and self.sequence is not None:
            self.sequence = stepped.after_part(self.sequence, told.speed_mps)

    def replace_step(self, actuation: Actuation) -> None:
        """Command this instead. If the bus does not accept it either, the stop remains due."""
        self._before = (self.motion, self.sequence, self._before[2])
        self.actuation = actuation

    def step_motion(
        self, target: Target, setpoint: Setpoint, age: LinkAge, monitor: ChassisMonitor, now_ns: int
    ) -> Actuation:
        """Return this tick's command outside of a stop."""
        chassis, pressed = monitor.chassis, monitor.pressed
        constraints = MotionConstraints(
            wheelbase_m=self._design.wheelbase_m,
            stands=monitor.stands,
            gear=chassis.gear,
            brake=chassis.brake,
            parked=setpoint.parked,
            speed_mps=chassis.fastest_mps or 0.0,
            angle_deg=chassis.angle_deg or 0.0,
            forward=Reason.FRONT_BUMPER not in pressed,
            backward=Reason.REAR_BUMPER not in pressed,
        )
        limits = setpoint.limits
        bounded = age.bounded(target, limits.speed_mps, now_ns)
        if abs(bounded.speed_mps) < self._design.speed_bit_mps.get(self.variant, 0.0):
            # In the frame that is zero: treat it as a command to stand.
            bounded = Target(0.0, bounded.angle_deg)
        elapsed_s = min(max((now_ns - self.told_ns) / _NS_PER_S, _TICK_S), LATE_STEP_S)
        actuation = self.motion.tick(bounded, limits, constraints, _TICK_S, elapsed_s)
        if abs(bounded.speed_mps) < abs(target.speed_mps) and bounded.speed_mps:
            self.motion.bounds.append(Bound.TRAVEL_DELAY)
        return actuation

    def step_stop(
        self, sequence: StopSequence, monitor: ChassisMonitor, now_ns: int, late_ns: int
    ) -> Actuation | None:
        """Return this tick's command of a stop; None when the stop has ended."""
        if max(now_ns - self.told_ns, late_ns) > TOLD_LONG_AGO_NS:
            # After a pause of the loop or the bus the robot may have come to rest.
            sequence.not_above(monitor.chassis.slowest_mps)
        return sequence.tick(now_ns, _stop_feedback(monitor))


def _stop_feedback(monitor: ChassisMonitor) -> StopFeedback:
    chassis = monitor.chassis
    is_braked = chassis.brake is ParkingStatus.APPLIED
    # In mode stop the chassis may ignore the request, and a brake without feedback proves nothing.
    is_open = chassis.brake is ParkingStatus.UNDEFINED or chassis.mode is not Mode.AUTO
    return StopFeedback(
        stands=monitor.stands,
        moves=chassis.moves,
        speed_mps=chassis.fastest_mps,
        wheel_speed_mps=chassis.wheel_speed_mps,
        is_braked=None if is_open and not is_braked else is_braked,
    )
