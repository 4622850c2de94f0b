"""The arbiter's messages: its state, decisions, events and replies."""

from __future__ import annotations

from typing import Final

from gateway.command.actuation import AT_REST
from gateway.command.arbiter import Arbiter
from gateway.command.causes import BUMPERS
from gateway.command.outcome import Event
from gateway.command.request import Judged, VerbAnswer
from schemas.decisions import (
    COMMANDING,
    ArbiterState,
    Bound,
    Decision,
    LeaseReply,
    Reply,
    SafetyEvent,
    SafetyState,
    Verdict,
)
from schemas.messages import SEQUENCE_MAX, GearPosition
from schemas.reasons import TEXTS, Reason
from schemas.requests import Role
from schemas.settings import SAFETY_STATE_ENGAGED_PERIOD_NS, SAFETY_STATE_PERIOD_NS
from schemas.subjects import BY_VERB

_NS_PER_S: Final = 1e9
_SHIFTING: Final = frozenset({Bound.GEAR, Bound.REVERSAL, Bound.PARKING})


class Reporter:
    """Makes the messages of one arbiter, each subject with a sequence of its own.

    Attributes:
        sequences: the next one of each message, by the class's name.
        state_due_ns: when the next state is due.
    """

    def __init__(self, arbiter: Arbiter) -> None:
        self._arbiter = arbiter
        self.sequences: dict[str, int] = {}
        self.state_due_ns = 0
        self._said: tuple[object, ...] = ()

    def restore(self, sequences: dict[str, int], state_due_ns: int, now_ns: int) -> None:
        """Continue after this many messages, the last one with the arbiter's present state."""
        self.sequences = dict(sequences)
        self.state_due_ns = state_due_ns
        self._said = self._says(self._blocked_by(now_ns))

    def state(self, now_ns: int, wall_ns: int, challenge: bytes) -> SafetyState | None:
        """The arbiter's state, if it is due or something has changed. Only then is the challenge published."""
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
            lease_expires_s=round((lease.expires_ns - now_ns) / _NS_PER_S, 3) if lease is not None else 0.0,
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
            deadman_s=link.deadman_ns / _NS_PER_S,
            accepted_seq=link.accepted_seq,
            stop_detail=arbiter.engagement.stop_detail,
            stopped_by=arbiter.latches.stopped_by,
            rest_confirmed=arbiter.monitor.is_rest_confirmed,
        )

    def decision(self, judged: Judged, bounds: list[Bound], frames_sent: int, wall_ns: int) -> Decision:
        """Return the decision on a request, once it is known what was sent in its tick."""
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
        """Return an event as a message."""
        return SafetyEvent(
            time_ns=wall_ns,
            sequence=self._next(SafetyEvent),
            tick=self._arbiter.tick_number,
            severity=event.severity,
            kind=event.kind,
            reason=event.reason,
            operator=event.operator,
            text=event.text,
        )

    def _says(self, blocked_by: list[Reason]) -> tuple[object, ...]:
        """Return what is published at once when it changes."""
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
        """Return the reasons for which the robot stands still, or cannot be engaged."""
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
    """The typed reply to a verb; an unknown verb gets the plainest one."""
    ruling = answer.ruling
    command = BY_VERB.get(answer.verb)
    kind = command.reply if command is not None else Reply
    accepted = ruling.reason is Reason.NONE
    text, cure = ruling.text, ruling.cure or TEXTS[ruling.reason].cure
    if kind is LeaseReply and accepted:
        return LeaseReply(
            accepted, ruling.reason, text, cure, lease=ruling.lease or 0, expires_s=ruling.expires_ns / _NS_PER_S
        )
    return kind(accepted, ruling.reason, text, cure)
