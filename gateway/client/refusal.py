"""Refusals and stops as exceptions with reason and cure, and as text. Pure.

Each exception is a ``CommandError``, so a command ends with its text and its exit code.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from datetime import UTC, datetime
from typing import Final

from schemas.command_line import CommandError, ExitCode, plain
from schemas.decisions import COMMANDING, Reply, SafetyEvent, SafetyState, StopPhase
from schemas.reasons import TEXTS, Reason, Text, cure_of, of_a_robot

NEWER_S: Final = 1.0  # an event may be newer than the last state by this
LOOK: Final = (
    "Look at the robot, and use its button if it moves"  # advice after a command to a robot of unknown motion
)


def text_of(reason: Reason, robot: str, beside: Collection[Reason] = ()) -> Text:
    text = of_a_robot(reason, beside)
    return Text(text.means, cure_of(text.cure, robot))


def reason_line(reason: Reason, robot: str, beside: Collection[Reason] = ()) -> str:
    text = text_of(reason, robot, beside)
    cure = f" -> {text.cure}" if text.cure else ""
    return f"{reason.value}: {text.means}{cure}"


def state_line(state: SafetyState) -> str:
    """Return the arbiter's state and its operator as text."""
    words = [state.state.value]
    if state.stop_phase is not StopPhase.IDLE:
        words.append(f"{state.stop_phase.value}: {_stop(state)}")
    elif last_stop(state):
        words.append(f"last stop: {last_stop(state)}")
    if state.stopped_by:
        words.append(f"stopped by {plain(', '.join(state.stopped_by))}")
    words.append(holder_line(state))
    return "; ".join(words)


def last_stop(state: SafetyState) -> str:
    """Return the cause of the last stop; empty if the robot is commanded again, or was never stopped."""
    return "" if state.state in COMMANDING or state.stop_reason is Reason.NONE else _stop(state)


def is_idle(blocked_by: Iterable[Reason]) -> bool:
    """Return True if nothing is wrong, and only a driver is missing."""
    return {Reason.NO_LEASE, Reason.NOT_ENGAGED}.issuperset(blocked_by)


def _stop(state: SafetyState) -> str:
    detail = f" ({plain(state.stop_detail)})" if state.stop_detail else ""
    return f"{TEXTS[state.stop_reason].means}{detail}"


def link_line(state: SafetyState) -> str:
    """Return latency of the drive commands and its cost as text; empty while none is executed."""
    if state.link_age_s is None or state.travel_speed_limit_mps is None:
        return ""
    words = [f"command latency {_ms(state.link_age_s)}"]
    if state.link_age_p99_s is not None:
        words[0] += f" (p99 {_ms(state.link_age_p99_s)})"
    words.append(f"timeout {_ms(state.deadman_s)}")
    words.append(f"reaction distance {state.travel_delay_m:.2f} m")
    words.append(f"speed limit {state.travel_speed_limit_mps:.2f} m/s")
    return ", ".join(words)


def _ms(time_s: float) -> str:
    return f"{time_s * 1e3:.0f} ms"


def holder_line(state: SafetyState) -> str:
    if not state.lease_holder:
        return "no operator holds the lease"
    holder = plain(state.lease_holder)
    return f"{holder} holds the lease as {state.lease_role.value}, expires in {state.lease_expires_s:.1f} s"


def event_line(event: SafetyEvent, now_ns: int) -> str:
    """Return an event with its age; with its time of day if the robot's clock (``now_ns``) was set back since."""
    ago_s = (now_ns - event.time_ns) / 1e9
    when = f"{max(0.0, ago_s):.1f} s ago"
    if ago_s < -NEWER_S:
        when = f"at {datetime.fromtimestamp(event.time_ns // 10**9, UTC):%H:%M:%S} UTC by the robot's clock"
    by = f" ({plain(event.operator)})" if event.operator and event.operator not in event.text else ""
    return f"{when}: {event.severity.value}: {plain(event.text)}{by}"


class RobotError(CommandError):
    """The robot does not do what was requested.

    Attributes:
        reason: why, as an enumeration.
        detail: why, as text.
        cure: how to make it succeed.
    """

    code = ExitCode.FAILURE

    def __init__(self, what: str, reason: Reason, detail: str = "", cure: str = "", *, robot: str) -> None:
        self.reason = reason
        self.detail = detail or TEXTS[reason].means
        self.cure = cure_of(cure or TEXTS[reason].cure, robot)
        tail = f". Cure: {self.cure}" if self.cure else ""
        super().__init__(plain(f"{what}: {self.detail} ({reason.value}){tail}"), type(self).code)


class Refused(RobotError):  # noqa: N818 - an outcome's name, as programs read it
    """The robot refused a request."""

    code = ExitCode.REFUSED


class Stopped(RobotError):  # noqa: N818 - an outcome's name, as programs read it
    """The robot was stopped, and rejects drive commands until it is engaged again."""


class LeaseLost(RobotError):  # noqa: N818 - an outcome's name, as programs read it
    """The lease was taken by another operator, or has expired."""


class Unreachable(CommandError):  # noqa: N818 - an outcome's name, as programs read it
    """The robot does not answer, or its answer cannot be read."""

    def __init__(self, message: str) -> None:
        super().__init__(plain(message), ExitCode.UNREACHABLE)


def refused(robot: str, verb: str, reply: Reply, operator: str) -> Refused:
    detail = reply.detail
    if reply.reason is Reason.LEASE_HELD:
        own = f"another session of {operator} holds the lease; it "
        detail = detail.replace(f"{TEXTS[Reason.LEASE_HELD].means}; by {operator}, ", own)
    return Refused(f"{robot} refuses {verb}", reply.reason, detail, reply.cure, robot=robot)
