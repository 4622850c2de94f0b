"""The heartbeats of loop and guard, and one stop sequence on the bus, which ``cruiser halt`` runs too. Pure."""

from __future__ import annotations

from copy import copy
from enum import Enum
from math import isfinite
from typing import Final

import msgspec
from msgspec.structs import replace

from gateway.chassis.frame import Frame
from gateway.chassis.port import AT_REST, Actuation, BusView, Chassis
from gateway.command.motion import MotionLimits
from gateway.command.stop import StopFeedback, StopSequence
from schemas.can_word import COUNTER_SPAN
from schemas.decisions import StopPhase
from schemas.messages import GearPosition, Mode, Variant
from schemas.settings import GUARD_LOOK_NS, GUARD_SILENT_NS, OFF_BURSTS, TICK_NS, YIELD_BURSTS, CommandSettings


class Beat(msgspec.Struct, frozen=True):
    """The loop's sign of life, each tick, after it has sent.

    Attributes:
        is_left: another controller took the chassis over while it held the command ``last``, and may give it back.
    """

    now_ns: int  # monotonic, after the loop has sent
    told_ns: int = 0  # when the bus last accepted a whole burst
    is_active: bool = False  # the chassis is under command, or was until the tick before, where a stop ended
    is_left: bool = False
    is_mute: bool = False  # the output cannot be sent; the guard has to act at once
    is_closing: bool = False
    variant: Variant = Variant.UNKNOWN
    last: Actuation = AT_REST  # the chassis's last command; AT_REST if it no longer counts
    counters: bytes = bytes(8)  # the next alive counter of each command frame, in the layout's order
    is_released: bool = False  # the stop holds the robot by its motor, because the parking brake does not hold it
    returns: int = 0  # how often the robot moved in this stop after the enables were gone


class Cause(Enum):
    """Causes for a stop by the guard, as text."""

    NONE = "it has not acted"
    LATE = "the gateway's loop gave no sign of life"
    MUTE = "the gateway could not send"
    GONE = "the gateway is gone"


class StopOutcome(Enum):
    """Outcomes of a stop by the guard, as text."""

    NONE = ""
    STANDS = "the robot stands"
    UNSEEN = "the robot is not seen to stand"
    REMOTE = "the remote control has the robot"
    OTHER = "the remote control had the robot, and another computer commands it since"
    GIVEN_UP = "it has given up"
    MOTOR = "the motor alone holds the robot, by its last command: chock its wheels"


class GuardView(msgspec.Struct, frozen=True):
    """The guard as the loop sees it."""

    is_watching: bool = False  # it is alive, has its bus and receives feedback: it would stop the robot
    is_sending: bool = False  # it is alive and stops the robot; the loop must not send
    stops: int = 0  # stops begun since the start
    says: str = ""  # cause and outcome of the last stop; empty if there was none


class GuardStatus(msgspec.Struct, frozen=True):
    """The guard's sign of life.

    Attributes:
        is_sending: it stops the robot, or waits for the remote control to give it back; the loop must not send.
    """

    now_ns: int
    is_ready: bool = False  # its bus is open and it receives feedback
    is_sending: bool = False
    stops: int = 0
    cause: Cause = Cause.NONE  # of the current or last stop
    outcome: StopOutcome = StopOutcome.NONE  # of the last stop; NONE while one is under way

    @property
    def says(self) -> str:
        """Cause and outcome as text; empty if there was no stop."""
        return "" if self.cause is Cause.NONE else "; ".join(filter(None, (self.cause.value, self.outcome.value)))


_MOVING_GEARS: Final = frozenset({GearPosition.DRIVE, GearPosition.REVERSE})

STANDS: Final = StopOutcome.STANDS.value
UNSEEN: Final = StopOutcome.UNSEEN.value
REMOTE: Final = StopOutcome.REMOTE.value
OTHER: Final = StopOutcome.OTHER.value
MOTOR: Final = StopOutcome.MOTOR.value
NOT_OBEYED: Final = "no response to zero speed and the parking brake"
"""Ends of a stop, and reasons to wait."""

