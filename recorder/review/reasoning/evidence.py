"""The evidence for each reason: one table, a row a reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import msgspec

from recorder.review.reasoning import frame_evidence, gateway_evidence, request_evidence
from recorder.review.reasoning.chain import Link, missing
from recorder.review.reasoning.signals import IDENTIFIERS
from recorder.review.reasoning.window import EvidenceWindow
from schemas.reasons import Reason


class Clue(msgspec.Struct, frozen=True):
    """The place to look for evidence.

    Attributes:
        window: around the moment at which the reason arose.
        detail: what the arbiter itself said of it; may be empty.
    """

    window: EvidenceWindow
    detail: str = ""

    @property
    def names(self) -> list[str]:
        """The feedback frames that the detail names."""
        return [name for name in IDENTIFIERS if name in self.detail]


Finder = Callable[[Clue], list[Link]]


def _nothing(_clue: Clue) -> list[Link]:
    return []


def _gate(clue: Clue) -> list[Link]:
    said = [] if clue.detail else [missing("which frame the gate refused, and why, is not in the log")]
    return said + gateway_evidence.unsent(clue.window)


def _guard(clue: Clue) -> list[Link]:
    return gateway_evidence.pause(clue.window) + frame_evidence.commanders(clue.window, 500_000_000)


def _found_moving(clue: Clue) -> list[Link]:
    return gateway_evidence.stray(clue.window) + frame_evidence.mode(clue.window, 0)


def _not_confirmed(clue: Clue) -> list[Link]:
    mode = [link for value in (2, 1) for link in frame_evidence.mode(clue.window, value) if link.time_ns]
    return request_evidence.not_confirmed(clue.window) + mode


def _faulty(clue: Clue) -> list[Link]:
    return frame_evidence.faulty(clue.window, clue.names)


def _of_request(reason: Reason) -> Finder:
    return lambda clue: request_evidence.refused(clue.window, reason)


def _asked(*verbs: str) -> Finder:
    return lambda clue: request_evidence.asked(clue.window, *verbs)


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
        )
    },
    Reason.LEASE_TAKEN: _asked("take"),
    Reason.LEASE_RELEASED: _asked("release"),
    Reason.LEASE_EXPIRED: lambda clue: request_evidence.lease_expired(clue.window),
    Reason.DEADMAN: lambda clue: request_evidence.deadman(clue.window, clue.detail),
    Reason.NOT_CONFIRMED: _not_confirmed,
    Reason.DISENGAGED: _asked("disengage"),
    Reason.BUS_DOWN: lambda clue: gateway_evidence.bus(clue.window),
    Reason.BUS_OFF: lambda clue: gateway_evidence.controller(clue.window),
    Reason.BUS_ERRORS: lambda clue: gateway_evidence.controller(clue.window),
    Reason.FEEDBACK_MISSING: lambda clue: frame_evidence.silence(clue.window, clue.names),
    Reason.FEEDBACK_FAULTY: _faulty,
    Reason.FEEDBACK_LATE: lambda clue: gateway_evidence.load(clue.window),
    Reason.VARIANT_UNKNOWN: lambda clue: frame_evidence.variant(clue.window),
    Reason.HAND_TRANSMITTER: lambda clue: frame_evidence.mode(clue.window, 1),
    Reason.MODE_NOT_AUTO: lambda clue: frame_evidence.mode(clue.window, 2),
    Reason.FRONT_BUMPER: lambda clue: frame_evidence.bumper(clue.window, "FrontBumper", "front_bumper"),
    Reason.REAR_BUMPER: lambda clue: frame_evidence.bumper(clue.window, "RearBumper", "rear_bumper"),
    Reason.IMPLAUSIBLE_SPEED: lambda clue: frame_evidence.speeds(clue.window),
    Reason.ROLLING: lambda clue: frame_evidence.speeds(clue.window, frame_evidence.ROLLING),
    Reason.OVERSPEED: lambda clue: frame_evidence.speeds(clue.window, frame_evidence.OVERSPEED),
    Reason.STEERING: lambda clue: frame_evidence.steering(clue.window),
    Reason.FEEDBACK_FROZEN: lambda clue: frame_evidence.mileage(clue.window),
    Reason.FOUND_MOVING: _found_moving,
    Reason.OTHER_COMMANDER: lambda clue: frame_evidence.commanders(clue.window),
    Reason.REMOTE_STOP: _asked("stop"),
    Reason.LOOP_LATE: lambda clue: gateway_evidence.lateness(clue.window),
    Reason.SEND_FAILED: lambda clue: gateway_evidence.unsent(clue.window),
    Reason.GATE: _gate,
    Reason.GUARD: _guard,
    Reason.UNGUARDED: lambda clue: gateway_evidence.guard_watch(clue.window),
    Reason.NO_REALTIME: lambda clue: gateway_evidence.load(clue.window),
    Reason.SHUTDOWN: lambda clue: gateway_evidence.ending(clue.window),
    Reason.LINK_TOO_SLOW: _of_request(Reason.LINK_TOO_SLOW),
}
"""A test holds that none is missing."""
