"""One stop sequence on the bus, with nobody else to ask: used by the guard and by ``cruiser halt``. Pure."""

from __future__ import annotations

from copy import copy
from math import isfinite
from typing import Final

from gateway.chassis.frame import Frame
from gateway.command.actuation import Actuation
from gateway.command.frames import COUNTER_MODULO, FrameMaker
from gateway.command.gate import Gate
from gateway.command.limits import Limits
from gateway.command.stop import StopSequence
from gateway.guard.sight import Sight
from schemas.decisions import StopPhase
from schemas.messages import GearPosition, Mode, Variant
from schemas.settings import GUARD_SILENT_NS, TICK_NS, CommandSettings

_MOVING_GEARS: Final = frozenset({GearPosition.DRIVE, GearPosition.REVERSE})

_SPEED_MAX_MPS: Final = 2.222
_ANGLE_MAX_DEG: Final = 24.0
"""What the chassis can do (manual V2.0, 2.2): the gate admits no more, whatever the heartbeat says."""

STANDS: Final = "the robot stands"
UNSEEN: Final = "the robot is not seen to stand"
REMOTE: Final = "the hand transmitter has the robot"
"""How a stop ends."""

_HEARD_AHEAD_MAX: Final = 3
"""A counter heard on the bus may be this far ahead of the heartbeat's: the gateway died between the two."""


class Stopper:
    """Brings the robot to rest from what it was last told, frame by frame.

    Attributes:
        is_over: nothing more is to be sent.
        frames: how many were sent.
        outcome: how it ended, in words; empty before.
    """

    def __init__(self, sight: Sight, settings: CommandSettings) -> None:
        self._sight = sight
        self._deceleration_mps2 = Limits.of(settings).emergency_deceleration_mps2
        self._pedal_percent = settings.brake_pedal_percent
        self._maker = FrameMaker()
        self._gate = Gate()
        self._sequence: StopSequence | None = None
        self._before: StopSequence | None = None
        self._variant = Variant.UNKNOWN
        self._due_ns = 0
        self._offered: list[Frame] = []
        self.is_over = True
        self.frames = 0
        self.outcome = ""

    def begin(self, last: Actuation, variant: Variant, counters: bytes | None, now_ns: int) -> None:
        """Begin to stop.

        Args:
            last: what the chassis was last told, as far as is known; taken with caution.
            variant: while it is not known only zero speed is sent.
            counters: the next alive counters in the layout's order; None if only the bus can tell.
            now_ns: monotonic.
        """
        self._variant = variant
        self._sequence = StopSequence(
            _possible(last, variant), self._deceleration_mps2, self._pedal_percent, now_ns
        )
        # What was sent by others is not this gate's to judge: it begins anew.
        self._gate = Gate()
        self._maker.counters = self._counters(counters, now_ns)
        self._due_ns = now_ns
        self.is_over = False
        self.frames = 0
        self.outcome = ""

    def tick(self, now_ns: int) -> list[Frame]:
        """The frames that are due now; none between two ticks of the bus, and none once it is over."""
        if self._sequence is None or self.is_over:
            return []
        if self._sight.mode(now_ns) is Mode.REMOTE:
            return self._end(REMOTE)
        stands = self._sight.stands(self._variant, now_ns)
        if now_ns < self._due_ns:
            return []
        self._due_ns += TICK_NS * (1 + (now_ns - self._due_ns) // TICK_NS)
        self._before = copy(self._sequence)
        actuation = self._sequence.tick(now_ns, stands=stands)
        if actuation is None:
            return self._end(STANDS if stands else UNSEEN)
        frames = self._maker.make(actuation, [], self._variant)
        fault = self._gate.admit(frames, self._variant, now_ns)
        self.outcome = "" if fault is None else f"the gate refused: {fault.detail}"
        self._offered = [] if fault else frames
        return self._offered

    def sent(self, count: int, now_ns: int) -> None:
        """So many of the frames of this tick were taken by the bus."""
        sent = self._offered[:count]
        if count < len(self._offered):
            # The chassis was not told: a stop that nobody heard must not go on to neutral.
            self._sequence = self._before
        self._offered = []
        self._maker.sent(sent)
        self._gate.sent(sent, now_ns)
        self.frames += len(sent)

    def give_up(self, outcome: str) -> None:
        """Send nothing more."""
        self._end(outcome)

    @property
    def phase(self) -> StopPhase:
        """How far it has come."""
        return StopPhase.IDLE if self._sequence is None or self.is_over else self._sequence.phase

    def _counters(self, counters: bytes | None, now_ns: int) -> dict[str, int]:
        """The counters to go on with: those heard on the bus may be a little ahead of those known."""
        names, sight = self._maker.counters, self._sight
        if counters is None:
            return dict.fromkeys(names, 0) | sight.next_counters
        known = dict(zip(names, counters, strict=True))
        if sight.commander_ns is None or now_ns - sight.commander_ns > GUARD_SILENT_NS:
            return known
        return {name: _further(counter, sight.next_counters.get(name)) for name, counter in known.items()}

    def _end(self, outcome: str) -> list[Frame]:
        self.is_over = True
        self.outcome = outcome
        return []


def _possible(last: Actuation, variant: Variant) -> Actuation:
    """What can be meant by this: nothing in it may keep the stop sequence from passing the gate."""
    in_gear = last.gear in _MOVING_GEARS
    moves = in_gear and not last.parking and variant is not Variant.UNKNOWN
    return Actuation(
        enabled=True,
        gear=last.gear if in_gear else GearPosition.NEUTRAL,
        speed_mps=_clamped(last.speed_mps, 0.0, _SPEED_MAX_MPS) if moves else 0.0,
        angle_deg=_clamped(last.angle_deg, -_ANGLE_MAX_DEG, _ANGLE_MAX_DEG),
        parking=last.parking,
    )


def _clamped(value: float, low: float, high: float) -> float:
    return max(low, min(high, value)) if isfinite(value) else 0.0


def _further(known: int, heard: int | None) -> int:
    """The counter to go on with: the one that was heard if it is a little ahead, else the one that is known."""
    if heard is not None and (heard - known) % COUNTER_MODULO <= _HEARD_AHEAD_MAX:
        return heard
    return known
