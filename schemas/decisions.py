"""Messages of the arbiter: replies, decisions, its state, events, and the journal of all of its input."""

from __future__ import annotations

from enum import Enum
from typing import Annotated, ClassVar, Final

import msgspec
from msgspec import Meta

from schemas.messages import (
    AngleDeg,
    Count,
    DistanceM,
    DurationMs,
    DurationS,
    GearPosition,
    Message,
    SpeedMps,
    unit_keyword,
)
from schemas.reasons import Reason
from schemas.requests import Challenge, LeaseNumber, PublicKey, Role, Tick

AccelerationMps2 = Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("m/s2"))]
AngleRateDegps = Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("deg/s"))]
PedalPercent = Annotated[float, Meta(ge=0, le=100, extra_json_schema=unit_keyword("%"))]


class Reply(msgspec.Struct, frozen=True):
    """The reply to a verb. A refusal is a reply like any other.

    Attributes:
        ok: the request was executed, or is under way.
        reason: why not; ``none`` when ok.
        detail: the reason in words, with figures.
        cure: the way to make it succeed.
    """

    version: ClassVar[int] = 1

    ok: bool
    reason: Reason
    detail: str
    cure: str


class LeaseReply(Reply, frozen=True):
    """The reply to acquire, take and renew.

    Attributes:
        lease: every further request carries it; 0 when refused.
        expires_s: the lease expires after this time unless it is renewed.
        public_key: the robot's for this lease, X25519; in signed mode alone.
    """

    lease: LeaseNumber = 0
    expires_s: DurationS = 0.0
    public_key: PublicKey | None = None


class StatementReply(Reply, frozen=True):
    """The reply to a statement of the authority that was shown to the robot.

    Attributes:
        own: the chain of the robot's own grant, which has its public key.
    """

    own: str = ""


class Verdict(Enum):
    """The result of a request."""

    ACCEPTED = "accepted"
    REFUSED = "refused"


class Bound(Enum):
    """A limit that changed a drive command."""

    SPEED = "speed"
    ACCELERATION = "acceleration"
    DECELERATION = "deceleration"
    STEERING = "steering"
    STEERING_RATE = "steering_rate"
    LATERAL_ACCELERATION = "lateral_acceleration"
    REVERSAL = "reversal"
    BUMPER = "bumper"
    GEAR = "gear"
    PARKING = "parking"
    TRAVEL_DELAY = "travel_delay"
    WARNING = "warning"
    FOLLOWING = "following"


class ArbiterState(Enum):
    """The state of the arbiter. ``standby``: it sends nothing, and another computer may own the bus."""

    STANDBY = "standby"
    ENGAGING = "engaging"
    ENGAGED = "engaged"
    STOPPING = "stopping"


COMMANDING: Final = frozenset({ArbiterState.ENGAGING, ArbiterState.ENGAGED})
"""The chassis is commanded, or about to be."""


class StopPhase(Enum):
    """The phase of a stop: ramp, brake, park, hold, disable. ``idle``: no stop is under way.

    ``motor``: the parking brake does not hold the robot, so it is released, and the motor holds it in gear.
    ``neutral`` occurs in older logs only. Append new phases at the end: a log stores a phase by its place.
    """

    IDLE = "idle"
    RAMP = "ramp"
    BRAKE = "brake"
    NEUTRAL = "neutral"
    HOLD = "hold"
    DISABLE = "disable"
    PARK = "park"
    MOTOR = "motor"


class Severity(Enum):
    """The importance of an event to a person."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


RUN_TICKS: Final = 10**9
"""A run's ticks begin at a random number of 40 bits: a step of this much, a hundred days, is another run."""


def is_same_run(tick: int, other: int) -> bool:
    """Two ticks of a robot's arbiter are of one run of its gateway."""
    return abs(tick - other) < RUN_TICKS


class EventKind(Enum):
    """The kind of an event. ``gateway``: it shuts down as requested; without this event it crashed."""

    LEASE = "lease"
    ENGAGED = "engaged"
    STOP = "stop"
    STOPPED = "stopped"
    LATCH = "latch"
    RESET = "reset"
    TAKEOVER = "takeover"
    FAULT = "fault"
    GUARD = "guard"
    GATEWAY = "gateway"


GUARD_STOP_ENDED: Final = "the guard's stop has ended: "
"""Prefix of the text of a ``guard`` event that reports the end of the guard's stop."""


