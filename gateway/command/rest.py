"""What a gateway at rest has to be remembered by, so that its journal can be run again from there. Pure.

At rest the robot stands, nobody holds the lease, nothing is latched or asked, and all feedback is well. What the
arbiter knows then is in the feedback of the last seconds, but for a few numbers: those are here.
"""

from __future__ import annotations

from typing import Final

import msgspec

from gateway.command.flow import CommandFlow
from gateway.command.motion import Target
from schemas.decisions import ArbiterState
from schemas.reasons import Reason

QUIET_NS: Final = 5_000_000_000
"""Nobody has asked anything, and nothing was told, for so long."""


class Rest(msgspec.Struct, frozen=True, array_like=True):
    """The few numbers. In the journal it is an array, in this order.

    Attributes:
        tick_number: of the last tick.
        challenges: those that were published lately, each with its monotonic time.
        leases: how many leases were given in this run.
        ended: the leases that ended last, and why.
        stop_reason, stop_detail: why the last stop was begun, and its figures.
        parked, target_speed_mps, target_angle_deg: what was asked last.
        sequences: the next sequence of each message of the arbiter, by the class's name.
        state_due_ns: when the next safety/state is due, monotonic.
        sent: the last alive counter of each command frame that was ever sent, by identifier.
    """

    tick_number: int
    challenges: list[tuple[bytes, int]]
    leases: int
    ended: list[tuple[int, str]]
    stop_reason: str
    stop_detail: str
    parked: bool
    target_speed_mps: float
    target_angle_deg: float
    sequences: dict[str, int]
    state_due_ns: int
    sent: dict[int, int]


def is_at_rest(flow: CommandFlow, now_ns: int) -> bool:
    """Nothing goes on, and nothing is left of what did but what ``memory_of`` tells."""
    arbiter = flow.arbiter
    return (
        arbiter.state is ArbiterState.STANDBY
        and now_ns - flow.busy_ns >= QUIET_NS
        and arbiter.desk.lease is None
        and not arbiter.latched
        and not arbiter.is_closing
        and arbiter.handover.left is None
        and not arbiter.owes_stop
        and arbiter.auxiliary.is_off(now_ns)
        and arbiter.watch.stands
        and not arbiter.watch.pressed
        and not arbiter.watch.chassis_faults()
        and arbiter.watch.observed.bus_up
    )


def memory_of(flow: CommandFlow) -> Rest:
    """What a gateway at rest has to be remembered by."""
    arbiter = flow.arbiter
    return Rest(
        tick_number=arbiter.tick_number,
        challenges=arbiter.challenges.published,
        leases=arbiter.desk.given,
        ended=[(number, reason.value) for number, reason in arbiter.desk.ended],
        stop_reason=arbiter.stop_reason.value,
        stop_detail=arbiter.stop_detail,
        parked=arbiter.parked,
        target_speed_mps=arbiter.target.speed_mps,
        target_angle_deg=arbiter.target.angle_deg,
        sequences=dict(flow.reporter.sequences),
        state_due_ns=flow.reporter.state_due_ns,
        sent=dict(flow.gate.counters),
    )


def recall(flow: CommandFlow, rest: Rest, now_ns: int) -> None:
    """From here on the flow is the one that is remembered.

    Args:
        flow: a new one, which has seen the feedback of the last seconds.
        rest: what was remembered.
        now_ns: when it was, monotonic.
    """
    arbiter = flow.arbiter
    arbiter.tick_number = rest.tick_number
    arbiter.challenges.recall(rest.challenges)
    arbiter.desk.recall(rest.leases, [(number, Reason(reason)) for number, reason in rest.ended])
    arbiter.stop_reason, arbiter.stop_detail = Reason(rest.stop_reason), rest.stop_detail
    arbiter.parked = rest.parked
    arbiter.target = Target(rest.target_speed_mps, rest.target_angle_deg)
    flow.maker.recall(rest.sent)
    flow.gate.counters = dict(rest.sent)
    flow.reporter.recall(rest.sequences, rest.state_due_ns, now_ns)
