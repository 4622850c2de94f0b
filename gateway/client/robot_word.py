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
    "offline": ALARM,
    "needs_reset": ALARM,
    "bus_down": ALARM,
    "stopping": LOOK,
    "remote_control": LOOK,
    "blocked": LOOK,
    "driving": FINE,
    "in_control": FINE,
    "ready": FINE,
    "telemetry": FINE,
}
"""The words, the gravest first, and their levels. ``telemetry``: it has no arbiter."""

OFFLINE: Final = "offline"

LABELS: Final = {"needs_reset": "stopped - needs reset", "telemetry": "telemetry only"}
"""The words as people read them, where that is not the word itself."""

COUNTED: Final = {"needs_reset": ("needs reset", "need reset"), "telemetry": ("telemetry only", "telemetry only")}
"""The words behind a number: of one robot, and of several."""


def word_of(report: RobotStatus) -> tuple[str, list[Reason]]:
    """Return a robot's word, and the reasons for it."""
    state, safety = report.state, report.safety
    if state is None:
        return OFFLINE, []
    if not state.bus_up:
        return "bus_down", [Reason.BUS_DOWN]
    return ("telemetry", []) if safety is None else _word_of_arbiter(state, safety)


def _word_of_arbiter(state: RobotState, safety: SafetyState) -> tuple[str, list[Reason]]:
    if safety.latched:
        return "needs_reset", safety.latched
    if safety.state is ArbiterState.STOPPING:
        return "stopping", [safety.stop_reason]
    if state.mode is Mode.REMOTE:
        return "remote_control", [Reason.HAND_TRANSMITTER]
    if safety.state in COMMANDING:
        moves = state.speed_mps is not None and abs(state.speed_mps) >= STANDSTILL_MPS
        return "driving" if moves else "in_control", []
    blocked = [one for one in safety.blocked_by if not is_idle([one])]
    if blocked:
        return "blocked", blocked
    return "in_control" if safety.lease_holder else "ready", []


def label_of(word: str) -> str:
    """Return a word as people read it."""
    return LABELS.get(word, word.replace("_", " "))


def summary(reports: Sequence[RobotStatus]) -> str:
    """Several robots in one line: so many of each word, ``52 ready, 6 driving, 2 need reset, 1 offline``."""
    words = Counter(word_of(report)[0] for report in reports)
    counted = (
        f"{words[word]} {COUNTED.get(word, (label_of(word), label_of(word)))[words[word] > 1]}"
        for word in reversed(WORDS)
        if words[word]
    )
    return ", ".join(counted)