class SafetyState(Message, frozen=True):
    """The arbiter, at 20 Hz, at 50 Hz while the robot is engaged, and whenever something changes.

    Attributes:
        tick: the arbiter's tick, which distinguishes states.
        engaged: drive commands are executed.
        stop_reason: why the stop that is under way, or the last one, was begun.
        stop_phase: the phase of the stop.
        lease_holder: the operator who holds the lease; empty if it is free.
        lease_role: the role of the holder; program if the lease is free.
        lease_expires_s: the lease expires after this time; 0 if it is free.
        latched: causes that must be reset before the robot can be engaged.
        blocked_by: why the robot stands still, or cannot be engaged, now.
        guarded: a second process watches this one, and stops the robot in its place.
        speed_limit_mps: the limits in force.
        target_speed_mps: the speed of the last valid drive command.
        output_speed_mps: the speed commanded to the chassis; forward is positive.
        output_gear: undefined while nothing is sent.
        brake_pedal_percent: 0, for the pedal is never pressed; other values occur in older logs only.
        parking: the parking brake is commanded.
        challenge: echo the newest one in each drive command; it bounds the age of the command.
        link_age_s: the age of the holder's drive commands by which the speed is bounded: the greater of the mean
            of the last second and the largest of the last 300 ms, and the setting ``command.view_delay_s``.
        link_age_last_s: the age of the last accepted one.
        link_age_p50_s: the median of the last ten seconds.
        link_age_p99_s: the 99th percentile of the last ten seconds.
        travel_delay_m: the distance that an engaged robot drives, at the commanded speed, before it can react to
            its operator: over the age and the deadman.
        travel_speed_limit_mps: the speed limit that the setting ``command.travel_delay_m`` gives for them.
        deadman_s: without a valid drive command for this long, an engaged robot is stopped.
        accepted_seq: the ``seq`` of the last drive command that the holder of the lease had accepted.
        stop_detail: the figures of the stop that is under way, or of the last one.
        stopped_by: whose remote stops are latched, the newest first; after four of them "others". A reset by
            anybody else names the first one.
        rest_confirmed: feedback has answered since a speed was last commanded. While it is false, a robot whose
            speed reads zero may be moving.
    """

    version: ClassVar[int] = 2

    tick: Tick
    state: ArbiterState
    engaged: bool
    stop_reason: Reason
    stop_phase: StopPhase
    lease_holder: str
    lease_role: Role
    lease_expires_s: DurationS
    latched: list[Reason]
    blocked_by: list[Reason]
    guarded: bool
    speed_limit_mps: SpeedMps
    acceleration_limit_mps2: AccelerationMps2
    deceleration_limit_mps2: AccelerationMps2
    emergency_deceleration_mps2: AccelerationMps2
    steering_limit_deg: AngleDeg
    steering_rate_limit_degps: AngleRateDegps
    lateral_acceleration_limit_mps2: AccelerationMps2
    target_speed_mps: SpeedMps
    target_angle_deg: AngleDeg
    output_speed_mps: SpeedMps
    output_angle_deg: AngleDeg
    output_gear: GearPosition
    brake_pedal_percent: PedalPercent
    parking: bool
    challenge: Challenge
    link_age_s: DurationS | None
    link_age_last_s: DurationS | None
    link_age_p50_s: DurationS | None
    link_age_p99_s: DurationS | None
    travel_delay_m: DistanceM
    travel_speed_limit_mps: SpeedMps | None
    deadman_s: DurationS
    accepted_seq: Count | None
    stop_detail: str
    stopped_by: list[str] = msgspec.field(default_factory=list)
    rest_confirmed: bool = True


class Decision(Message, frozen=True):
    """The arbiter's decision on one request.

    Attributes:
        tick: the arbiter's tick in which it was judged.
        request: the verb.
        lease: public identifier of the request's lease: the number that requests carry is a secret.
            0 if it names none that was given; null if it needs none.
        request_sequence: a drive command's ``seq``; null for every other request.
        age_ms: the greatest possible age, by the echoed challenge; null if that is not known, or not needed.
        bound_by: the limits that changed the requested motion.
        requested_speed_mps: a drive command's; null for every other request.
        requested_angle_deg: the same, as a steering angle.
        output_speed_mps: the speed commanded to the chassis in this tick.
        output_angle_deg: the same.
        frames_sent: CAN frames that went out in this tick.
    """

    tick: Tick
    request: str
    operator: str
    lease: LeaseNumber | None
    request_sequence: Count | None
    age_ms: DurationMs | None
    verdict: Verdict
    reason: Reason
    detail: str
    bound_by: list[Bound]
    requested_speed_mps: SpeedMps | None
    requested_angle_deg: AngleDeg | None
    output_speed_mps: SpeedMps
    output_angle_deg: AngleDeg
    frames_sent: Count


class SafetyEvent(Message, frozen=True):
    """An event that a person should know about.

    Attributes:
        text: the event in a sentence.
        operator: the operator behind it; empty if there is none.
    """

    tick: Tick
    severity: Severity
    kind: EventKind
    reason: Reason
    operator: str
    text: str


class Journal(Message, frozen=True):
    """All that the core was given, in its order: enough to run it again with the same outcome.

    Attributes:
        run: a random number of this run of the gateway; with it, the identifiers of leases come out the same.
        first: the place of the first input in the order, from 0; a gap between two messages is a loss.
        count: number of inputs.
        inputs: a MessagePack array of arrays: the kind, the monotonic time in nanoseconds, and the arguments.
        rules: the number of the command rules by which it was decided; 0 in logs from before they had one.
    """

    version: ClassVar[int] = 2

    run: Count
    first: Count
    count: Count
    inputs: bytes
    rules: Count = 0


class SignedStatement(Message, frozen=True):
    """A statement of the authority, with its chain and signatures, that the robot has taken over.

    Attributes:
        text: as it was received: see docs/authority.md.
    """

    text: str
