"""The evidence for each reason: one table, a row a reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from recorder.review.reasoning import frame_evidence, gateway_evidence, request_evidence
from recorder.review.reasoning.chain import Link, missing
from recorder.review.reasoning.window import EvidenceWindow
from schemas.reasons import Reason

Finder = Callable[[EvidenceWindow], list[Link]]
"""The window around the moment at which a reason arose to links."""


def _nothing(_window: EvidenceWindow) -> list[Link]:
    return []


def _gate(window: EvidenceWindow) -> list[Link]:
    said = [] if window.detail else [missing("which frame the gate refused, and why, is not in the log")]
    return said + gateway_evidence.unsent(window)


def _guard(window: EvidenceWindow) -> list[Link]:
    return gateway_evidence.pause(window) + frame_evidence.commanders(window, 500_000_000)


def _found_moving(window: EvidenceWindow) -> list[Link]:
    return gateway_evidence.stray(window) + frame_evidence.mode(window, 0)


def _not_confirmed(window: EvidenceWindow) -> list[Link]:
    mode = [link for value in (2, 1) for link in frame_evidence.mode(window, value) if link.time_ns]
    return request_evidence.not_confirmed(window) + mode


def _of_request(reason: Reason) -> Finder:
    return lambda window: request_evidence.refused(window, reason)


def _asked(*verbs: str) -> Finder:
    return lambda window: request_evidence.asked(window, *verbs)


EVIDENCE: Final[dict[Reason, Finder]] = {
    Reason.NONE: _nothing,
    **{
        reason: _of_request(reason)
        for reason in (
            Reason.MALFORMED,
            Reason.TOO_LARGE,
            Reason.UNKNOWN_VERB,
            Reason.BUSY,
            Reason.NO_LEASE,
            Reason.LEASE_HELD,
            Reason.ROLE_TOO_LOW,
            Reason.SEQUENCE,
            Reason.CHALLENGE_UNKNOWN,
            Reason.TOO_OLD,
            Reason.NOT_ENGAGED,
            Reason.ENGAGING,
            Reason.ALREADY_ENGAGED,
            Reason.STOPPING,
            Reason.MOVING,
            Reason.PARKED,
            Reason.GEAR_SHIFTING,
            Reason.COMMAND_NOT_ZERO,
            Reason.UNAUTHENTICATED,
            Reason.SELF_TEST,
            Reason.AUTHORITY_STALE,
            Reason.PROOF_MISSING,
            Reason.PROOF_WRONG,
            Reason.REPLAYED,
            Reason.GRANT_UNKNOWN,
            Reason.NOT_GRANTED,
            Reason.STOPPED_BY_OTHER,
            Reason.IDLE,
        )
    },
    # Their own words name the list or the time by which the grant ended.
    Reason.GRANT_EXPIRED: _nothing,
    Reason.GRANT_REVOKED: _nothing,
    Reason.LEASE_TAKEN: _asked("take"),
    Reason.LEASE_RELEASED: _asked("release"),
    Reason.LEASE_EXPIRED: request_evidence.lease_expired,
    Reason.DEADMAN: request_evidence.deadman,
    Reason.NOT_CONFIRMED: _not_confirmed,
    Reason.DISENGAGED: _asked("disengage"),
    Reason.BUS_DOWN: gateway_evidence.bus,
    Reason.BUS_OFF: gateway_evidence.controller,
    Reason.BUS_ERRORS: gateway_evidence.controller,
    Reason.FEEDBACK_MISSING: frame_evidence.silence,
    Reason.FEEDBACK_FAULTY: frame_evidence.faulty,
    Reason.FEEDBACK_LATE: gateway_evidence.load,
    Reason.VARIANT_UNKNOWN: frame_evidence.variant,
    Reason.HAND_TRANSMITTER: lambda window: frame_evidence.mode(window, 1),
    Reason.MODE_NOT_AUTO: lambda window: frame_evidence.mode(window, 2),
    Reason.FRONT_BUMPER: lambda window: frame_evidence.bumper(window, "FrontBumper", "front_bumper"),
    Reason.REAR_BUMPER: lambda window: frame_evidence.bumper(window, "RearBumper", "rear_bumper"),
    Reason.IMPLAUSIBLE_SPEED: frame_evidence.speeds,
    Reason.NOT_MOVING: frame_evidence.speeds,
    Reason.BRAKE_SLIPS: lambda window: frame_evidence.speeds(window, frame_evidence.ROLLING),
    Reason.ROLLING: lambda window: frame_evidence.speeds(window, frame_evidence.ROLLING),
    Reason.OVERSPEED: lambda window: frame_evidence.speeds(window, frame_evidence.OVERSPEED),
    Reason.STEERING: frame_evidence.steering,
    Reason.FEEDBACK_FROZEN: frame_evidence.mileage,
    Reason.FOUND_MOVING: _found_moving,
    Reason.OTHER_COMMANDER: frame_evidence.commanders,
    Reason.REMOTE_STOP: _asked("stop"),
    Reason.LOOP_LATE: gateway_evidence.lateness,
    Reason.SEND_FAILED: gateway_evidence.unsent,
    Reason.GATE: _gate,
    Reason.GUARD: _guard,
    Reason.UNGUARDED: gateway_evidence.guard_watch,
    Reason.NO_REALTIME: gateway_evidence.load,
    Reason.SHUTDOWN: gateway_evidence.ending,
    Reason.LINK_TOO_SLOW: _of_request(Reason.LINK_TOO_SLOW),
}
"""A test holds that none is missing."""


def evidence_of(reason: Reason) -> Finder:
    """The finder of the evidence for a reason; of a newer version's nothing is found."""
    return EVIDENCE.get(reason, _nothing)
