"""Causes to stop the robot: one table."""

from __future__ import annotations

from typing import Final

import msgspec

from schemas.reasons import Reason


class StopRule(msgspec.Struct, frozen=True):
    """The rule by which a cause stops the robot.

    Attributes:
        at_once: with the emergency deceleration; else with the normal one.
        latched: the robot cannot be engaged again before a reset.
        ramps: the commanded speed goes to zero by that deceleration. Where its scale is in doubt it is zero at
            once: a ramp in the wrong scale would ask for 40 times the speed.
        parks: the parking brake is applied at once, at whatever speed.
    """

    at_once: bool
    latched: bool = False
    ramps: bool = True
    parks: bool = False


STOPS: Final[dict[Reason, StopRule]] = {
    Reason.REMOTE_STOP: StopRule(at_once=True, latched=True),
    Reason.FRONT_BUMPER: StopRule(at_once=True, latched=True),
    Reason.REAR_BUMPER: StopRule(at_once=True, latched=True),
    Reason.ROLLING: StopRule(at_once=True, latched=True, parks=True),
    Reason.BRAKE_SLIPS: StopRule(at_once=True, latched=True),
    Reason.IMPLAUSIBLE_SPEED: StopRule(at_once=True, latched=True, ramps=False),
    Reason.OVERSPEED: StopRule(at_once=True, latched=True),
    Reason.STEERING: StopRule(at_once=True, latched=True),
    Reason.NOT_MOVING: StopRule(at_once=True, latched=True),
    Reason.FEEDBACK_FROZEN: StopRule(at_once=True, latched=True),
    Reason.GATE: StopRule(at_once=True, latched=True, parks=True),
    Reason.GUARD: StopRule(at_once=True, latched=True),
    Reason.MODE_NOT_AUTO: StopRule(at_once=True, parks=True),
    Reason.BUS_OFF: StopRule(at_once=True),
    Reason.FEEDBACK_MISSING: StopRule(at_once=True),
    Reason.FEEDBACK_FAULTY: StopRule(at_once=True),
    Reason.FEEDBACK_LATE: StopRule(at_once=True),
    Reason.VARIANT_UNKNOWN: StopRule(at_once=True, ramps=False),
    Reason.OTHER_COMMANDER: StopRule(at_once=True),
    Reason.LOOP_LATE: StopRule(at_once=True),
    Reason.SEND_FAILED: StopRule(at_once=True),
    Reason.UNGUARDED: StopRule(at_once=False),
    Reason.DEADMAN: StopRule(at_once=False),
    Reason.DISENGAGED: StopRule(at_once=False),
    Reason.IDLE: StopRule(at_once=False),
    Reason.LEASE_EXPIRED: StopRule(at_once=False),
    Reason.LEASE_RELEASED: StopRule(at_once=False),
    Reason.LEASE_TAKEN: StopRule(at_once=False),
    Reason.GRANT_EXPIRED: StopRule(at_once=False),
    Reason.GRANT_REVOKED: StopRule(at_once=False),
    Reason.NOT_CONFIRMED: StopRule(at_once=False),
    Reason.FOUND_MOVING: StopRule(at_once=False),
    Reason.SHUTDOWN: StopRule(at_once=False),
}
"""Every cause to stop, the gravest first."""

BUMPERS: Final = (Reason.FRONT_BUMPER, Reason.REAR_BUMPER)
