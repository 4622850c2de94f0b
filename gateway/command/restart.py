"""State that survives a restart or a gap, and the secret numbers of leases. Pure.

- ``Snapshot``: a gateway at rest, from which its journal can be run again. The robot stands, no operator holds the
  lease, nothing is latched; all but these few values is in the feedback of the last seconds.
- ``Carried``: the state after a restart: standby, with all latches. Earlier logs also have an owed stop, lamps and
  horn.
- ``LeaseNumbers``: a lease's number is a secret between holder and robot. The loop replaces numbers by identifiers
  in each request, and back in each reply, so the journal gives no one a lease.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import msgspec

from gateway.chassis.layout import Signals
from gateway.command.arbiter import Arbiter
from gateway.command.flow import CommandFlow, PendingReply
from gateway.command.motion import Target
from gateway.command.rulings import RawRequest
from schemas import codec
from schemas.codec import PayloadFault
from schemas.decisions import ArbiterState, LeaseReply
from schemas.reasons import Reason
from schemas.requests import Leased
from schemas.settings import REQUEST_MAX_BYTES
from schemas.subjects import BY_VERB, STOP_VERB

QUIET_NS: Final = 5_000_000_000
"""Time without a request or a command before a snapshot."""


class Snapshot(msgspec.Struct, frozen=True, array_like=True):
    """The state of a gateway at rest. An array in the journal, in this order.

    Attributes:
        challenges: recently published, each with its monotonic time.
        leases: number of leases given in this run.
        ended: the last ended leases, with the reason.
        sequences: the next sequence of each message, by class name.
        state_due_ns: when the next safety/state is due, monotonic.
        sent: the last alive counter of each command frame, by identifier.
        bars: reasons against engaging, each with its words; left out if there is none.
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


def _is_idle(flow: CommandFlow) -> bool:
    """The robot stands, no operator holds the lease, and no stop is due or can become due."""
    arbiter = flow.arbiter
    return (
        arbiter.state is ArbiterState.STANDBY
        and arbiter.leases.held is None
        and not arbiter.engagement.is_closing
        and arbiter.handover.left is None
        and not arbiter.engagement.owes_stop
        and arbiter.monitor.stands
        and arbiter.monitor.chassis.bus_up
    )


def is_at_rest(flow: CommandFlow, now_ns: int) -> bool:
    """Return True if ``snapshot`` holds the whole state."""
    arbiter = flow.arbiter
    return (
        _is_idle(flow)
        and now_ns - flow.busy_ns >= QUIET_NS
        and not arbiter.latches.details
        and not arbiter.engagement.is_after_crash
        and arbiter.auxiliary.is_off(now_ns)
        and not arbiter.monitor.pressed
        and not arbiter.monitor.chassis_faults()
    )


def snapshot(flow: CommandFlow) -> Snapshot:
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
    """Return the snapshot for the journal; without ``bars`` if there are none."""
    values = msgspec.structs.astuple(kept)
    return values if kept.bars else values[:-1]


def restore(flow: CommandFlow, kept: Snapshot, now_ns: int) -> None:
    """Restore a snapshot in a new flow that has seen the feedback of the last seconds."""
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


class Carried(msgspec.Struct, frozen=True, array_like=True):
    """State of a standing robot that a new arbiter cannot see on the chassis. An array in the journal.

    Attributes:
        latched: oldest first, each with its detail.
        lamps, horn: as the chassis was left with them.
    """

    latched: dict[str, str] = {}
    stop_reason: str = Reason.NONE.value
    stop_detail: str = ""
    owes_stop: bool = False
    lamps: Signals = {}
    horn: bool = False

    @property
    def words(self) -> str:
        """The latched causes in words; empty if there is none."""
        return "; ".join(f"{reason} ({detail})" if detail else reason for reason, detail in self.latched.items())


def may_start_again(flow: CommandFlow, now_ns: int) -> bool:
    """Return True if the gateway may be away for some seconds, with the note of latches as its only memory.

    The robot stands, no operator holds the lease, nothing is sent, and there was no recent request. Latches and
    bars do not prevent it, because renewed files may be the cure; nor do events, which a busy computer makes all
    the time. If the chassis may still execute an old command, a stop is owed, or the horn is on, the gateway
    stays.
    """
    return _is_idle(flow) and now_ns - flow.asked_ns >= QUIET_NS and not flow.arbiter.auxiliary.is_sounding


def take_over(arbiter: Arbiter, former: Carried, now_ns: int) -> None:
    """Continue from the state of the previous gateway."""
    engagement = arbiter.engagement
    for reason, detail in former.latched.items():
        engagement.latch(Reason(reason), detail, now_ns)
    engagement.stop_reason, engagement.stop_detail = Reason(former.stop_reason), former.stop_detail
    engagement.owes_stop = former.owes_stop
    engagement.auxiliary.restore(former.lamps, horn=former.horn)


UNKNOWN_LEASE: Final = 0
"""Identifier for a number that was not given."""

_KEPT: Final = 32
"""More than the ended leases that the arbiter remembers, so that their holders learn the cause."""


class LeaseNumbers:
    """The number of each lease that was given."""

    def __init__(self, draw: Callable[[], int]) -> None:
        """Start without leases. ``draw`` returns an unpredictable number from 1 to ``LEASE_MAX``."""
        self._draw = draw
        self._ids: dict[int, int] = {}

    def admit(self, raw: RawRequest, _now_ns: int = 0) -> RawRequest:
        """Return the request for core and journal, without any lease number.

        Parts that the core does not read, or that cannot be read, are removed: a number could be anywhere in them.
        """
        raw = msgspec.structs.replace(raw, attachment=b"") if raw.attachment else raw
        command = BY_VERB.get(raw.verb)
        if command is None or raw.verb == STOP_VERB or raw.size > REQUEST_MAX_BYTES or raw.fault:
            return msgspec.structs.replace(raw, payload=b"")
        request = codec.decode_request(command, raw.payload)
        if isinstance(request, PayloadFault):
            return msgspec.structs.replace(raw, payload=b"", fault=request.detail)
        if isinstance(request, Leased):
            request = msgspec.structs.replace(request, lease=self._ids.get(request.lease, UNKNOWN_LEASE))
        return msgspec.structs.replace(raw, payload=_ENCODER.encode(request))

    def reply(self, reply: PendingReply) -> PendingReply:
        """Return the reply for its receiver, with the lease's number, drawn here, in place of its identifier."""
        command = BY_VERB.get(reply.verb)
        if command is None or command.reply is not LeaseReply:
            return reply
        said = _LEASE_REPLY.decode(reply.payload)
        if not said.ok:
            return reply
        number = self.number_of(said.lease)
        if not number:
            number = self._draw()
            self._ids[number] = said.lease
            if len(self._ids) > _KEPT:
                del self._ids[next(iter(self._ids))]
        payload = _ENCODER.encode(msgspec.structs.replace(said, lease=number))
        return msgspec.structs.replace(reply, payload=payload)

    def number_of(self, lease_id: int) -> int:
        """Return the number of a lease; 0 if it was not given."""
        return next((number for number, known in self._ids.items() if known == lease_id), 0)


_ENCODER: Final = msgspec.msgpack.Encoder()
_LEASE_REPLY: Final = msgspec.msgpack.Decoder(LeaseReply)
