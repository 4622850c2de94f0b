"""The stop sequence: it brings a robot under command to rest, and then ceases commanding it.

The speed falls to zero in gear, for the motor is the only service brake that the manual promises. The parking
brake follows as soon as the robot stands, or does not slow down as it should. The gear stays in while it holds,
for neutral frees the motor, and the brake's feedback may be wrong. Then disabled frames, silence. The arbiter uses
this sequence; so does the guard when there is no arbiter any more.
"""

from __future__ import annotations

from math import inf
from typing import Final

import msgspec

from gateway.chassis.port import AT_REST, Actuation
from schemas.decisions import StopPhase
from schemas.messages import GearPosition
from schemas.settings import (
    BRAKE_MAX_NS,
    BRAKE_RETURNS,
    BRAKE_UNSEEN_NS,
    BRAKED_NS,
    DISABLE_NS,
    HOLD_NS,
    MOTOR_HOLDS_NS,
    NOT_SLOWING_NS,
    ROLLING_NS,
    RUNAWAY_RISE_MPS,
    SLOWING_MPS,
    STANDSTILL_MPS,
    TICK_NS,
)

_STEP_MAX_NS: Final = 10 * TICK_NS
"""After a pause the ramp continues with no greater step than this."""

_HAIR: Final = 1e-9
"""So that a speed that is just on a bound is not over it by rounding."""

_DIRECTION: Final = {GearPosition.DRIVE: 1.0, GearPosition.REVERSE: -1.0}


class StopFeedback(msgspec.Struct, frozen=True):
    """The feedback that a stop needs.

    Attributes:
        stands: the robot is seen to stand; False also when that cannot be seen.
        moves: it is seen to move; False also when that cannot be seen.
        speed_mps: the highest possible one, a magnitude; None if no sensor reports it.
        wheel_speed_mps: the same by the wheels, forward positive; None if they do not report it.
        is_braked: the parking brake reads applied; None if nothing can be concluded from it.
    """

    stands: bool = False
    moves: bool = False
    speed_mps: float | None = None
    wheel_speed_mps: float | None = None
    is_braked: bool | None = None


