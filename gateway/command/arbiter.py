"""The safety arbiter: requests and the chassis's state in, commands to the chassis out. Pure.

Read ``Arbiter.tick`` first. ``Reporter`` makes the samples. The states are in ``lease``, ``monitor``, ``motion``,
``output`` and ``rulings``; ``engagement`` holds those of a robot under command.
"""

from __future__ import annotations

from random import Random
from typing import Final

import msgspec

from gateway.chassis.port import AT_REST, Actuation, Chassis, ChassisState
from gateway.command.engagement import Engagement
from gateway.command.lease import Leases, OperatorLink
from gateway.command.motion import MotionLimits, Target
from gateway.command.rulings import BUMPERS, Event, Judged, Notices, RawRequest, Ruling, TickOutcome, VerbAnswer
from gateway.command.verbs import Verbs
from schemas.decisions import (
    COMMANDING,
    ArbiterState,
    Bound,
    Decision,
    EventKind,
    LeaseReply,
    Reply,
    SafetyEvent,
    SafetyState,
    Severity,
    Verdict,
)
from schemas.messages import SEQUENCE_MAX, GearPosition, Mode, Variant
from schemas.reasons import TEXTS, Reason
from schemas.requests import Role
from schemas.settings import SAFETY_STATE_ENGAGED_PERIOD_NS, SAFETY_STATE_PERIOD_NS, SLIPS_NS, TICK_NS, Settings
from schemas.subjects import BY_VERB

_NS_PER_S: Final = 1_000_000_000
_TICK_BITS: Final = 40


