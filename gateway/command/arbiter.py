"""The safety arbiter: requests and the chassis's state in, commands to the chassis out. Pure.

Read ``tick`` first: the chassis's state, the requests, the causes to stop, the command to the chassis. The states
that the steps act on have modules of their own: ``lease``, ``operator_link``, ``chassis_monitor``, ``setpoint``,
``output``, ``latches``, ``outbox``; ``engagement`` holds those of the robot under command together.
"""

from __future__ import annotations

from random import Random
from typing import Final

from gateway.command.actuation import Actuation
from gateway.command.chassis_state import ChassisState
from gateway.command.engagement import Engagement
from gateway.command.lease import Leases
from gateway.command.limits import MotionLimits
from gateway.command.motion import Target
from gateway.command.notices import Notices
from gateway.command.operator_link import OperatorLink
from gateway.command.outcome import TickOutcome
from gateway.command.request import Judged, RawRequest, Ruling
from gateway.command.verbs import Verbs
from schemas.decisions import COMMANDING, ArbiterState, Bound, EventKind, Severity
from schemas.messages import Mode, Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import SLIPS_NS, TICK_NS, Settings

_NS_PER_S: Final = 1_000_000_000
_TICK_BITS: Final = 40


class Arbiter:
    """Everything that decides whether and how the robot moves.

    Attributes:
        tick_number: rises with each tick, from a number that differs with each run.
        leases: the right to command.
        link: the commands of who holds the lease.
        engagement: the robot under command. Its states are the arbiter's attributes too: ``monitor``,
            ``setpoint``, ``output``, ``auxiliary``, ``handover``, ``latches``, ``outbox``.
    """

    def __init__(self, settings: Settings, run: int) -> None:
        """Begin in standby.

        Args:
            settings: limits and times.
            run: a random number of this run, which distinguishes its leases and ticks from others'. Public.
        """
        command = settings.command
        random = Random(run)  # noqa: S311 - tells runs apart; it keeps no secret
        self.tick_number = random.getrandbits(_TICK_BITS)
        self.leases = Leases(round(command.lease_s * _NS_PER_S), random)
        self.link = OperatorLink(command)
        self.engagement = Engagement(command, needs_guard=not settings.gateway.accept_unguarded)
        self.monitor = self.engagement.monitor
        self.setpoint = self.engagement.setpoint
        self.output = self.engagement.output
        self.auxiliary = self.engagement.auxiliary
        self.handover = self.engagement.handover
        self.latches = self.engagement.latches
        self.outbox = self.engagement.outbox
        self._verbs = Verbs(settings, self.leases, self.link, self.engagement)
        self._notices = Notices()
        self._speed_limit_without_realtime_mps = command.speed_limit_without_realtime_mps
        self._guard_stops: int | None = None

    @property
    def state(self) -> ArbiterState:
        """The state in the arbiter's state table."""
        return self.engagement.state

    def tick(self, chassis: ChassisState, requests: list[RawRequest], now_ns: int, late_ns: int) -> TickOutcome:
        """Decide the command to the chassis for the next ten milliseconds.

        Args:
            chassis: its state now.
            requests: those received since the last tick, stops first.
            now_ns: monotonic.
            late_ns: delay of this tick's beginning.
        """
        self.tick_number += 1
        output = self.output
        self.monitor.update(chassis, now_ns, output.told)
        self.handover.is_cut_off &= not chassis.bus_up
        if chassis.variant is not output.variant:
            output.variant = Variant.UNKNOWN
        self._expire_lease(now_ns)
        judged = [Judged(request, self._rule(request, now_ns)) for request in requests]
        self._give_way(chassis, now_ns)
        self._stop_for_causes(chassis, now_ns, late_ns)
        output.begin_step()
        output.actuation = self._act(chassis, now_ns, late_ns)
        self._answer_odometer(chassis, now_ns)
        # Lamps, horn and odometer go with the five of a robot under command.
        is_under_command = self.state is not ArbiterState.STANDBY and output.actuation is not None
        auxiliary = self.auxiliary.frames(now_ns) if is_under_command else []
        return TickOutcome(output.actuation, auxiliary, judged, *self.outbox.take())

    def end_lease(self, reason: Reason, detail: str, now_ns: int) -> None:
        """Take the lease from its holder, whose grant does not hold any more, and stop the robot."""
        lease = self.leases.held
        if lease is None:
            return
        self.leases.end(reason)
        text = f"{lease.operator} loses the lease: {TEXTS[reason].means}; {detail}"
        self.outbox.add_event(Severity.WARNING, EventKind.LEASE, reason, text, lease.operator)
        if self.state in COMMANDING:
            self.engagement.begin_stop(reason, now_ns, detail, lease.operator)

    def note_left(self) -> None:
        """Note that the bus took the whole burst: what a chassis that was left executes again is now this one."""
        if self.handover.left is not None and self.output.actuation is not None:
            self.handover.left = self.output.actuation

    # What is asked.

    def _rule(self, request: RawRequest, now_ns: int) -> Ruling:
        ruling = self._verbs.rule(request, now_ns)
        self.outbox.answer(request, ruling)
        return ruling

    # What speaks against it.

    def _expire_lease(self, now_ns: int) -> None:
        lost = self.leases.expire(now_ns)
        if lost is None:
            return
        text = f"the lease of {lost.operator} expired"
        self.outbox.add_event(Severity.WARNING, EventKind.LEASE, Reason.LEASE_EXPIRED, text, lost.operator)
        if self.state in COMMANDING:
            self.engagement.begin_stop(Reason.LEASE_EXPIRED, now_ns, operator=lost.operator)

    def _give_way(self, chassis: ChassisState, now_ns: int) -> None:
        """Cease the output at once where somebody else commands the chassis, or no command can reach it."""
        before, self._guard_stops = self._guard_stops, chassis.guard_stops
        if self.engagement.state is ArbiterState.STANDBY:
            has_acted = before is not None and chassis.guard_stops > before
            if chassis.guard_sends or has_acted:
                self.engagement.latch(Reason.GUARD, chassis.guard_says, now_ns)
            return
        reason = self.handover.reason_to_yield(chassis)
        if reason is Reason.MODE_NOT_AUTO and (chassis.moves or self.state is ArbiterState.STOPPING):
            # Nobody commands it, and it may coast: the parking brake is told all the same.
            self.engagement.begin_stop(reason, now_ns)
        elif reason is not Reason.NONE:
            self.engagement.leave(reason, now_ns)

    def _stop_for_causes(self, chassis: ChassisState, now_ns: int, late_ns: int) -> None:
        engagement, hits = self.engagement, self.monitor.hits
        is_idle = engagement.state is ArbiterState.STANDBY
        self.outbox.add_events(self._notices.look(chassis, now_ns, late_ns, is_idle=is_idle))
        for bumper in hits:
            engagement.latch(bumper, "", now_ns)
        if engagement.state is ArbiterState.STANDBY:
            self._stop_for_strays(chassis, now_ns)
            return
        for bumper in hits:
            engagement.begin_stop(bumper, now_ns)
        self._stop_for_faults(now_ns, late_ns)
        if engagement.state in COMMANDING:
            self._stop_for_lapses(chassis, now_ns)

    def _stop_for_strays(self, chassis: ChassisState, now_ns: int) -> None:
        """Stop a chassis that executes a command which nobody renews. Only in standby."""
        engagement = self.engagement
        if self.handover.is_given_back(chassis) and self.latches.details:
            # The remote control may have released the parking brake that the latched stop applied.
            engagement.owes_stop = True
        is_taken = self.monitor.is_commanded_by_other(now_ns)
        if is_taken or chassis.mode is Mode.REMOTE:
            engagement.forget_rest()
        if self.handover.is_obeyed_again(chassis, now_ns, is_taken=is_taken):
            # It was left while it was being told something, and may obey that again: nothing resumes by itself.
            engagement.begin_stop(Reason.FOUND_MOVING, now_ns, "or about to move, by what it was told before")
        elif (
            engagement.owes_stop
            and not is_taken
            and engagement.is_loose
            and not self.handover.is_blind(chassis, now_ns)
        ):
            engagement.begin_stop(Reason.FOUND_MOVING, now_ns, "a stop could not be carried out before")
        elif self.monitor.found_moving(now_ns):
            engagement.begin_stop(Reason.FOUND_MOVING, now_ns)

    @property
    def limits_of_next_engage(self) -> MotionLimits:
        """The highest limits that would be in force if the robot were engaged now."""
        return self._lowered(self.setpoint.configured_limits)

    def _lowered(self, limits: MotionLimits) -> MotionLimits:
        chassis = self.monitor.chassis
        is_whole = chassis.guarded and chassis.realtime
        return limits if is_whole else limits.lowered(self._speed_limit_without_realtime_mps)

    def _stop_for_faults(self, now_ns: int, late_ns: int) -> None:
        # During a stop too: a graver cause hastens it, and may latch.
        is_engaged = self.state is ArbiterState.ENGAGED
        limit_mps = self.setpoint.limits.speed_mps
        for reason in self.monitor.faults(self.output.told, limit_mps, late_ns, now_ns, is_engaged=is_engaged):
            if reason is Reason.ROLLING and is_engaged and self._slips(now_ns):
                self.engagement.release_brake(now_ns, self.monitor.fault_detail(reason, late_ns))
            else:
                self.engagement.begin_stop(reason, now_ns, self.monitor.fault_detail(reason, late_ns))
        if self.monitor.plausibility.runs_away and self.output.sequence is not None:
            # A ramp would be in vain: the motor does not hold it.
            self.output.sequence.park(now_ns)
        if self.output.variant is Variant.UNKNOWN:
            self.engagement.begin_stop(Reason.VARIANT_UNKNOWN, now_ns)

    def _slips(self, now_ns: int) -> bool:
        """Return True if the robot stood by its motor, and began to roll once its parking brake read applied."""
        held_ns = self.output.motion.held_ticks * TICK_NS
        return held_ns > 0 and 0 <= held_ns - self.monitor.plausibility.rolling_ns(now_ns) <= SLIPS_NS

    def _stop_for_lapses(self, chassis: ChassisState, now_ns: int) -> None:
        """Stop where somebody ought to have done something in time, and has not."""
        engagement, setpoint = self.engagement, self.setpoint
        if engagement.needs_guard and not chassis.guarded:
            engagement.begin_stop(Reason.UNGUARDED, now_ns)
        # It stays lower until the robot is engaged again: limits are never raised while it is driven.
        setpoint.limits = self._lowered(setpoint.limits)
        if engagement.state is ArbiterState.ENGAGING and now_ns >= engagement.engage_until_ns:
            engagement.begin_stop(Reason.NOT_CONFIRMED, now_ns, "the mode does not read auto")
        silent_ns = now_ns - self.link.fresh_ns
        if engagement.state is ArbiterState.ENGAGED and silent_ns > self.link.age.deadman_ns:
            engagement.begin_stop(Reason.DEADMAN, now_ns, self.link.age.silence(silent_ns))
        elif engagement.state is ArbiterState.ENGAGED and engagement.standing.is_idle(now_ns):
            engagement.begin_stop(Reason.IDLE, now_ns, f"for {engagement.standing.idle_ns / 1e9:.0f} s")

    # What the chassis is told.

    def _act(self, chassis: ChassisState, now_ns: int, late_ns: int) -> Actuation | None:
        engagement, output, setpoint = self.engagement, self.output, self.setpoint
        # That it reads auto confirms nothing before the enables were sent.
        was_told = output.actuation is not None
        if engagement.state is ArbiterState.ENGAGING and was_told and chassis.mode is Mode.AUTO:
            self.link.fresh_ns = now_ns
            engagement.confirm(self.leases.held.operator if self.leases.held is not None else "", now_ns)
        if engagement.state is ArbiterState.STANDBY:
            return self.handover.part(chassis)
        if output.sequence is not None:
            return engagement.step_stop(output.sequence, now_ns, late_ns)
        is_engaged = engagement.state is ArbiterState.ENGAGED
        target = setpoint.target if is_engaged else Target(0.0, output.motion.angle_deg)
        is_held = is_engaged and self._warn(target, now_ns)
        actuation = output.step_motion(
            Target(0.0, target.angle_deg) if is_held else target, setpoint, self.link.age, self.monitor, now_ns
        )
        if is_held and target.speed_mps:
            output.motion.bounds.append(Bound.WARNING)
        return actuation

    def _warn(self, target: Target, now_ns: int) -> bool:
        """Warn people before the robot moves, where that is set. Returns whether it is held for that."""
        standing, setpoint = self.engagement.standing, self.setpoint
        standing.tick(
            now_ns,
            is_asked=target.speed_mps != 0,
            is_parked=setpoint.parked,
            moves=self.output.motion.speed_mps != 0,
        )
        until_ns = standing.warning_until_ns(now_ns)
        if until_ns is not None:
            self.auxiliary.blink(until_ns)
        return until_ns is not None

    def _answer_odometer(self, chassis: ChassisState, now_ns: int) -> None:
        cleared = self.auxiliary.clearing_result(chassis.total_mileage_km, now_ns)
        if cleared is not None:
            ruling = Ruling() if cleared else Ruling(Reason.NOT_CONFIRMED, "the mileage does not read zero")
            self.outbox.settle("clear_odometer", ruling)
