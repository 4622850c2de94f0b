"""One word for all that a robot does or suffers, the same in the overview of a browser and of a terminal. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final

from gateway.client.fleet import RobotStatus
from gateway.client.reasons_text import is_idle
from schemas.decisions import COMMANDING, ArbiterState, SafetyState
from schemas.messages import Mode, RobotState
from schemas.reasons import Reason
from schemas.settings import STANDSTILL_MPS

FINE: Final = 0
LOOK: Final = 1
ALARM: Final = 2
"""The levels: nothing is wrong; somebody should look; it needs a person."""

WORDS: Final = {
    "silent": ALARM,
    "latched": ALARM,
    "bus_down": ALARM,
    "stopping": LOOK,
    "transmitter": LOOK,
    "blocked": LOOK,
    "driving": FINE,
    "engaged": FINE,
    "held": FINE,
    "ready": FINE,
    "telemetry": FINE,
}
"""The words, the gravest first, and their levels. ``telemetry``: it has no arbiter."""


def word_of(report: RobotStatus) -> tuple[str, list[Reason]]:
    """Return a robot's word, and the reasons for it."""
    state, safety = report.state, report.safety
    if state is None:
        return "silent", []
    if not state.bus_up:
        return "bus_down", [Reason.BUS_DOWN]
    return ("telemetry", []) if safety is None else _word_of_arbiter(state, safety)


def _word_of_arbiter(state: RobotState, safety: SafetyState) -> tuple[str, list[Reason]]:
    if safety.latched:
        return "latched", safety.latched
    if safety.state is ArbiterState.STOPPING:
        return "stopping", [safety.stop_reason]
    if state.mode is Mode.REMOTE:
        return "transmitter", [Reason.HAND_TRANSMITTER]
    if safety.state in COMMANDING:
        moves = state.speed_mps is not None and abs(state.speed_mps) >= STANDSTILL_MPS
        return "driving" if moves else "engaged", []
    blocked = [one for one in safety.blocked_by if not is_idle([one])]
    if blocked:
        return "blocked", blocked
    return "held" if safety.lease_holder else "ready", []


def summary(reports: Sequence[RobotStatus]) -> str:
    """Several robots in one line: so many of each word, the gravest first.

    Of one whose health came, and no state yet, no word is known: it is ``connected``.
    """
    words = Counter(
        "connected" if report.health is not None and report.state_age_s is None else word_of(report)[0]
        for report in reports
    )
    counted = (f"{words[word]} {word.replace('_', ' ')}" for word in (*WORDS, "connected") if words[word])
    return f"{len(reports)} robots: {', '.join(counted)}"
