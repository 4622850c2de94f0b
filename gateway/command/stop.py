"""The stop sequence: how a robot that is being told something comes to rest, and is then told nothing.

Ramp to zero speed, brake pedal, neutral, parking brake at standstill, hold, disabled frames, silence. The arbiter
uses it, and so does the guard when there is no arbiter any more.
"""

from __future__ import annotations

from typing import Final

from gateway.command.actuation import AT_REST, Actuation
from schemas.decisions import StopPhase
from schemas.messages import GearPosition
from schemas.settings import BRAKE_UNSEEN_NS, DISABLE_NS, HOLD_NS, NEUTRAL_NS, TICK_NS

_STEP_MAX_NS: Final = 10 * TICK_NS
"""After a pause the ramp goes on with no greater step than this."""

_NEXT: Final = {
    StopPhase.RAMP: StopPhase.BRAKE,
    StopPhase.BRAKE: StopPhase.NEUTRAL,
    StopPhase.NEUTRAL: StopPhase.HOLD,
    StopPhase.HOLD: StopPhase.DISABLE,
    StopPhase.DISABLE: StopPhase.IDLE,
}

_LASTS_NS: Final = {
    StopPhase.BRAKE: BRAKE_UNSEEN_NS,
    StopPhase.NEUTRAL: NEUTRAL_NS,
    StopPhase.HOLD: HOLD_NS,
    StopPhase.DISABLE: DISABLE_NS,
}
"""How long a phase lasts; the brake phase less, if the robot is seen to stand."""


class StopSequence:
    """One stop, from what the chassis was last told to silence.

    Attributes:
        phase: how far it has come; IDLE when it has ended.
    """

    def __init__(self, last: Actuation, deceleration_mps2: float, pedal_percent: float, now_ns: int) -> None:
        """Begin to stop.

        Args:
            last: what the chassis was last told.
            deceleration_mps2: how fast the commanded speed goes to zero.
            pedal_percent: the brake pedal, once it is there.
            now_ns: monotonic.
        """
        self.phase = StopPhase.RAMP if last.speed_mps else StopPhase.BRAKE
        self._gear = last.gear
        self._speed_mps = last.speed_mps
        self._angle_deg = last.angle_deg
        # A robot that was parked stays so.
        self._parked = last.parking
        self._deceleration_mps2 = deceleration_mps2
        self._pedal_percent = pedal_percent
        # The last frame was sent a tick ago: the ramp begins with this one.
        self._ticked_ns = now_ns - TICK_NS
        self._begun_ns = now_ns

    def hasten(self, deceleration_mps2: float) -> None:
        """A graver cause came: slow down faster. Never slower."""
        self._deceleration_mps2 = max(self._deceleration_mps2, deceleration_mps2)

    def not_above(self, speed_mps: float) -> None:
        """The ramp goes on from this speed, if it is a lower one."""
        self._speed_mps = min(self._speed_mps, speed_mps)

    def tick(self, now_ns: int, *, stands: bool) -> Actuation | None:
        """What the chassis is told now; None when the sequence has ended.

        Args:
            now_ns: monotonic.
            stands: the robot is seen to stand; False also when that cannot be seen.
        """
        elapsed_ns = min(now_ns - self._ticked_ns, _STEP_MAX_NS)
        self._ticked_ns = now_ns
        if self.phase is StopPhase.RAMP:
            self._speed_mps = max(0.0, self._speed_mps - self._deceleration_mps2 * elapsed_ns / 1e9)
            if self._speed_mps == 0:
                self.phase, self._begun_ns = StopPhase.BRAKE, now_ns
        # One phase a tick at most: zero speed has to be told before neutral is, also after a pause.
        elif self._is_over(now_ns, stands=stands):
            self.phase = _NEXT[self.phase]
            self._begun_ns = now_ns
        return self._actuation()

    def _is_over(self, now_ns: int, *, stands: bool) -> bool:
        match self.phase:
            case StopPhase.IDLE:
                return False
            case StopPhase.BRAKE if stands:
                return True
            case _:
                return now_ns - self._begun_ns >= _LASTS_NS[self.phase]

    def _actuation(self) -> Actuation | None:
        match self.phase:
            case StopPhase.IDLE:
                return None
            case StopPhase.DISABLE:
                return Actuation(angle_deg=self._angle_deg, parking=AT_REST.parking)
            case _:
                rolling = self.phase in {StopPhase.RAMP, StopPhase.BRAKE}
                return Actuation(
                    enabled=True,
                    gear=self._gear if rolling else GearPosition.NEUTRAL,
                    speed_mps=self._speed_mps,
                    angle_deg=self._angle_deg,
                    pedal_percent=0.0 if self.phase is StopPhase.RAMP else self._pedal_percent,
                    parking=self._parked or self.phase is StopPhase.HOLD,
                )
