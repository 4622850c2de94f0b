"""Requests of clients to a robot: one type for each verb, untrusted until the arbiter has judged it.

A request is a MessagePack map like every message. Unlike in messages, a field that is not known is an error:
whoever sent it meant something by it, and a command that is obeyed in part is worse than one that is refused.
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, ClassVar, Final

import msgspec
from msgspec import Meta

from schemas.messages import AngleDeg, SpeedMps, YawRateRadps, unit_keyword

LEASE_MAX: Final = 2**53 - 1  # the largest whole number that every language's numbers hold exactly

CHALLENGE_BYTES: Final = 8

LeaseNumber = Annotated[int, Meta(ge=0, le=LEASE_MAX, description="The number that acquire or take gave.")]
Tick = Annotated[int, Meta(ge=0, le=LEASE_MAX)]
Challenge = Annotated[
    bytes,
    Meta(
        min_length=CHALLENGE_BYTES,
        max_length=CHALLENGE_BYTES,
        description=f"{CHALLENGE_BYTES} random bytes, drawn anew for each safety/state.",
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
    """The rank of a lease's holder: program, operator, or highest supervisor. An equal one may take it too."""

    PROGRAM = "program"
    OPERATOR = "operator"
    SUPERVISOR = "supervisor"

    @property
    def rank(self) -> int:
        """Higher outranks lower."""
        return list(Role).index(self)


class Request(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The base of all requests.

    A field that is as without it is left out: so a robot that does not have it yet understands the request.
    """

    version: ClassVar[int] = 1


class Acquire(Request, frozen=True, forbid_unknown_fields=True):
    """Ask for the lease of a robot that nobody holds.

    Attributes:
        role: the sender's; in signed mode the grant's counts instead.
        public_key: the sender's for this lease; in signed mode alone.
    """

    role: Role = Role.OPERATOR
    public_key: PublicKey | None = None


class Take(Request, frozen=True, forbid_unknown_fields=True):
    """Take the lease from whoever holds it in no higher role, if the robot stands; the one who loses it is told.

    Attributes:
        role, public_key: see ``Acquire``.
        override: take it although the robot moves; it is stopped first.
    """

    role: Role = Role.OPERATOR
    override: bool = False
    public_key: PublicKey | None = None


class Leased(Request, frozen=True, forbid_unknown_fields=True):
    """A request that only the holder of the lease may make."""

    lease: LeaseNumber


class Renew(Leased, frozen=True, forbid_unknown_fields=True):
    """Keep the lease; an acceptable drive command does so too."""


class Release(Leased, frozen=True, forbid_unknown_fields=True):
    """Give the lease back. An engaged robot is stopped."""


class Engage(Leased, frozen=True, forbid_unknown_fields=True):
    """Take command of the chassis, standing still. The reply comes when the chassis reads auto, or when it failed.

    Attributes:
        challenge: the newest one of ``safety/state`` that the sender saw; a link over which it comes too old is
            too slow to drive over.
        speed_limit_mps: a lower speed limit than the configured one, until the robot is disengaged.
        deadman_s: a longer deadman than the configured one, until the robot is disengaged; a shorter one changes
            nothing. It is for links that stall, and costs speed.
    """

    version: ClassVar[int] = 2

    challenge: Challenge
    speed_limit_mps: SpeedMps | None = None
    deadman_s: DeadmanS | None = None


class Disengage(Leased, frozen=True, forbid_unknown_fields=True):
    """Stop in a controlled way, and give up command of the chassis. Nothing is latched."""


class Reset(Leased, frozen=True, forbid_unknown_fields=True):
    """Clear what is latched, once its cause is gone and the robot stands.

    Attributes:
        challenge: the newest one of ``safety/state`` that the sender saw. With it a reset never clears what was
            latched after that, nor comes late; without it only what was latched a moment ago is kept.
        of: whose remote stop it clears, where that was somebody else's: the first name of ``stopped_by`` in
            ``safety/state`` that is not the sender's.
    """

    version: ClassVar[int] = 2

    challenge: Challenge | None = None
    of: Annotated[str, Meta(max_length=96)] = ""


class Park(Leased, frozen=True, forbid_unknown_fields=True):
    """Apply the parking brake, at any speed, while the commanded speed is zero."""


class Unpark(Leased, frozen=True, forbid_unknown_fields=True):
    """Allow drive commands to release the parking brake, while the commanded speed is zero."""


class Light(Leased, frozen=True, forbid_unknown_fields=True):
    """Set the lamps that are the upper layer's. All false puts them out.

    Every stop puts them out too, that of the deadman included. One that is latched, that of the guard included,
    switches both indicators on instead: hazard lights until the next engage. Where the remote control takes over,
    or the bus is lost, nothing is sent any more: they stay as they are until the robot is engaged again or
    stopped.
    """

    headlamp: bool = False
    left: bool = False
    right: bool = False


class Horn(Leased, frozen=True, forbid_unknown_fields=True):
    """Sound the horn, or end it.

    Every stop ends it too, that of the deadman and that of the guard included. Where the remote control takes
    over, or the bus is lost, nothing is sent any more: it sounds on until the robot is engaged again or stopped.
    """

    on: bool


class ClearOdometer(Leased, frozen=True, forbid_unknown_fields=True):
    """Set the total mileage to zero. The reply comes when the mileage reads zero, or when it failed to."""


class ResetOdometry(Leased, frozen=True, forbid_unknown_fields=True):
    """Set pose, way and variances of ``chassis/odometry`` to zero here and now, at rest or not.

    The mileage that the chassis counts stays: see ``clear_odometer``.
    """


class Stop(Request, frozen=True, forbid_unknown_fields=True):
    """The remote stop, from anyone. Its payload is never read: any bytes will do.

    It is no emergency stop: that is the button on the robot.
    """


class Drive(Leased, frozen=True, forbid_unknown_fields=True):
    """One command of the stream that moves the robot. Exactly one of angle, curvature and yaw rate is given.

    Attributes:
        seq: rises by 1 to 1,000 with each accepted command of a lease, from 0 or 1 on.
        challenge: the newest one of ``safety/state`` that the sender has seen; it bounds the command's age.
        speed_mps: forward is positive.
        angle_deg: steering angle of the bicycle model.
        tick: the ``tick`` beside that challenge, for people who read a recording. Nothing depends on it.
    """

    version: ClassVar[int] = 2

    seq: Annotated[int, Meta(ge=0, le=2**53 - 1)]
    challenge: Challenge
    speed_mps: SpeedMps
    angle_deg: AngleDeg | None = None
    curvature_1pm: CurvatureInverseM | None = None
    yaw_rate_radps: YawRateRadps | None = None
    tick: Tick | None = None
