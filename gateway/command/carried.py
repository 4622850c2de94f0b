"""When a gateway may be started again, and what it begins with. Pure.

A restart must never clear a latch. The gateway that starts again is not ready by itself: it begins in standby,
with all that was latched. In logs of before it began with more: a stop that was owed, lamps and horn.
"""

from __future__ import annotations

import msgspec

from gateway.chassis.decode import Signals
from gateway.command.flow import CommandFlow
from gateway.command.snapshot import QUIET_NS
from schemas.decisions import ArbiterState
from schemas.reasons import Reason


class Carried(msgspec.Struct, frozen=True, array_like=True):
    """All of a standing robot's past that a new arbiter cannot see on the chassis. In the journal it is an array.

    Attributes:
        latched: the causes that nobody has reset, oldest first, each with its detail.
        stop_reason, stop_detail: why the last stop was begun, and its figures.
        owes_stop: a stop could not be carried out, or ended without an applied parking brake.
        lamps, horn: the lamps and the horn as the chassis was left with them.
    """

    latched: dict[str, str] = {}
    stop_reason: str = Reason.NONE.value
    stop_detail: str = ""
    owes_stop: bool = False
    lamps: Signals = {}
    horn: bool = False

    @property
    def words(self) -> str:
        """The latched causes, each with its detail; empty if there is none."""
        return "; ".join(f"{reason} ({detail})" if detail else reason for reason, detail in self.latched.items())


def may_start_again(flow: CommandFlow, now_ns: int) -> bool:
    """Return True if the gateway may be away for some seconds, and the note of latches is all that it must know.

    The robot stands, nobody holds the lease, nothing is sent, and nobody asked anything lately. That something is
    latched, or the robot cannot be engaged, is no objection: renewed files may be the cure. Where the chassis may
    yet execute a command that was left to it, a stop is owed, or the horn was left on, the gateway stays.
    Events are no objection either: on a busy computer the loop is late, and says so, again and again.
    """
    arbiter = flow.arbiter
    chassis = arbiter.monitor.chassis
    return (
        arbiter.state is ArbiterState.STANDBY
        and now_ns - flow.asked_ns >= QUIET_NS
        and arbiter.leases.held is None
        and not arbiter.engagement.is_closing
        and arbiter.handover.left is None
        and not arbiter.engagement.owes_stop
        and not arbiter.engagement.auxiliary.is_sounding
        and arbiter.monitor.stands
        and chassis.bus_up
    )


def take_over(flow: CommandFlow, former: Carried, now_ns: int) -> None:
    """Begin where the gateway before this one ended.

    Args:
        flow: a new one.
        former: carried over from the one before it.
        now_ns: monotonic.
    """
    engagement = flow.arbiter.engagement
    for reason, detail in former.latched.items():
        engagement.latch(Reason(reason), detail, now_ns)
    engagement.stop_reason, engagement.stop_detail = Reason(former.stop_reason), former.stop_detail
    engagement.owes_stop = former.owes_stop
    engagement.auxiliary.restore(former.lamps, horn=former.horn)