_AHEAD_MAX: Final = 3
"""Lead of a counter on the bus over the heartbeat's, where the gateway died between the two."""


class Stopper:
    """Brings the robot to rest, frame by frame, from its last command, and never faster than its measured speed.

    A ramp from an old speed must not set a resting robot moving: a stop that begins late or was interrupted reads
    the feedback first. While the remote control (RC) has the robot the stop waits, because the chassis executes
    its last command afterwards.
    """

    def __init__(self, chassis: Chassis, view: BusView, settings: CommandSettings) -> None:
        self._chassis = chassis
        self._view = view
        self._deceleration_mps2 = MotionLimits.of(settings).emergency_deceleration_mps2
        self._maker = chassis.maker()
        self._gate = chassis.gate(False)  # noqa: FBT003 - a value of the chassis takes no keywords
        # The chassis holds these too until they are ended.
        self._last = (chassis.hazard, chassis.horn[False], chassis.odometer[False])
        self._sequence: StopSequence | None = None
        self._before: StopSequence | None = None
        self._variant = Variant.UNKNOWN
        # The chassis's last command and its time; None if unknown.
        self._told: Actuation | None = None
        self._told_ns: int | None = None
        self._actuation = AT_REST
        # Start of the sequence, or the time of its last accepted burst.
        self._went_on_ns = self._look_until_ns = self._paused_ns = self._due_ns = 0
        self._bursts_off = self._partings = 0
        self._offered: list[Frame] = []
        self._is_released, self._returns, self._may_release = False, 0, False
        self.is_over = True  # nothing more is to be sent
        self.is_paused = False  # nothing is sent, because the remote control has the robot
        self.frames = 0
        self.outcome = ""  # as text; empty before the end

    def begin(
        self,
        last: Actuation | None,
        variant: Variant,
        counters: bytes | None,
        now_ns: int,
        told_ns: int | None = None,
        *,
        is_released: bool = False,
        returns: int = 0,
    ) -> None:
        """Begin to stop.

        Args:
            last: the chassis's last command; None if unknown.
            variant: while it is UNKNOWN only zero speed is sent.
            counters: the next alive counters in the layout's order; None to take them from the bus.
            told_ns: when ``last`` was sent; ``now_ns`` by default.
            is_released: the motor holds the robot, because its parking brake does not.
            returns: how often it has moved after the enables were gone.
        """
        self._is_released, self._returns = is_released, returns
        self._may_release = last is not None and not is_released
        self._variant = variant
        self._told = last
        self._told_ns = now_ns if told_ns is None else told_ns
        # A new gate: frames sent by others do not count for it.
        self._gate = self._chassis.gate(self._may_release)
        self._maker.counters, self._maker.is_torn = self._counters(counters, now_ns), False
        self._due_ns = now_ns
        self.is_over = self.is_paused = False
        self.frames = 0
        self.outcome = ""
        self._look(now_ns)

    def tick(self, now_ns: int) -> list[Frame]:
        """Return the frames due now; none between two bus ticks or after the end."""
        if self.is_over:
            return []
        stands = self._view.stands(self._variant, now_ns)
        mode = self._view.mode(now_ns)
        is_held = self._is_held(mode, now_ns)
        if now_ns < self._due_ns or self.is_over:
            return []
        self._due_ns += TICK_NS * (1 + (now_ns - self._due_ns) // TICK_NS)
        if is_held:
            return self._part(now_ns) if mode is Mode.REMOTE else []
        if self._sequence is not None and now_ns - self._went_on_ns > GUARD_SILENT_NS:
            # This process stood still, or the bus was away: others may have done anything meanwhile.
            self._look(now_ns)
        if self._sequence is None and not self._start(mode, now_ns):
            return []
        return self._next_burst(now_ns, stands=stands)

    def _next_burst(self, now_ns: int, *, stands: bool) -> list[Frame]:
        if self._sequence is None:
            return []
        is_held = self._view.is_braked(now_ns) is not False and not self._view.moves(self._variant, now_ns)
        if self._view.mode(now_ns) is Mode.STOP and not is_held:
            # Nothing commands or holds it: request the parking brake all the same.
            self._sequence.park(now_ns)
        self._before = copy(self._sequence)
        actuation = self._sequence.tick(now_ns, self._stop_feedback(now_ns, stands=stands))
        if actuation is None:
            self.give_up(STANDS if stands else UNSEEN)
            return []
        frames = self._maker.make(
            actuation, list(self._last) if self._bursts_off < OFF_BURSTS else [], self._variant
        )
        fault = self._gate.admit(frames, self._variant, now_ns, stopping=True)
        self.outcome = "" if fault is None else f"the gate refused: {fault.detail}"
        self._actuation = actuation
        self._offered = [] if fault else frames
        return self._offered

    def _part(self, now_ns: int) -> list[Frame]:
        """Command zero speed to a chassis that the remote control has: it executes that when it is given back."""
        left = self._actuation if self._sequence is not None else self._told
        if not self._partings or left is None or not left.enabled:
            return []
        self._partings -= 1
        self._before = self._sequence
        # Where only the motor held it, the parking brake would let it roll once it is given back.
        is_released = self._sequence is not None and self._sequence.phase is StopPhase.MOTOR
        self._actuation = replace(self._possible(left), speed_mps=0.0, parking=not is_released)
        frames = self._maker.make(self._actuation, [], self._variant)
        self._offered = [] if self._gate.admit(frames, self._variant, now_ns, stopping=True) else frames
        return self._offered

    def sent(self, count: int, now_ns: int) -> None:
        """Note that the bus accepted the first ``count`` frames of this tick."""
        sent = self._offered[:count]
        if count >= len(self._chassis.motion_frames):
            self._told, self._told_ns, self._went_on_ns = self._actuation, now_ns, now_ns
            self._bursts_off += count == len(self._offered)
        elif self._offered:
            # The command did not arrive: the stop must not proceed to neutral.
            stepped, self._sequence = self._sequence, self._before
            if sent and stepped is not None and self._before is not None:
                self._sequence = stepped.after_part(self._before, self._actuation.speed_mps)
        self._offered = []
        self._maker.sent(sent)
        self._gate.sent(sent, now_ns)
        self.frames += len(sent)

    def _is_held(self, mode: Mode, now_ns: int) -> bool:
        """Return True if nothing may be sent: the remote control has the robot, or had it and is unseen."""
        if mode is Mode.REMOTE and not self.is_paused:
            self.is_paused, self._paused_ns = True, now_ns
            self._partings = YIELD_BURSTS
        if not self.is_paused:
            return False
        commander_ns = self._view.commander_ns
        if commander_ns is not None and commander_ns - self._paused_ns > GUARD_SILENT_NS:
            self.give_up(OTHER)
            return True
        if mode not in {Mode.AUTO, Mode.STOP}:
            return True
        # Zero speed at once, without a ramp, whatever command the chassis holds.
        self.is_paused = False
        self._told, self._told_ns = replace(self._told or AT_REST, speed_mps=0.0), None
        self._look(now_ns)
        return False

    def _look(self, now_ns: int) -> None:
        """Restart the sequence once its starting point is known."""
        self._sequence = None
        self._look_until_ns = now_ns + GUARD_LOOK_NS
        self._bursts_off = 0
        self._gate.pause()

    def _start(self, mode: Mode, now_ns: int) -> bool:
        """Begin the sequence, unless feedback that decides its start may still arrive."""
        told, told_ns = self._told, self._told_ns
        first = told if told_ns is not None and now_ns - told_ns <= GUARD_SILENT_NS else None
        if first is None:
            if not self._view.is_complete(now_ns) and now_ns < self._look_until_ns:
                return False
            first = self._seen(now_ns)
        slowest_mps = self._view.slowest_mps(self._variant, now_ns)
        if slowest_mps is not None:
            first = replace(first, speed_mps=_lower(first.speed_mps, slowest_mps))
        self._sequence = StopSequence(
            self._possible(first), self._deceleration_mps2, now_ns, self._returns, may_release=self._may_release
        )
        if self._is_released and not first.parking:
            self._sequence.release(now_ns)
        if (
            not self.stays
            and mode is Mode.STOP
            and self._view.is_braked(now_ns)
            and not self._view.moves(self._variant, now_ns)
        ):
            # In mode stop and held by its brake: enables would only switch it back to auto.
            self._sequence.phase = StopPhase.DISABLE
        self._went_on_ns = now_ns
        return True

    def _seen(self, now_ns: int) -> Actuation:
        """Infer the chassis's command from its feedback; without feedback assume that it is parked."""
        gear = self._view.gear(now_ns)
        speed_mps = self._view.slowest_mps(self._variant, now_ns) or 0.0
        return Actuation(
            enabled=True,
            gear=gear,
            speed_mps=speed_mps if self._told is None else _lower(self._told.speed_mps, speed_mps),
            angle_deg=self._view.angle_deg(now_ns),
            parking=gear in {GearPosition.PARK, GearPosition.UNDEFINED},
        )

    def _stop_feedback(self, now_ns: int, *, stands: bool) -> StopFeedback:
        view, variant = self._view, self._variant
        is_braked = view.is_braked(now_ns)
        is_open = view.mode(now_ns) is not Mode.AUTO
        return StopFeedback(
            stands=stands,
            moves=view.moves(variant, now_ns),
            speed_mps=view.fastest_mps(variant, now_ns),
            wheel_speed_mps=view.wheel_speed_mps(variant, now_ns),
            # In mode stop the chassis need not heed the request.
            is_braked=None if is_open and not is_braked else is_braked,
        )

    def is_transmitting(self, now_ns: int) -> bool:
        return now_ns - self._went_on_ns <= GUARD_SILENT_NS

    def give_up(self, outcome: str) -> None:
        self.is_over = True
        self.outcome = outcome

    @property
    def stays(self) -> bool:
        """The stop does not end: only the motor holds the robot."""
        return self._sequence is not None and self._sequence.stays

    @property
    def phase(self) -> StopPhase:
        """The phase of the stop; IDLE if there is none."""
        return StopPhase.IDLE if self._sequence is None or self.is_over else self._sequence.phase

    def _counters(self, counters: bytes | None, now_ns: int) -> dict[str, int]:
        """Return the counters to continue with; those on the bus may be slightly ahead of the known ones."""
        names, view = self._maker.counters, self._view
        if counters is None:
            return dict.fromkeys(names, 0) | view.next_counters
        known = dict(zip(names, counters, strict=True))
        if view.commander_ns is None or now_ns - view.commander_ns > GUARD_SILENT_NS:
            return known
        return {name: _further(counter, view.next_counters.get(name)) for name, counter in known.items()}

    def _possible(self, last: Actuation) -> Actuation:
        """Clamp the command to the chassis's limits, so that the stop always passes the gate."""
        top_mps, top_deg = self._chassis.top_speed_mps, self._chassis.top_angle_deg
        in_gear = last.gear in _MOVING_GEARS
        moves = in_gear and not last.parking and self._variant is not Variant.UNKNOWN
        return Actuation(
            enabled=True,
            gear=last.gear if in_gear else GearPosition.NEUTRAL,
            speed_mps=_clamped(last.speed_mps, 0.0, top_mps) if moves else 0.0,
            angle_deg=_clamped(last.angle_deg, -top_deg, top_deg),
            parking=last.parking,
        )


def _lower(told_mps: float, slowest_mps: float) -> float:
    """Return the lower speed; zero if the commanded one is not finite."""
    return min(told_mps, slowest_mps) if isfinite(told_mps) else 0.0


def _clamped(value: float, low: float, high: float) -> float:
    return max(low, min(high, value)) if isfinite(value) else 0.0


def _further(known: int, received: int | None) -> int:
    """Return the counter to continue with: the received one if it is slightly ahead, else the known one."""
    if received is not None and (received - known) % COUNTER_SPAN <= _AHEAD_MAX:
        return received
    return known
