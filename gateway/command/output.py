"""The command to the chassis in each tick: motion, stop, handover to the remote control. Pure.

- ``Handover``: when our output has to cease, and which command remains active then.
- ``inferred_actuation``: the command that a chassis must have had, by its feedback. A stop that we did not lead up
  to begins there.
- ``Output``: tick by tick; a step that the bus did not take is undone.
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
        """Return True if the chassis may execute the command it was left with. For each tick without output."""
        if is_taken:
            self.left = None
        if not chassis.bus_up:
            self._left_ns = now_ns
        return self.left is not None and may_be_stopped(chassis) and not self.is_blind(chassis, now_ns)


IN_GEAR = frozenset({GearPosition.DRIVE, GearPosition.REVERSE})


def inferred_angle_deg(chassis: ChassisState, limits: MotionLimits) -> float:
    """The steering angle, within the limit; straight on if it is not seen."""
    return max(-limits.steering_deg, min(limits.steering_deg, chassis.angle_deg or 0.0))


def inferred_actuation(
    chassis: ChassisState, limits: MotionLimits, wheelbase_m: float, left: Actuation | None = None
) -> Actuation:
    """Infer the command that the chassis must have had, within the configured limits.

    No speed is above the one of the command that we left it with. If others left it, the parking brake is applied
    where the gear is that of a parked robot, or is not known: released, it may set a standing robot going.
    """
    rolls = chassis.gear in IN_GEAR
    angle_deg = inferred_angle_deg(chassis, limits)
    # The feedback is off by a degree: what we told goes on where the wheels still are there.
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
"""After a pause the speed falls by no greater step than this allows."""


class Output:
    """The command that the chassis has.

    Attributes:
        actuation: its last command; None while it is not commanded.
        variant: the one in which speeds are encoded; UNKNOWN as soon as there was any doubt, until it is engaged
            again.
        begun: number of times that commanding it has begun.
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
        """The phase of the stop; IDLE if there is none."""
        return StopPhase.IDLE if self.sequence is None else self.sequence.phase

    @property
    def told(self) -> Actuation:
        """The chassis's command as its frames say it: at rest if there is none, and down to the bit."""
        actuation = self.actuation or AT_REST
        bit_mps = self._design.speed_bit_mps.get(self.variant)
        if bit_mps is None or not actuation.speed_mps:
            return actuation
        return msgspec.structs.replace(actuation, speed_mps=toward_zero(actuation.speed_mps, bit_mps))

    def begin(self, variant: Variant) -> None:
        """Begin to command the chassis, in the scale of this variant."""
        self.variant = variant
        self.begun += 1

    def cease(self) -> None:
        """Cease commanding. From here on the measured speed counts, not the commanded one."""
        self.actuation = None
        self.sequence = None

    def begin_step(self) -> None:
        """Take the next step on a copy: it is undone if the bus does not accept the burst."""
        self._before = (self.motion, self.sequence, self.actuation)
        self.motion, self.sequence = copy(self.motion), copy(self.sequence)

    def undo_step(self, *, is_speed_told: bool = False) -> None:
        """Undo the step of this tick: the bus did not accept its burst, or only a part.

        Otherwise the chassis's next command would be several steps from its last one; or a stop that it never
        received would proceed to neutral. A ramp whose speed frame was accepted continues all the same.
        """
        told, stepped = self.actuation, self.sequence
        self.motion, self.sequence, self.actuation = self._before
        if is_speed_told and told is not None and stepped is not None and self.sequence is not None:
            self.sequence = stepped.after_part(self.sequence, told.speed_mps)

    def replace_step(self, actuation: Actuation) -> None:
        """Command this instead. If the bus does not accept it either, the stop that has begun is still due."""
        self._before = (self.motion, self.sequence, self._before[2])
        self.actuation = actuation

    def step_motion(
        self, target: Target, setpoint: Setpoint, age: LinkAge, monitor: ChassisMonitor, now_ns: int
    ) -> Actuation:
        """Return this tick's command to a chassis that is not being stopped."""
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
            # On the wire that is zero: the robot is told to stand, and is held.
            bounded = Target(0.0, bounded.angle_deg)
        elapsed_s = min(max((now_ns - self.told_ns) / _NS_PER_S, _TICK_S), LATE_STEP_S)
        actuation = self.motion.tick(bounded, limits, constraints, _TICK_S, elapsed_s)
        if abs(bounded.speed_mps) < abs(target.speed_mps) and bounded.speed_mps:
            self.motion.bounds.append(Bound.TRAVEL_DELAY)
        return actuation

    def step_stop(
        self, sequence: StopSequence, monitor: ChassisMonitor, now_ns: int, late_ns: int
    ) -> Actuation | None:
        """Return this tick's command to a chassis that is being stopped; None when the stop has ended."""
        if max(now_ns - self.told_ns, late_ns) > TOLD_LONG_AGO_NS:
            # Held up by a pause or by the bus: the robot may have been brought to rest meanwhile.
            sequence.not_above(monitor.chassis.slowest_mps)
        return sequence.tick(now_ns, _stop_feedback(monitor))


def _stop_feedback(monitor: ChassisMonitor) -> StopFeedback:
    chassis = monitor.chassis
    is_braked = chassis.brake is ParkingStatus.APPLIED
    # In mode stop the chassis need not heed the request, and a brake that is not seen proves nothing.
    is_open = chassis.brake is ParkingStatus.UNDEFINED or chassis.mode is not Mode.AUTO
    return StopFeedback(
        stands=monitor.stands,
        moves=chassis.moves,
        speed_mps=chassis.fastest_mps,
        wheel_speed_mps=chassis.wheel_speed_mps,
        is_braked=None if is_open and not is_braked else is_braked,
    )