class Arbiter:
    """Everything that decides whether and how the robot moves.

    Attributes:
        tick_number: rises with each tick, from a random start in each run.
        engagement: the robot under command. Its parts are attributes of the arbiter too.
    """

    def __init__(self, chassis: Chassis, settings: Settings, run: int) -> None:
        """Begin in standby. The run is a random number, public, that makes its leases and ticks unique."""
        command = settings.command
        random = Random(run)  # noqa: S311 - tells runs apart; it keeps no secret
        self.tick_number = random.getrandbits(_TICK_BITS)
        self.leases = Leases(round(command.lease_s * _NS_PER_S), random)
        self.link = OperatorLink(command)
        self.engagement = Engagement(chassis, command, needs_guard=not settings.gateway.accept_unguarded)
        self.monitor = self.engagement.monitor
        self.setpoint = self.engagement.setpoint
        self.output = self.engagement.output
        self.auxiliary = self.engagement.auxiliary
        self.handover = self.engagement.handover
        self.latches = self.engagement.latches
        self.outbox = self.engagement.outbox
        self._verbs = Verbs(chassis, settings, self.leases, self.link, self.engagement)
        self._notices = Notices()
        self._speed_limit_without_realtime_mps = command.speed_limit_without_realtime_mps
        self._guard_stops: int | None = None

    @property
    def state(self) -> ArbiterState:
        return self.engagement.state

    def tick(self, chassis: ChassisState, requests: list[RawRequest], now_ns: int, late_ns: int) -> TickOutcome:
        """Decide the command to the chassis for the next 10 ms. Stops come first among the requests."""
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
        """End the lease, because its holder's grant is no longer valid, and stop the robot."""
        lease = self.leases.held
        if lease is None:
            return
        self.leases.end(reason)
        text = f"{lease.operator} lost the lease: {TEXTS[reason].means}; {detail}"
        self.outbox.add_event(Severity.WARNING, EventKind.LEASE, reason, text, lease.operator)
        if self.state in COMMANDING:
            self.engagement.begin_stop(reason, now_ns, detail, lease.operator)

    def note_left(self) -> None:
        """Note that the bus took the whole burst: a chassis that was handed over would execute this one again."""
        if self.handover.left is not None and self.output.actuation is not None:
            self.handover.left = self.output.actuation

    # Requests.

    def _rule(self, request: RawRequest, now_ns: int) -> Ruling:
        ruling = self._verbs.rule(request, now_ns)
        self.outbox.answer(request, ruling)
        return ruling

    # Causes to stop.

    def _expire_lease(self, now_ns: int) -> None:
        lost = self.leases.expire(now_ns)
        if lost is None:
            return
        text = f"the lease of {lost.operator} expired"
        self.outbox.add_event(Severity.WARNING, EventKind.LEASE, Reason.LEASE_EXPIRED, text, lost.operator)
        if self.state in COMMANDING:
            self.engagement.begin_stop(Reason.LEASE_EXPIRED, now_ns, operator=lost.operator)

    def _give_way(self, chassis: ChassisState, now_ns: int) -> None:
        """End the output at once if another party commands the chassis, or no command can reach it."""
        before, self._guard_stops = self._guard_stops, chassis.guard_stops
        if self.engagement.state is ArbiterState.STANDBY:
            has_acted = before is not None and chassis.guard_stops > before
            if chassis.guard_sends or has_acted:
                self.engagement.latch(Reason.GUARD, chassis.guard_says, now_ns)
            return
        reason = self.handover.reason_to_yield(chassis)
        if reason is Reason.MODE_NOT_AUTO and (chassis.moves or self.state is ArbiterState.STOPPING):
            # It has no commander and may coast, so the parking brake is commanded anyway.
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
        """Stop a chassis that executes an old command. Only in standby."""
        engagement = self.engagement
        if self.handover.is_given_back(chassis) and self.latches.details:
            # The remote control may have released the parking brake that the latched stop applied.
            engagement.owes_stop = True
        is_taken = self.monitor.is_commanded_by_other(now_ns)
        if is_taken or chassis.mode is Mode.REMOTE:
            engagement.forget_rest()
        if self.handover.is_obeyed_again(chassis, now_ns, is_taken=is_taken):
            # It may execute the command that it was left with again: motion never resumes automatically.
            engagement.begin_stop(Reason.FOUND_MOVING, now_ns, "it may execute an earlier command")
        elif (
            engagement.owes_stop
            and not is_taken
            and engagement.is_loose
            and not self.handover.is_blind(chassis, now_ns)
        ):
            engagement.begin_stop(Reason.FOUND_MOVING, now_ns, "an earlier stop could not be carried out")
        elif self.monitor.found_moving(now_ns):
            engagement.begin_stop(Reason.FOUND_MOVING, now_ns)

    @property
    def limits_of_next_engage(self) -> MotionLimits:
        """The limits that an engagement would have now."""
        return self._lowered(self.setpoint.configured_limits)

    def _lowered(self, limits: MotionLimits) -> MotionLimits:
        chassis = self.monitor.chassis
        is_whole = chassis.guarded and chassis.realtime
        return limits if is_whole else limits.lowered(self._speed_limit_without_realtime_mps)

    def _stop_for_faults(self, now_ns: int, late_ns: int) -> None:
        # During a stop too: a more severe cause speeds it up, and may latch.
        is_engaged = self.state is ArbiterState.ENGAGED
        limit_mps = self.setpoint.limits.speed_mps
        for reason in self.monitor.faults(self.output.told, limit_mps, late_ns, now_ns, is_engaged=is_engaged):
            if reason is Reason.ROLLING and is_engaged and self._slips(now_ns):
                self.engagement.release_brake(now_ns, self.monitor.fault_detail(reason, late_ns))
            else:
                self.engagement.begin_stop(reason, now_ns, self.monitor.fault_detail(reason, late_ns))
        if self.monitor.plausibility.runs_away and self.output.sequence is not None:
            # A ramp is useless: the motor does not hold the robot.
            self.output.sequence.park(now_ns)
        if self.output.variant is Variant.UNKNOWN:
            self.engagement.begin_stop(Reason.VARIANT_UNKNOWN, now_ns)

    def _slips(self, now_ns: int) -> bool:
        """Return True if the motor held the robot, and it began to roll once its parking brake read applied."""
        held_ns = self.output.motion.held_ticks * TICK_NS
        return held_ns > 0 and 0 <= held_ns - self.monitor.plausibility.rolling_ns(now_ns) <= SLIPS_NS

    def _stop_for_lapses(self, chassis: ChassisState, now_ns: int) -> None:
        """Stop because something expected did not happen in time."""
        engagement, setpoint = self.engagement, self.setpoint
        if engagement.needs_guard and not chassis.guarded:
            engagement.begin_stop(Reason.UNGUARDED, now_ns)
        # The limit stays low until the next engagement: it never rises while the robot is driven.
        setpoint.limits = self._lowered(setpoint.limits)
        if engagement.state is ArbiterState.ENGAGING and now_ns >= engagement.engage_until_ns:
            engagement.begin_stop(Reason.NOT_CONFIRMED, now_ns, "the chassis did not switch to mode auto")
        silent_ns = now_ns - self.link.fresh_ns
        if engagement.state is ArbiterState.ENGAGED and silent_ns > self.link.age.deadman_ns:
            engagement.begin_stop(Reason.DEADMAN, now_ns, self.link.age.silence(silent_ns))
        elif engagement.state is ArbiterState.ENGAGED and engagement.standing.is_idle(now_ns):
            engagement.begin_stop(Reason.IDLE, now_ns, f"for {engagement.standing.idle_ns / 1e9:.0f} s")

    # The command to the chassis.

    def _act(self, chassis: ChassisState, now_ns: int, late_ns: int) -> Actuation | None:
        engagement, output, setpoint = self.engagement, self.output, self.setpoint
        # Mode auto confirms nothing before the enables were sent.
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
        """Warn people before the robot moves, if configured. Returns True while the robot must wait for that."""
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


