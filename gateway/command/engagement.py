"""Each way into and out of motion: engage, stop, hand over, latch; warn people, disengage an idle robot. Pure."""

from __future__ import annotations

from math import inf
from typing import Final

import msgspec

from gateway.chassis.port import Actuation, Chassis
from gateway.command.auxiliary import Auxiliary
from gateway.command.monitor import ChassisMonitor
from gateway.command.motion import MotionLimits, MotionProfile, Setpoint, Target
from gateway.command.output import (
    IN_GEAR,
    Handover,
    Output,
    inferred_actuation,
    inferred_angle_deg,
    may_be_stopped,
)
from gateway.command.rulings import STOPS, TRANSITIONS, Latches, Outbox, Ruling, StopRule, Trigger
from gateway.command.stop import StopSequence
from schemas.decisions import COMMANDING, ArbiterState, EventKind, Severity, StopPhase
from schemas.messages import GearPosition, Mode, ParkingStatus
from schemas.reasons import AS_ASKED, TEXTS, Reason
from schemas.settings import (
    ENGAGE_TIMEOUT_NS,
    REPEATED_NS,
    RETURN_NS,
    SLIPS_NS,
    TICK_NS,
    WARN_AGAIN_NS,
    CommandSettings,
)

_NS_PER_S: Final = 1_000_000_000


class Standing:
    """The times of an engaged robot at standstill. ``idle_ns``: it is disengaged after this time; 0 is never."""

    def __init__(self, settings: CommandSettings) -> None:
        self.idle_ns = round(settings.idle_s * _NS_PER_S)
        self._warning_ns = round(settings.warning_s * _NS_PER_S)
        self._asked_ns = self._stood_ns = 0

    def begin(self, now_ns: int) -> None:
        """Begin with a robot at standstill: people are warned before it moves."""
        self._asked_ns = now_ns
        self._stood_ns = now_ns + self._warning_ns

    def tick(self, now_ns: int, *, is_asked: bool, is_parked: bool, moves: bool) -> None:
        """Note whether a speed is requested, and whether one was commanded in the last tick."""
        if is_asked:
            self._asked_ns = now_ns
        if moves:
            self._stood_ns = now_ns
        elif is_asked and not is_parked and now_ns - self._stood_ns >= WARN_AGAIN_NS:
            self._stood_ns = now_ns + self._warning_ns

    def warning_until_ns(self, now_ns: int) -> int | None:
        """Return when the present warning ends; None if there is none."""
        return self._stood_ns if now_ns < self._stood_ns else None

    def is_idle(self, now_ns: int) -> bool:
        """No speed was requested for ``idle_ns``."""
        return 0 < self.idle_ns <= now_ns - self._asked_ns


