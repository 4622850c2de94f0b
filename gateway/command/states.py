"""The arbiter's states and what leads from one to another: one table, which the documents' diagram is made of."""

from __future__ import annotations

from enum import Enum
from typing import Final

from schemas.decisions import ArbiterState


class Trigger(Enum):
    """Events that change the state, in words."""

    ENGAGE = "engage is accepted"
    CONFIRMED = "the chassis reads auto"
    STOP = "a cause to stop"
    YIELD = "the remote control or the guard takes over, the mode leaves auto at rest, or the bus is lost"
    REST = "the stop sequence has ended"


_STANDBY, _ENGAGING = ArbiterState.STANDBY, ArbiterState.ENGAGING
_ENGAGED, _STOPPING = ArbiterState.ENGAGED, ArbiterState.STOPPING

TRANSITIONS: Final[dict[tuple[ArbiterState, Trigger], ArbiterState]] = {
    (_STANDBY, Trigger.ENGAGE): _ENGAGING,
    (_STANDBY, Trigger.STOP): _STOPPING,
    (_ENGAGING, Trigger.CONFIRMED): _ENGAGED,
    (_ENGAGING, Trigger.STOP): _STOPPING,
    (_ENGAGING, Trigger.YIELD): _STANDBY,
    (_ENGAGED, Trigger.STOP): _STOPPING,
    (_ENGAGED, Trigger.YIELD): _STANDBY,
    (_STOPPING, Trigger.STOP): _STOPPING,
    (_STOPPING, Trigger.YIELD): _STANDBY,
    (_STOPPING, Trigger.REST): _STANDBY,
}
"""No other transition happens. Only ENGAGE leads out of standby to motion, and nothing but a request
of the lease's holder triggers it: nothing resumes by itself."""


def diagram() -> str:
    """The table as a Mermaid state diagram."""
    lines = ["stateDiagram-v2", f"    [*] --> {ArbiterState.STANDBY.value}"]
    lines += [
        f"    {before.value} --> {after.value}: {trigger.value}"
        for (before, trigger), after in TRANSITIONS.items()
    ]
    return "\n".join(lines)