_SECOND_NS: Final = 1e9
_SHIFTING: Final = frozenset({Bound.GEAR, Bound.REVERSAL, Bound.PARKING})


class Reporter:
    """Makes the messages of one arbiter. ``sequences``: the next one by class name."""

    def __init__(self, arbiter: Arbiter) -> None:
        self._arbiter = arbiter
        self.sequences: dict[str, int] = {}
        self.state_due_ns = 0
        self._said: tuple[object, ...] = ()

    def restore(self, sequences: dict[str, int], state_due_ns: int, now_ns: int) -> None:
        """Continue after this many messages; the last one held the present state."""
        self.sequences = dict(sequences)
        self.state_due_ns = state_due_ns
        self._said = self._says(self._blocked_by(now_ns))

    def state(self, now_ns: int, wall_ns: int, challenge: bytes) -> SafetyState | None:
        """Return the state if it is due or has changed. Only then is the challenge published."""
        arbiter = self._arbiter
        blocked_by = self._blocked_by(now_ns)
        lease = arbiter.leases.held
        says = self._says(blocked_by)
        if now_ns < self.state_due_ns and says == self._said:
            return None
        self._said = says
        engaged = arbiter.state is ArbiterState.ENGAGED
        self.state_due_ns = now_ns + (SAFETY_STATE_ENGAGED_PERIOD_NS if engaged else SAFETY_STATE_PERIOD_NS)
        arbiter.link.challenges.publish(challenge, now_ns)
        limits = arbiter.setpoint.limits if arbiter.state in COMMANDING else arbiter.limits_of_next_engage
        told = arbiter.output.actuation
        output = told or AT_REST
        # Without a holder there is no link; what is left of the last one's would not be at rest.
        link = arbiter.link.age if lease is not None else arbiter.link.unused_age()
        ages, delay_s, travel_limit_mps = link.ages(now_ns), link.delay_s(now_ns), link.speed_limit_mps(now_ns)
        return SafetyState(
            time_ns=wall_ns,
            sequence=self._next(SafetyState),
            tick=arbiter.tick_number,
            state=arbiter.state,
            engaged=engaged,
            stop_reason=arbiter.engagement.stop_reason,
            stop_phase=arbiter.output.stop_phase,
            lease_holder=lease.operator if lease is not None else "",
            lease_role=lease.role if lease is not None else Role.PROGRAM,
            lease_expires_s=round((lease.expires_ns - now_ns) / _SECOND_NS, 3) if lease is not None else 0.0,
            latched=list(arbiter.latches.details),
            blocked_by=blocked_by,
            guarded=arbiter.monitor.chassis.guarded,
            speed_limit_mps=limits.speed_mps,
            acceleration_limit_mps2=limits.acceleration_mps2,
            deceleration_limit_mps2=limits.deceleration_mps2,
            emergency_deceleration_mps2=limits.emergency_deceleration_mps2,
            steering_limit_deg=limits.steering_deg,
            steering_rate_limit_degps=limits.steering_rate_degps,
            lateral_acceleration_limit_mps2=limits.lateral_acceleration_mps2,
            target_speed_mps=arbiter.setpoint.target.speed_mps,
            target_angle_deg=arbiter.setpoint.target.angle_deg,
            output_speed_mps=output.signed_speed_mps,
            output_angle_deg=output.angle_deg,
            output_gear=told.gear if told is not None else GearPosition.UNDEFINED,
            brake_pedal_percent=0.0,
            parking=output.parking,
            challenge=challenge,
            link_age_s=ages.age_s,
            link_age_last_s=ages.last_s,
            link_age_p50_s=ages.p50_s,
            link_age_p99_s=ages.p99_s,
            travel_delay_m=round(output.speed_mps * (delay_s or 0.0), 3) if engaged else 0.0,
            travel_speed_limit_mps=None if travel_limit_mps is None else round(travel_limit_mps, 3),
            deadman_s=link.deadman_ns / _SECOND_NS,
            accepted_seq=link.accepted_seq,
            stop_detail=arbiter.engagement.stop_detail,
            stopped_by=arbiter.latches.stopped_by,
            rest_confirmed=arbiter.monitor.is_rest_confirmed,
        )

    def decision(self, judged: Judged, bounds: list[Bound], frames_sent: int, wall_ns: int) -> Decision:
        """Return the decision on a request, after the tick's frames were sent."""
        ruling = judged.ruling
        output = self._arbiter.output.actuation or AT_REST
        accepted = ruling.reason is Reason.NONE
        asked = ruling.asked
        return Decision(
            time_ns=wall_ns,
            sequence=self._next(Decision),
            tick=self._arbiter.tick_number,
            request=judged.request.verb[:32],
            operator=judged.request.operator,
            lease=ruling.lease,
            request_sequence=ruling.sequence,
            age_ms=None if ruling.age_ns is None else ruling.age_ns / 1e6,
            verdict=Verdict.ACCEPTED if accepted else Verdict.REFUSED,
            reason=ruling.reason,
            detail=ruling.text,
            bound_by=bounds if accepted and asked is not None else [],
            requested_speed_mps=asked.speed_mps if asked is not None else None,
            requested_angle_deg=asked.angle_deg if asked is not None else None,
            output_speed_mps=output.signed_speed_mps,
            output_angle_deg=output.angle_deg,
            frames_sent=frames_sent,
        )

    def event(self, event: Event, wall_ns: int) -> SafetyEvent:
        return SafetyEvent(
            time_ns=wall_ns,
            sequence=self._next(SafetyEvent),
            tick=self._arbiter.tick_number,
            **msgspec.structs.asdict(event),
        )

    def _says(self, blocked_by: list[Reason]) -> tuple[object, ...]:
        """Return the values whose change is published at once."""
        arbiter = self._arbiter
        lease = arbiter.leases.held
        return (
            arbiter.state,
            arbiter.output.stop_phase,
            arbiter.engagement.stop_reason,
            lease.id if lease is not None else None,
            tuple(arbiter.latches.details.items()),
            tuple(blocked_by),
            arbiter.output.actuation is None or arbiter.output.actuation.parking,
        )

    def _blocked_by(self, now_ns: int) -> list[Reason]:
        """Return why the robot stands still or cannot be engaged."""
        arbiter = self._arbiter
        match arbiter.state:
            case ArbiterState.STANDBY:
                first = [Reason.NO_LEASE] if arbiter.leases.held is None else []
                return [*first, *arbiter.engagement.blockers(now_ns), Reason.NOT_ENGAGED]
            case ArbiterState.STOPPING:
                return [
                    *dict.fromkeys([*arbiter.latches.details, arbiter.engagement.stop_reason, Reason.STOPPING])
                ]
            case ArbiterState.ENGAGING:
                return [Reason.ENGAGING]
            case _:
                pressed = [bumper for bumper in BUMPERS if bumper in arbiter.monitor.pressed]
                parked = [Reason.PARKED] if arbiter.setpoint.parked else []
                shifting = not arbiter.setpoint.parked and not _SHIFTING.isdisjoint(arbiter.output.motion.bounds)
                return [*pressed, *parked, *([Reason.GEAR_SHIFTING] if shifting else [])]

    def _next(self, kind: type) -> int:
        sequence = self.sequences.get(kind.__name__, 0)
        self.sequences[kind.__name__] = (sequence + 1) & SEQUENCE_MAX
        return sequence


def reply(answer: VerbAnswer) -> Reply:
    """Return the typed reply to a verb; a plain ``Reply`` for an unknown one."""
    ruling = answer.ruling
    command = BY_VERB.get(answer.verb)
    kind = command.reply if command is not None else Reply
    accepted = ruling.reason is Reason.NONE
    text, cure = ruling.text, ruling.cure or TEXTS[ruling.reason].cure
    if kind is LeaseReply and accepted:
        return LeaseReply(
            accepted, ruling.reason, text, cure, lease=ruling.lease or 0, expires_s=ruling.expires_ns / _SECOND_NS
        )
    return kind(accepted, ruling.reason, text, cure)
