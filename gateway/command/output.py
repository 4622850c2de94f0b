"""The output to the chassis, tick by tick; a step that the bus did not take is undone. Pure."""

from __future__ import annotations

from copy import copy
from typing import Final

import msgspec

from gateway.command.actuation import AT_REST, Actuation
from gateway.command.chassis_monitor import ChassisMonitor
from gateway.command.frames import toward_zero
from gateway.command.link_age import LinkAge
from gateway.command.motion import MotionConstraints, MotionProfile, Target
from gateway.command.setpoint import Setpoint
from gateway.command.stop import StopFeedback, StopSequence
from schemas.cruiser import SPEED_BIT_MPS
from schemas.decisions import Bound, StopPhase
from schemas.messages import Mode, ParkingStatus, Variant
from schemas.reasons import Reason
from schemas.settings import TICK_NS, TOLD_LONG_AGO_NS

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
        motion: the motion while engaged.
        sequence: the stop under way, if there is one.
    """

    def __init__(self) -> None:
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
        bit_mps = SPEED_BIT_MPS.get(self.variant)
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
        """Return this tick's command to a chassis that is not being stopped.

        Args:
            target: the requested motion.
            setpoint: the limits in force, and whether the parking brake stays applied.
            age: of the holder's commands; it bounds the speed.
            monitor: the chassis.
            now_ns: monotonic.
        """
        chassis, pressed = monitor.chassis, monitor.pressed
        constraints = MotionConstraints(
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
        if abs(bounded.speed_mps) < SPEED_BIT_MPS.get(self.variant, 0.0):
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
