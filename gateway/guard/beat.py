"""The heartbeats of the loop and of the guard, which they exchange in shared memory."""

from __future__ import annotations

from enum import Enum

import msgspec

from gateway.command.actuation import AT_REST, Actuation
from schemas.messages import Variant


class Beat(msgspec.Struct, frozen=True):
    """The loop's sign of life, each tick, after it has sent.

    Attributes:
        now_ns: monotonic, when the loop had sent.
        is_active: the chassis is under command, or was in the tick before and that was the end of a stop.
        told_ns: when the bus last accepted a whole burst.
        is_left: the chassis was left to somebody else with the command ``last``, and may execute that again.
        is_mute: the output cannot be sent; the guard has to act at once.
        is_closing: the gateway ends, and nobody will beat any more.
        variant: the one in force.
        last: the chassis's last command; at rest if that is over and done.
        counters: the next alive counter of each command frame, in the layout's order.
        is_released: a stop has given the robot back to its motor, for the parking brake does not hold it.
        returns: so many times the robot moved in this stop when the enables were gone.
    """

    now_ns: int
    told_ns: int = 0
    is_active: bool = False
    is_left: bool = False
    is_mute: bool = False
    is_closing: bool = False
    variant: Variant = Variant.UNKNOWN
    last: Actuation = AT_REST
    counters: bytes = bytes(8)
    is_released: bool = False
    returns: int = 0


class Cause(Enum):
    """Causes for which the guard acts, in words."""

    NONE = "it has not acted"
    LATE = "the gateway's loop gave no sign of life"
    MUTE = "the gateway could not send"
    GONE = "the gateway is gone"


class StopOutcome(Enum):
    """Ends of the guard's stop, in words."""

    NONE = ""
    STANDS = "the robot stands"
    UNSEEN = "the robot is not seen to stand"
    REMOTE = "the remote control has the robot"
    OTHER = "the remote control had the robot, and another computer commands it since"
    GIVEN_UP = "it has given up"
    MOTOR = "the motor alone holds the robot, by its last command: chock its wheels"


class GuardView(msgspec.Struct, frozen=True):
    """The guard, as the loop sees it at one time.

    Attributes:
        is_watching: it lives, has its bus and receives feedback: it would stop the robot in our place.
        is_sending: it does so now, and we must be silent. One that gives no sign of life any more is not.
        stops: number of stops that it has begun since the start.
        says: why it last did, and how that ended; empty if it never did.
    """

    is_watching: bool = False
    is_sending: bool = False
    stops: int = 0
    says: str = ""


class GuardStatus(msgspec.Struct, frozen=True):
    """The guard's sign of life.

    Attributes:
        now_ns: monotonic.
        is_ready: its bus is open and it receives feedback.
        is_sending: it stops the robot; the loop must not send. Also while it waits for the remote control to
            give the robot back.
        stops: number of stops that it has begun since it was started.
        cause: of the last one, or of the one under way.
        outcome: the end of the last one; NONE while one is under way.
    """

    now_ns: int
    is_ready: bool = False
    is_sending: bool = False
    stops: int = 0
    cause: Cause = Cause.NONE
    outcome: StopOutcome = StopOutcome.NONE

    @property
    def says(self) -> str:
        """Cause and outcome in words; empty if it has not acted."""
        return "" if self.cause is Cause.NONE else "; ".join(filter(None, (self.cause.value, self.outcome.value)))
