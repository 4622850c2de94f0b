"""The stop sequence: it brings a robot under command to rest, then ends commanding it.

The speed falls to zero in gear, because the motor is the only service brake that the manual promises. The parking
brake follows once the robot stands, or if it does not slow down as it should. The gear stays engaged while the
brake holds, because neutral frees the motor, and the brake's feedback may be wrong. Then disabled frames, then
silence. The arbiter uses this sequence, and so does the guard when the arbiter is gone.
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
"""Longest step of the ramp after a pause."""

_HAIR: Final = 1e-9
"""Tolerance against rounding, for speeds exactly on a bound."""

_DIRECTION: Final = {GearPosition.DRIVE: 1.0, GearPosition.REVERSE: -1.0}


class StopFeedback(msgspec.Struct, frozen=True):
    """The feedback that a stop needs.

    Attributes:
        stands, moves: False also if that cannot be seen.
        speed_mps: the highest measured one, a magnitude; None if unknown.
        wheel_speed_mps: forward positive; None if unknown.
        is_braked: the parking brake reads applied; None if its feedback proves nothing.
    """

    stands: bool = False
    moves: bool = False
    speed_mps: float | None = None
    wheel_speed_mps: float | None = None
    is_braked: bool | None = None


class StopSequence:
    """One stop, from the chassis's last command to silence.

    Attributes:
        phase: IDLE when the stop has ended.
        returns: how often the robot moved without enables, in this stop and just before it.
    """

    _shifts = False
    """The gear changes in this tick, behind the brake. Absent in earlier checkpoints."""

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
            deceleration_mps2: of the ramp.
            now_ns: monotonic.
            returns: how often the robot moved without enables, in stops just before this one.
            may_release: the gate allows one release of the parking brake in this stop.
            stood_by_motor: the motor held the robot until its parking brake was applied, just before.
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
        # The last frame was sent a tick ago, so the ramp begins in this tick.
        self._ticked_ns = now_ns - TICK_NS
        self._lowest_mps: float | None = None
        self._slowed_ns = now_ns
        self.phase = StopPhase.RAMP if last.speed_mps else StopPhase.BRAKE
        self._begun_ns = now_ns
        if last.parking or last.gear not in _DIRECTION:
            # A parked robot stays parked, and in neutral only this brake works.
            self.park(now_ns)

    def lacks_brake(self, now_ns: int) -> bool:
        """The parking brake should read applied by now, but does not."""
        return self.phase is StopPhase.PARK and now_ns - self._begun_ns >= BRAKE_UNSEEN_NS

    @property
    def stays(self) -> bool:
        """True if the enables stay, because without them the robot would move."""
        return self._is_released or self.returns >= BRAKE_RETURNS

    def is_braked(self, now_ns: int) -> bool:
        """The robot has stood braked for long enough that a stop which stays may end."""
        return self.phase is StopPhase.HOLD and now_ns - self._begun_ns >= BRAKED_NS

    def finish(self, now_ns: int) -> None:
        """Withdraw the enables of a robot that has stood braked."""
        self.returns, self._is_released, self._may_release = 0, False, False
        self._enter(StopPhase.DISABLE, now_ns)

    def release(self, now_ns: int, wheel_speed_mps: float | None = None) -> None:
        """Release a parking brake that slips, so that the motor holds the robot again.

        During a change of direction the gear of its motion is engaged first, behind the brake.
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
        """Slow down faster, for a more severe cause; never slower."""
        self._deceleration_mps2 = max(self._deceleration_mps2, deceleration_mps2)

    def not_above(self, speed_mps: float) -> None:
        """Continue the ramp from this speed, if it is lower."""
        self._speed_mps = min(self._speed_mps, speed_mps)

    def after_part(self, before: StopSequence, told_mps: float) -> StopSequence:
        """Return the sequence to continue with after the bus accepted the speed of a burst, but not all of it.

        At zero speed it continues to the parking brake, which is second in the next burst; no further, because a
        chassis that did not receive the brake would lose its enables.
        """
        if not told_mps and self.phase in {StopPhase.RAMP, StopPhase.BRAKE, StopPhase.PARK}:
            return self
        before.not_above(told_mps)
        return before

    def park(self, now_ns: int) -> None:
        """Apply the parking brake at once, at any speed."""
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
            # At most one phase a tick: zero speed is commanded first, also after a pause.
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
        """Keep holding a robot that moves behind its brake, or give it back to the motor that stopped it."""
        self._begun_ns = now_ns
        if feedback.speed_mps is None:
            # Beyond the measurable speeds it may be slowing down, unseen.
            return
        speed_mps = feedback.speed_mps
        if now_ns - self._rolls_ns > _STEP_MAX_NS:
            self._rolled_ns, self._rolled_mps = now_ns, speed_mps
        self._rolls_ns = now_ns
        slips = now_ns - self._rolled_ns >= ROLLING_NS and speed_mps > self._rolled_mps - SLOWING_MPS
        if slips and self._may_release and self._stood_by_motor and feedback.is_braked:
            self.release(now_ns, feedback.wheel_speed_mps)

    def _is_not_held(self, feedback: StopFeedback, now_ns: int) -> bool:
        """The brake does not hold a robot without enables, or the motor one whose brake was released."""
        if self.phase is StopPhase.DISABLE:
            return feedback.moves
        # A robot beyond the measurable speeds is not held at all.
        speed_mps = inf if feedback.speed_mps is None and feedback.moves else feedback.speed_mps or 0.0
        is_early = now_ns - self._begun_ns < MOTOR_HOLDS_NS
        # One bit of noise each way is not faster.
        is_faster = not is_early and (
            speed_mps == inf or speed_mps > self._released_mps + RUNAWAY_RISE_MPS + _HAIR
        )
        # The robot still gains speed until the brake has opened.
        is_newer = feedback.is_braked if is_early else speed_mps < self._released_mps
        if self._released_mps == inf or is_newer:
            self._released_mps = speed_mps
        return is_faster

    def _enter(self, phase: StopPhase, now_ns: int) -> None:
        self.phase, self._begun_ns = phase, now_ns

    @staticmethod
    def _is_blind(feedback: StopFeedback) -> bool:
        """True if no sensor reports motion: at zero speed the stop then does not wait for standstill."""
        return feedback.speed_mps is None and not feedback.moves

    def _runs_away(self, feedback: StopFeedback, now_ns: int) -> bool:
        """The robot moves against the ramp, or does not slow down."""
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