class Engagement:
    """The robot under command: its states, and every way into and out of motion.

    Attributes:
        stop_reason, stop_detail: cause and figures of the last stop.
        owes_stop: a stop could not be carried out, or ended without an applied parking brake.
        engage_until_ns: while engaging, the time by which the chassis must read auto, monotonic.
        is_closing: the gateway shuts down; engage requests are refused.
        needs_guard: the robot is not commanded without a guard.
        is_after_crash: the gateway before this one crashed: the first uncommanded motion is latched.
        bars: reasons outside the command flow against engaging, each with its words.
    """

    def __init__(self, chassis: Chassis, settings: CommandSettings, *, needs_guard: bool) -> None:
        self._design = chassis
        self.state = ArbiterState.STANDBY
        self.monitor = ChassisMonitor(chassis)
        self.setpoint = Setpoint(settings)
        self.output = Output(chassis)
        self.standing = Standing(settings)
        self.auxiliary = Auxiliary(chassis)
        self.handover = Handover()
        self.latches = Latches()
        self.outbox = Outbox()
        self.stop_reason = Reason.NONE
        self.stop_detail = ""
        self.owes_stop = False
        self.engage_until_ns = 0
        self.is_closing = False
        self.needs_guard = needs_guard
        self.is_after_crash = False
        self.bars: dict[Reason, str] = {}
        self._is_brake_missed = False
        self._stray_ns: int | None = None
        self._returns = 0
        self._rested_ns: int | None = None

    def blockers(self, now_ns: int) -> list[Reason]:
        """Return why the robot cannot be engaged now, the most severe first."""
        monitor, chassis = self.monitor, self.monitor.chassis
        conditions = {
            Reason.SHUTDOWN: self.is_closing,
            Reason.BUS_DOWN: not chassis.bus_up,
            Reason.UNGUARDED: self.needs_guard and not chassis.guarded,
            Reason.GUARD: chassis.guard_sends,
            Reason.HAND_TRANSMITTER: chassis.mode is Mode.REMOTE,
            Reason.OTHER_COMMANDER: monitor.is_commanded_by_other(now_ns),
        }
        blockers = [*self.latches.details, *self.bars]
        blockers += [reason for reason, holds in conditions.items() if holds and reason not in blockers]
        faults = monitor.chassis_faults()
        blockers += faults
        if not faults and not monitor.stands:
            blockers.append(Reason.MOVING)
        return blockers

    # Into motion.

    def begin_engaging(self, limits: MotionLimits, now_ns: int) -> None:
        """Command the five enables with zero speed, after all checks."""
        self._go(Trigger.ENGAGE)
        self.owes_stop = self.is_after_crash = False
        self._returns = 0
        chassis, configured = self.monitor.chassis, self.setpoint.configured_limits
        self.setpoint.reset(limits)
        angle_deg = inferred_angle_deg(chassis, configured)
        self.output.motion = MotionProfile(
            angle_deg, chassis.gear if chassis.gear in IN_GEAR else GearPosition.NEUTRAL
        )
        self._begin_output(Actuation(angle_deg=angle_deg))
        self.auxiliary.end(now_ns)
        self.monitor.send_failures = 0
        self.engage_until_ns = now_ns + ENGAGE_TIMEOUT_NS

    def confirm(self, holder: str, now_ns: int) -> None:
        """Change to engaged, because the chassis reads auto."""
        self._go(Trigger.CONFIRMED)
        self.standing.begin(now_ns)
        self.setpoint.target = Target(0.0, self.output.motion.angle_deg)
        self.outbox.settle("engage", Ruling())
        text = "engaged: the chassis reads auto"
        self.outbox.add_event(Severity.INFO, EventKind.ENGAGED, Reason.NONE, text, holder)

    # Out of motion.

    def begin_stop(self, reason: Reason, now_ns: int, detail: str = "", operator: str = "") -> None:
        """Bring a robot under command to rest, and latch the cause if the table says so."""
        rule = STOPS[reason]
        self.latch(reason, detail, now_ns, operator)
        output, chassis = self.output, self.monitor.chassis
        deceleration_mps2 = self._deceleration_mps2(rule)
        if output.sequence is not None:
            output.sequence.hasten(deceleration_mps2)
            if rule.parks:
                output.sequence.park(now_ns)
            return
        last = self._last_told()
        is_stray = self.state is ArbiterState.STANDBY
        if is_stray:
            is_barred = not chassis.bus_up or chassis.mode is Mode.REMOTE
            self.owes_stop |= is_barred and reason is Reason.REMOTE_STOP
            if not may_be_stopped(chassis):
                return  # Silent in standby.
            self.setpoint.limits = self.setpoint.configured_limits
            self._begin_output(last)
        returns = self._count_returns(now_ns) if is_stray else 0
        output.sequence = StopSequence(
            last,
            deceleration_mps2,
            now_ns,
            returns,
            may_release=not is_stray,
            stood_by_motor=not is_stray and last.parking and 0 < output.motion.held_ticks * TICK_NS <= SLIPS_NS,
        )
        if is_stray and Reason.BRAKE_SLIPS in self.latches.details and not last.parking:
            # The motor held it before; do not try again a brake that slips.
            output.sequence.release(now_ns)
        is_repeated = is_stray and self._note_stray(now_ns)
        # With an unknown mode the remote control may be in command: a ramp would leave a speed in the chassis.
        is_unsure = is_stray and chassis.mode is not Mode.AUTO
        if rule.parks or chassis.mode is Mode.STOP or is_unsure or is_repeated:
            output.sequence.park(now_ns)
        self._is_brake_missed = self.owes_stop = False
        self.auxiliary.end(now_ns)
        if self.latches.details:
            self.auxiliary.show_hazard()
        self.stop_reason, self.stop_detail = reason, detail
        self._go(Trigger.STOP)
        self.outbox.refuse_pending(reason, detail)
        is_calm = self.monitor.stands or reason in AS_ASKED
        severity = Severity.INFO if is_calm and not rule.at_once else Severity.WARNING
        text = f"stopping: {_in_words(reason, detail)}"
        self.outbox.add_event(severity, EventKind.STOP, reason, text, operator)

    def release_brake(self, now_ns: int, detail: str) -> None:
        """Release a parking brake that slips, so that the motor holds the robot again. Latched."""
        self.begin_stop(Reason.BRAKE_SLIPS, now_ns, detail)
        if self.output.sequence is not None:
            self.output.sequence.release(now_ns, self.monitor.chassis.wheel_speed_mps)

    def latch(self, reason: Reason, detail: str, now_ns: int, operator: str = "") -> None:
        """Keep the robot from being engaged until a reset, if the table says so."""
        # Guard and gateway may have died together while the robot drove, so nothing was latched.
        is_left_moving = self.is_after_crash and reason is Reason.FOUND_MOVING
        self.is_after_crash &= not is_left_moving
        if not STOPS[reason].latched and not is_left_moving:
            return
        self.auxiliary.show_hazard()
        is_new_hit = reason is Reason.REMOTE_STOP or reason in self.monitor.struck
        if self.latches.add(reason, detail, now_ns, is_new_hit=is_new_hit):
            text = f"latched until a reset: {_in_words(reason, detail)}"
            self.outbox.add_event(Severity.ERROR, EventKind.LATCH, reason, text, operator)

    def prove(self, reason: Reason, claimed: str, proven: str, operator: str) -> None:
        """Replace the claimed sender of a remote stop by the proven one. The event has no reason of its own."""
        if not self.latches.withdraw(claimed):
            return
        if (self.stop_reason, self.stop_detail) == (reason, claimed):
            self.stop_detail = proven
        text = f"proven: {_in_words(reason, proven)}"
        self.outbox.add_event(Severity.INFO, EventKind.LATCH, Reason.NONE, text, operator)

    def refuse_output(self, detail: str, now_ns: int) -> Actuation:
        """Stop the robot, because the gate refused this tick's output: an internal fault.

        Returns the command instead: zero speed and the parking brake, all else as commanded last.
        """
        self.output.undo_step()
        last = self._last_told()
        self.begin_stop(Reason.GATE, now_ns, detail)
        instead = msgspec.structs.replace(last, enabled=True, speed_mps=0.0, parking=True)
        self.output.replace_step(instead)
        return instead

    def shut_down(self, now_ns: int) -> None:
        """Bring the robot to rest, and refuse further engage requests."""
        self.is_closing = True
        text = "shutting down"
        self.outbox.add_event(Severity.INFO, EventKind.GATEWAY, Reason.SHUTDOWN, text)
        if self.state in COMMANDING:
            self.begin_stop(Reason.SHUTDOWN, now_ns)

    def step_stop(self, sequence: StopSequence, now_ns: int, late_ns: int) -> Actuation | None:
        """Return this tick's command of a stop; None when the stop has ended."""
        actuation = self.output.step_stop(sequence, self.monitor, now_ns, late_ns)
        if sequence.lacks_brake(now_ns) and not self._is_brake_missed:
            self._is_brake_missed = True
            text = "the parking brake does not read applied; the motor holds the robot in gear until it does"
            self.outbox.add_event(Severity.ERROR, EventKind.FAULT, Reason.NOT_CONFIRMED, text)
        if sequence.stays and Reason.BRAKE_SLIPS not in self.latches.details:
            moved = f"it moved {sequence.returns} times without enables"
            detail = f"{moved if sequence.returns else 'it rolled behind the brake'}; it stays in gear"
            self.begin_stop(Reason.BRAKE_SLIPS, now_ns, detail)
        if actuation is None:
            self._returns, self._rested_ns = sequence.returns, now_ns
            self._rest(now_ns)
        return actuation

    @property
    def is_held_by_motor(self) -> bool:
        """True if a stop cannot end, because the parking brake does not hold the robot."""
        return self.output.sequence is not None and self.output.sequence.stays

    def may_finish(self, now_ns: int) -> bool:
        """Return True if a reset may end such a stop: the robot has stood braked for long enough."""
        sequence = self.output.sequence
        return sequence is not None and sequence.stays and sequence.is_braked(now_ns)

    def finish_stop(self, now_ns: int) -> None:
        """Let such a stop end; it begins again if the robot moves."""
        if self.output.sequence is not None:
            self.output.sequence.finish(now_ns)

    def leave(self, reason: Reason, now_ns: int) -> None:
        """End the output at once, because another party commands the chassis or no command can reach it."""
        output, chassis = self.output, self.monitor.chassis
        detail = chassis.guard_says if reason is Reason.GUARD else ""
        if reason is Reason.GUARD:
            self.latch(reason, detail, now_ns)
        self._go(Trigger.YIELD)
        told = output.actuation if output.actuation is not None else Actuation(parking=self.setpoint.parked)
        is_held_by_motor = output.stop_phase is StopPhase.MOTOR
        self.handover.leave(told, reason, chassis, now_ns, is_held_by_motor=is_held_by_motor)
        self.auxiliary.leave(now_ns)
        output.cease()
        self.stop_reason, self.stop_detail = reason, ""
        self.outbox.refuse_pending(reason, "")
        kind = EventKind.GUARD if reason is Reason.GUARD else EventKind.TAKEOVER
        text = f"commanding ended: {_in_words(reason, detail)}"
        self.outbox.add_event(Severity.WARNING, kind, reason, text)

    @property
    def is_loose(self) -> bool:
        """True if the parking brake reads released, and can be commanded."""
        chassis = self.monitor.chassis
        return chassis.brake is ParkingStatus.RELEASED and may_be_stopped(chassis)

    def _rest(self, now_ns: int) -> None:
        monitor = self.monitor
        self.output.sequence = None
        self.owes_stop = monitor.chassis.brake is not ParkingStatus.APPLIED
        self._go(Trigger.REST)
        is_seen = monitor.stands and monitor.is_rest_confirmed
        text = "at standstill, no commands sent" if is_seen else f"no commands sent, but {monitor.rest(now_ns)}"
        if monitor.is_commanded_by_other(now_ns):
            text = "no commands sent, but another computer commands the robot and can move it"
        severity = Severity.INFO if is_seen else Severity.ERROR
        self.outbox.add_event(severity, EventKind.STOPPED, self.stop_reason, f"stopped: {text}")

    def _begin_output(self, last: Actuation) -> None:
        """Begin to command the chassis; ``last`` is its previous command."""
        chassis = self.monitor.chassis
        self.output.begin(chassis.variant)
        self.monitor.plausibility.forget(chassis.wheel_speed_mps or 0.0, last.angle_deg)
        self.handover.begin(chassis)

    def _last_told(self) -> Actuation:
        """Return the chassis's last command, known or inferred, from which a stop begins."""
        if self.output.actuation is not None:
            return self.output.actuation
        limits, left = self.setpoint.configured_limits, self.handover.left
        return inferred_actuation(self.monitor.chassis, limits, self._design.wheelbase_m, left)

    def forget_rest(self) -> None:
        """Forget the last rest: motion commanded by others is no evidence about the parking brake."""
        self._returns, self._rested_ns = 0, None

    def _count_returns(self, now_ns: int) -> int:
        """Return how often the robot has moved since its last stop withdrew the enables."""
        is_return = self._rested_ns is not None and now_ns - self._rested_ns < RETURN_NS
        return self._returns + 1 if is_return and self.monitor.chassis.moves else 0

    def _note_stray(self, now_ns: int) -> bool:
        """Note a stop that begins in standby. Returns True if another one began just before: the mode flickers."""
        before_ns, self._stray_ns = self._stray_ns, now_ns
        return before_ns is not None and now_ns - before_ns < REPEATED_NS

    def _deceleration_mps2(self, rule: StopRule) -> float:
        if not rule.ramps:
            return inf
        limits = self.setpoint.configured_limits
        at_once = rule.at_once or self.latches.details
        return limits.emergency_deceleration_mps2 if at_once else limits.deceleration_mps2

    def _go(self, trigger: Trigger) -> None:
        self.state = TRANSITIONS[self.state, trigger]


def _in_words(reason: Reason, detail: str) -> str:
    return "; ".join(filter(None, (TEXTS[reason].means, detail)))
