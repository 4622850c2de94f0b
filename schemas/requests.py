"""Requests of clients to a robot: one type for each verb, untrusted until the arbiter has judged it.

A request is a MessagePack map like every message. Unlike in a message, an unknown field is an error: refusing a
command is safer than executing part of it.
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, ClassVar, Final

import msgspec
from msgspec import Meta

from schemas.messages import AngleDeg, SpeedMps, YawRateRadps, unit_keyword

LEASE_MAX: Final = 2**53 - 1  # the largest whole number that is exact in every language

CHALLENGE_BYTES: Final = 8

LeaseNumber = Annotated[int, Meta(ge=0, le=LEASE_MAX, description="The number from the reply to acquire or take.")]
Tick = Annotated[int, Meta(ge=0, le=LEASE_MAX)]
Challenge = Annotated[
    bytes,
    Meta(
        min_length=CHALLENGE_BYTES,
        max_length=CHALLENGE_BYTES,
        description=f"{CHALLENGE_BYTES} random bytes, new in each safety/state.",
    ),
]
PublicKey = Annotated[
    bytes, Meta(min_length=32, max_length=32, description="X25519, drawn for this lease: see docs/authority.md.")
]
DeadmanS = Annotated[float, Meta(ge=0.05, le=1.0, extra_json_schema=unit_keyword("s"))]
CurvatureInverseM = Annotated[
    float, Meta(description="One over the radius; left is positive.", extra_json_schema=unit_keyword("1/m"))
]


class Role(Enum):
    """The rank of a lease's holder, from program to supervisor. An equal or higher one may take the lease."""

    PROGRAM = "program"
    OPERATOR = "operator"
    SUPERVISOR = "supervisor"

    @property
    def rank(self) -> int:
        """Higher outranks lower."""
        return list(Role).index(self)


class Request(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The base of all requests. Fields with their default are left out, so that older robots accept them."""

    version: ClassVar[int] = 1


class Acquire(Request, frozen=True, forbid_unknown_fields=True):
    """Request the lease of a robot while it is free.

    Attributes:
        role: the sender's; ignored in signed mode, where the grant has the role.
        public_key: the sender's for this lease; only in signed mode.
    """

    role: Role = Role.OPERATOR
    public_key: PublicKey | None = None


class Take(Request, frozen=True, forbid_unknown_fields=True):
    """Take the lease from a holder of no higher role, while the robot stands; the former holder is notified.

    Attributes:
        role, public_key: see ``Acquire``.
        override: take it while the robot moves; the robot is stopped first.
    """

    role: Role = Role.OPERATOR
    override: bool = False
    public_key: PublicKey | None = None


class Leased(Request, frozen=True, forbid_unknown_fields=True):
    """A request that only the holder of the lease may make."""

    lease: LeaseNumber


class Renew(Leased, frozen=True, forbid_unknown_fields=True):
    """Extend the lease, as every valid drive command does."""


class Release(Leased, frozen=True, forbid_unknown_fields=True):
    """Give the lease back. An engaged robot is stopped."""


class Engage(Leased, frozen=True, forbid_unknown_fields=True):
    """Take command of the standing chassis. The reply comes when the chassis reads auto, or after a failure.

    Attributes:
        challenge: the newest one of ``safety/state`` that the sender received; if it is too old on arrival, the
            link is too slow to drive.
        speed_limit_mps: a lower speed limit than the configured one, until the robot is disengaged.
        deadman_s: a longer deadman than the configured one, until the robot is disengaged; a shorter one has no
            effect. It is for links that stall, and lowers the speed limit.
    """

    version: ClassVar[int] = 2

    challenge: Challenge
    speed_limit_mps: SpeedMps | None = None
    deadman_s: DeadmanS | None = None


class Disengage(Leased, frozen=True, forbid_unknown_fields=True):
    """Stop in a controlled way, and give up command of the chassis. No reset is needed."""


class Reset(Leased, frozen=True, forbid_unknown_fields=True):
    """Clear latched stops once their causes are gone and the robot stands.

    Attributes:
        challenge: the newest one of ``safety/state`` that the sender received. With it, a reset never clears a
            later stop and is refused if it comes late; without it, only stops latched a moment ago are not
            cleared.
        of: the client whose remote stop is cleared, if it is not the sender's own: the first other name of
            ``stopped_by`` in ``safety/state``.
    """

    version: ClassVar[int] = 2

    challenge: Challenge | None = None
    of: Annotated[str, Meta(max_length=96)] = ""


class Park(Leased, frozen=True, forbid_unknown_fields=True):
    """Apply the parking brake, at any speed, while the commanded speed is zero."""


class Unpark(Leased, frozen=True, forbid_unknown_fields=True):
    """Allow drive commands to release the parking brake, while the commanded speed is zero."""


class Light(Leased, frozen=True, forbid_unknown_fields=True):
    """Set headlamp and indicators. All false switches them off.

    Every stop switches them off, also a deadman's. A latched stop, also a guard's, switches both indicators on
    instead: hazard lights until the next engage. If the remote control takes over, or the bus is lost, no more
    frames are sent: the lamps stay as they are until the robot is engaged again or stopped.
    """

    headlamp: bool = False
    left: bool = False
    right: bool = False


class Horn(Leased, frozen=True, forbid_unknown_fields=True):
    """Switch the horn on or off.

    Every stop switches it off, also a deadman's and a guard's. If the remote control takes over, or the bus is
    lost, no more frames are sent: it stays on until the robot is engaged again or stopped.
    """

    on: bool


class ClearOdometer(Leased, frozen=True, forbid_unknown_fields=True):
    """Set the total mileage to zero. The reply comes when the mileage reads zero, or after a failure."""


class ResetOdometry(Leased, frozen=True, forbid_unknown_fields=True):
    """Set pose, distance and variances of ``chassis/odometry`` to zero, at rest or in motion.

    The chassis's mileage does not change: see ``clear_odometer``.
    """


class Stop(Request, frozen=True, forbid_unknown_fields=True):
    """The remote stop, for every client. Its payload is ignored.

    It is not an emergency stop: that is the button on the robot.
    """


class Drive(Leased, frozen=True, forbid_unknown_fields=True):
    """One command of the stream that moves the robot, with exactly one of angle, curvature and yaw rate.

    Attributes:
        seq: rises by 1 to 1,000 with each accepted command of a lease, beginning with 0 or 1.
        challenge: the newest one of ``safety/state`` that the sender received; it bounds the command's age.
        speed_mps: forward is positive.
        angle_deg: steering angle of the bicycle model.
        tick: the ``tick`` that came with that challenge, for readers of a recording; it has no effect.
    """

    version: ClassVar[int] = 2

    seq: Annotated[int, Meta(ge=0, le=2**53 - 1)]
    challenge: Challenge
    speed_mps: SpeedMps
    angle_deg: AngleDeg | None = None
    curvature_1pm: CurvatureInverseM | None = None
    yaw_rate_radps: YawRateRadps | None = None
    tick: Tick | None = None