class StopSequence:
    """One stop, from the chassis's last command to silence.

    Attributes:
        phase: the present one; IDLE when the stop has ended.
        returns: number of times that the robot moved when the enables were gone, in this stop and just before it.
    """

    _shifts = False
    """The gear changes in this tick, behind the brake. Checkpoints of before do not have it."""

    def __init__(
        self,
        last: Actuation,
        deceleration_mps2: float,
        now_ns: int,
        returns: int = 0,
        *,
        may_release: bool = False,
        stood_by_motor: bool = False,
    ) -> None:
        """Begin to stop.

        Args:
            last: the chassis's last command.
            deceleration_mps2: how fast the commanded speed goes to zero.
            now_ns: monotonic.
            returns: number of times that the robot moved without enables, in stops just before this one.
            may_release: the gate admits that this stop gives the robot back to its motor, once.
            stood_by_motor: the robot stood by its motor until its parking brake was applied, just before.
        """
        self._may_release = may_release
        self._stood_by_motor = stood_by_motor
        self._rolls_ns = self._rolled_ns = -_STEP_MAX_NS - 1
        self._rolled_mps = 0.0
        self.returns = returns
        self._is_released = False
        self._released_mps = inf
        self._gear = last.gear
        self._speed_mps = last.speed_mps
        self._angle_deg = last.angle_deg
        self._deceleration_mps2 = deceleration_mps2
        # The last frame was sent a tick ago: the ramp begins with this one.
        self._ticked_ns = now_ns - TICK_NS
        self._lowest_mps: float | None = None
        self._slowed_ns = now_ns
        self.phase = StopPhase.RAMP if last.speed_mps else StopPhase.BRAKE
        self._begun_ns = now_ns
        if last.parking or last.gear not in _DIRECTION:
            # Parked it stays so, and in neutral nothing else brakes.
            self.park(now_ns)

    def lacks_brake(self, now_ns: int) -> bool:
        """The parking brake should read applied by now, and the sequence still waits for it."""
        return self.phase is StopPhase.PARK and now_ns - self._begun_ns >= BRAKE_UNSEEN_NS

    @property
    def stays(self) -> bool:
        """True if the enables are not taken away: without them the robot would move."""
        return self._is_released or self.returns >= BRAKE_RETURNS

    def is_braked(self, now_ns: int) -> bool:
        """The robot has stood behind its applied parking brake for so long that a stop which stays may end."""
        return self.phase is StopPhase.HOLD and now_ns - self._begun_ns >= BRAKED_NS

    def finish(self, now_ns: int) -> None:
        """Take the enables away from a robot that has stood braked."""
        self.returns, self._is_released, self._may_release = 0, False, False
        self._enter(StopPhase.DISABLE, now_ns)

    def release(self, now_ns: int, wheel_speed_mps: float | None = None) -> None:
        """Give the robot back to its motor, which held it before: the parking brake does not.

        In the midst of a change of direction the gear of its motion comes first, behind the brake.
        """
        if self._gear not in _DIRECTION:
            if not wheel_speed_mps:
                return
            self._gear = GearPosition.DRIVE if wheel_speed_mps > 0 else GearPosition.REVERSE
            self._shifts = True
        self._is_released, self._may_release = True, False
        self._speed_mps, self._released_mps = 0.0, inf
        self._enter(StopPhase.MOTOR, now_ns)

    def hasten(self, deceleration_mps2: float) -> None:
        """Slow down faster, for a graver cause. Never slower."""
        self._deceleration_mps2 = max(self._deceleration_mps2, deceleration_mps2)

    def not_above(self, speed_mps: float) -> None:
        """Go on with the ramp from this speed, if it is a lower one."""
        self._speed_mps = min(self._speed_mps, speed_mps)

    def after_part(self, before: StopSequence, told_mps: float) -> StopSequence:
        """Return the sequence to go on with after the bus took the speed of a burst, and not the whole of it.

        At zero speed it goes on to the parking brake, which the next burst has second. Never further: a chassis
        that did not receive it would lose its enables.
        """
        if not told_mps and self.phase in {StopPhase.RAMP, StopPhase.BRAKE, StopPhase.PARK}:
            return self
        before.not_above(told_mps)
        return before

    def park(self, now_ns: int) -> None:
        """Apply the parking brake at once, at whatever speed."""
        if self.phase in {StopPhase.RAMP, StopPhase.BRAKE}:
            self._speed_mps = 0.0
            self._enter(StopPhase.PARK, now_ns)

    def tick(self, now_ns: int, feedback: StopFeedback) -> Actuation | None:
        """Return the command of this tick; None when the sequence has ended."""
        elapsed_ns = min(now_ns - self._ticked_ns, _STEP_MAX_NS)
        self._ticked_ns = now_ns
        match self.phase:
            case StopPhase.RAMP:
                self._speed_mps = max(0.0, self._speed_mps - self._deceleration_mps2 * elapsed_ns / 1e9)
                if self._runs_away(feedback, now_ns):
                    self.park(now_ns)
                elif self._speed_mps == 0:
                    self._enter(StopPhase.BRAKE, now_ns)
            # One phase a tick at most: zero speed has to be told before all else, also after a pause.
            case StopPhase.BRAKE if (
                feedback.stands
                or self._is_blind(feedback)
                or self._runs_away(feedback, now_ns)
                or now_ns - self._begun_ns >= BRAKE_MAX_NS
            ):
                self._stood_by_motor = feedback.stands
                self.park(now_ns)
            case StopPhase.PARK if feedback.is_braked or (
                feedback.is_braked is None and now_ns - self._begun_ns >= BRAKE_UNSEEN_NS
            ):
                self._enter(StopPhase.HOLD, now_ns)
            case StopPhase.HOLD if feedback.moves:
                self._roll(feedback, now_ns)
            case StopPhase.DISABLE | StopPhase.MOTOR if self._is_not_held(feedback, now_ns):
                self.returns += self.phase is StopPhase.DISABLE
                self._enter(StopPhase.PARK, now_ns)
            case StopPhase.HOLD if now_ns - self._begun_ns >= HOLD_NS and not self.stays:
                self._enter(StopPhase.DISABLE, now_ns)
            case StopPhase.DISABLE if now_ns - self._begun_ns >= DISABLE_NS:
                self._enter(StopPhase.IDLE, now_ns)
        actuation = self._actuation()
        self._shifts = False
        return actuation

    def _roll(self, feedback: StopFeedback, now_ns: int) -> None:
        """Hold on to a robot that moves behind its applied brake, or give it back to the motor that stopped it."""
        self._begun_ns = now_ns
        if feedback.speed_mps is None:
            # Beyond all speeds that its chassis can report it may be slowing down: nothing shows it.
            return
        speed_mps = feedback.speed_mps
        if now_ns - self._rolls_ns > _STEP_MAX_NS:
            self._rolled_ns, self._rolled_mps = now_ns, speed_mps
        self._rolls_ns = now_ns
        slips = now_ns - self._rolled_ns >= ROLLING_NS and speed_mps > self._rolled_mps - SLOWING_MPS
        if slips and self._may_release and self._stood_by_motor and feedback.is_braked:
            self.release(now_ns, feedback.wheel_speed_mps)

    def _is_not_held(self, feedback: StopFeedback, now_ns: int) -> bool:
        """Neither its brake holds a robot whose enables are gone, nor its motor one whose brake was released."""
        if self.phase is StopPhase.DISABLE:
            return feedback.moves
        # A robot that moves beyond all speeds that its chassis can report is held by nothing.
        speed_mps = inf if feedback.speed_mps is None and feedback.moves else feedback.speed_mps or 0.0
        is_early = now_ns - self._begun_ns < MOTOR_HOLDS_NS
        # Noise of a bit each way is not faster.
        is_faster = not is_early and (
            speed_mps == inf or speed_mps > self._released_mps + RUNAWAY_RISE_MPS + _HAIR
        )
        # The motor has it only once the brake has opened: before, it gathers speed still.
        is_newer = feedback.is_braked if is_early else speed_mps < self._released_mps
        if self._released_mps == inf or is_newer:
            self._released_mps = speed_mps
        return is_faster

    def _enter(self, phase: StopPhase, now_ns: int) -> None:
        self.phase, self._begun_ns = phase, now_ns

    @staticmethod
    def _is_blind(feedback: StopFeedback) -> bool:
        """True if no sensor can report motion: at zero speed the stop then does not wait for standstill."""
        return feedback.speed_mps is None and not feedback.moves

    def _runs_away(self, feedback: StopFeedback, now_ns: int) -> bool:
        """The robot moves against the ramp, or is not seen to slow down."""
        against_mps = -(feedback.wheel_speed_mps or 0.0) * _DIRECTION.get(self._gear, 0.0)
        speed_mps = feedback.speed_mps
        if speed_mps is not None and (self._lowest_mps is None or speed_mps < self._lowest_mps - SLOWING_MPS):
            self._lowest_mps, self._slowed_ns = speed_mps, now_ns
        return against_mps > STANDSTILL_MPS or now_ns - self._slowed_ns >= NOT_SLOWING_NS

    def _actuation(self) -> Actuation | None:
        match self.phase:
            case StopPhase.IDLE:
                return None
            case StopPhase.DISABLE:
                return Actuation(angle_deg=self._angle_deg, parking=AT_REST.parking)
            case _:
                return Actuation(
                    enabled=True,
                    gear=self._gear,
                    speed_mps=self._speed_mps,
                    angle_deg=self._angle_deg,
                    parking=self._shifts or self.phase in {StopPhase.PARK, StopPhase.HOLD},
                )
