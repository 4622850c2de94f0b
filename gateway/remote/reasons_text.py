"""Why a robot does not move, in words. Pure."""

from __future__ import annotations

from schemas.decisions import SafetyEvent, SafetyState
from schemas.printable import plain
from schemas.reasons import OF_A_ROBOT, Reason, Text


def text_of(reason: Reason) -> Text:
    """A reason for which a robot stands still."""
    return OF_A_ROBOT[reason]


def reason_line(reason: Reason) -> str:
    """A reason with what would cure it."""
    text = text_of(reason)
    cure = f" -> {text.cure}" if text.cure else ""
    return f"{reason.value}: {text.means}{cure}"


def state_line(state: SafetyState) -> str:
    """What the arbiter does, and for whom."""
    words = [state.state.value]
    if state.stop_phase.value != "idle":
        words.append(f"{state.stop_phase.value}, because of {state.stop_reason.value}")
    words.append(holder_line(state))
    return "; ".join(words)


def holder_line(state: SafetyState) -> str:
    """Who holds the lease."""
    if not state.lease_holder:
        return "nobody holds the lease"
    holder = plain(state.lease_holder)
    return f"{holder} holds the lease as {state.lease_role.value}, expires in {state.lease_expires_s:.1f} s"


def event_line(event: SafetyEvent, now_ns: int) -> str:
    """An event and how long ago it was, by the clock of the robot against this one's (both in wall time)."""
    ago_s = (now_ns - event.time_ns) / 1e9
    by = f" ({plain(event.operator)})" if event.operator and event.operator not in event.text else ""
    return f"{ago_s:.1f} s ago: {event.severity.value}: {plain(event.text)}{by}"
