"""Snapshots of a gateway at rest, from which its journal can be run again. Pure.

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
"""The time without a request or a command after which a snapshot may be taken."""


class Snapshot(msgspec.Struct, frozen=True, array_like=True):
    """The few numbers. In the journal it is an array, in this order.

    Attributes:
        tick_number: of the last tick.
        challenges: those that were published lately, each with its monotonic time.
        leases: number of leases given in this run.
        ended: the leases that ended last, and why.
        stop_reason, stop_detail: why the last stop was begun, and its figures.
        parked, target_speed_mps, target_angle_deg: the last requested ones.
        sequences: the next sequence of each message of the arbiter, by the class's name.
        state_due_ns: when the next safety/state is due, monotonic.
        sent: the last alive counter of each command frame that was ever sent, by identifier.
        bars: why nobody may engage the robot, each reason with its words; left out if there is none.
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
    bars: dict[str, str] = {}


def is_at_rest(flow: CommandFlow, now_ns: int) -> bool:
    """True if nothing is under way, and ``snapshot`` holds all that remains of what was."""
    arbiter = flow.arbiter
    return (
        arbiter.state is ArbiterState.STANDBY
        and now_ns - flow.busy_ns >= QUIET_NS
        and arbiter.leases.held is None
        and not arbiter.latches.details
        and not arbiter.engagement.is_closing
        and arbiter.handover.left is None
        and not arbiter.engagement.owes_stop
        and not arbiter.engagement.is_after_crash
        and arbiter.auxiliary.is_off(now_ns)
        and arbiter.monitor.stands
        and not arbiter.monitor.pressed
        and not arbiter.monitor.chassis_faults()
        and arbiter.monitor.chassis.bus_up
    )


def snapshot(flow: CommandFlow) -> Snapshot:
    """Return the snapshot of a gateway at rest."""
    arbiter = flow.arbiter
    return Snapshot(
        tick_number=arbiter.tick_number,
        challenges=arbiter.link.challenges.published,
        leases=arbiter.leases.given,
        ended=[(number, reason.value) for number, reason in arbiter.leases.ended],
        stop_reason=arbiter.engagement.stop_reason.value,
        stop_detail=arbiter.engagement.stop_detail,
        parked=arbiter.setpoint.parked,
        target_speed_mps=arbiter.setpoint.target.speed_mps,
        target_angle_deg=arbiter.setpoint.target.angle_deg,
        sequences=dict(flow.reporter.sequences),
        state_due_ns=flow.reporter.state_due_ns,
        sent=dict(flow.gate.counters),
        bars={reason.value: words for reason, words in arbiter.engagement.bars.items()},
    )


def as_array(kept: Snapshot) -> tuple[object, ...]:
    """The snapshot as the journal holds it; as before there were bars, if there are none."""
    values = msgspec.structs.astuple(kept)
    return values if kept.bars else values[:-1]


def restore(flow: CommandFlow, kept: Snapshot, now_ns: int) -> None:
    """From here on the flow is the one that is remembered.

    Args:
        flow: a new one, which has seen the feedback of the last seconds.
        kept: the snapshot.
        now_ns: when it was, monotonic.
    """
    arbiter = flow.arbiter
    arbiter.tick_number = kept.tick_number
    arbiter.link.challenges.restore(kept.challenges)
    arbiter.leases.restore(kept.leases, [(number, Reason(reason)) for number, reason in kept.ended])
    arbiter.engagement.stop_reason, arbiter.engagement.stop_detail = Reason(kept.stop_reason), kept.stop_detail
    arbiter.engagement.bars = {Reason(reason): words for reason, words in kept.bars.items()}
    arbiter.setpoint.parked = kept.parked
    arbiter.setpoint.target = Target(kept.target_speed_mps, kept.target_angle_deg)
    flow.maker.restore(kept.sent)
    flow.gate.counters = dict(kept.sent)
    flow.reporter.restore(kept.sequences, kept.state_due_ns, now_ns)
