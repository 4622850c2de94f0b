"""A robot in one row of the overview: what it does, or what is wrong with it. Pure."""

from __future__ import annotations

from typing import Final

from gateway.client.fleet import RobotStatus, alarm
from gateway.client.reasons_text import state_line, text_of
from gateway.client.robot_word import FINE, LOOK, WORDS, word_of
from gateway.desk.words import RecorderRow, RobotRow
from schemas.command_line import plain, short
from schemas.decisions import SafetyEvent, SafetyState
from schemas.messages import GatewayHealth
from schemas.reasons import ACQUIRE, ENGAGE, RESET, TEXTS, Reason, cure_of
from schemas.recording import RecorderHealth

COUNT_MAX: Final = 2**53 - 1

BUTTONS: Final = {
    RESET: "press Reset, then ",
    ENGAGE: "Take control",
    ACQUIRE: "Take control",
    " ('cruiser drive ROBOT')": "",
    "say whose stop is cleared: 'cruiser reset ROBOT --of NAME', or lease.reset(of=NAME)": "press Reset",
}
"""The buttons of the page that do what a cure has a command for."""


def row_of(report: RobotStatus, event: SafetyEvent | None) -> RobotRow:
    """Return a robot's row."""
    state, safety = report.state, report.safety
    word, reasons = word_of(report)
    return RobotRow(
        level=max(WORDS[word], LOOK if report.newer or report.health is None else FINE),
        word=word,
        text=short(plain(_text_of(report, word, reasons))),
        driver=short(plain(safety.lease_holder)) if safety is not None else "",
        speed_mps=_rounded(state.speed_mps if state is not None else None),
        limit_mps=_rounded(_limit_mps(safety) if safety is not None else None),
        link_age_s=_rounded(safety.link_age_s if safety is not None else None),
        lost=_count(sum(frame.lost for frame in report.health.feedback)) if report.health is not None else None,
        event=short(plain(event.text)) if event is not None else "",
        event_ns=event.time_ns if event is not None else 0,
        reasons=[reason.value for reason in reasons],
    )


def recorder_row(name: str, health: RecorderHealth) -> RecorderRow:
    """Return a recorder's row."""
    return RecorderRow(
        name,
        health.state.value,
        health.robots,
        _count(health.missed + sum(health.dropped.values())),
        health.disk_free_bytes,
    )


def why_not(
    safety: SafetyState, health: GatewayHealth | None, robot: str
) -> tuple[list[tuple[str, str, str]], list[str]]:
    """Return the reasons for which a robot does not move, and what else to see to."""
    reasons = [(one.value, *_text(one, robot, safety.blocked_by)) for one in safety.blocked_by]
    notes = [short(plain(note)) for note in health.notes] if health is not None else []
    if health is not None and not health.realtime:
        notes.append(_text(Reason.NO_REALTIME, robot)[0])
    return reasons, notes


def reasons_in_words() -> dict[str, tuple[str, str]]:
    """Return meaning and cure of each reason for which a request is refused; ROBOT stands for the robot's name."""
    return {reason.value: (text.means, _with_buttons(text.cure, "ROBOT")) for reason, text in TEXTS.items()}


def _text(reason: Reason, robot: str, beside: list[Reason] | None = None) -> tuple[str, str]:
    text = text_of(reason, robot, beside or [])
    return text.means, _with_buttons(text.cure, robot)


def _with_buttons(cure: str, robot: str) -> str:
    for command, button in BUTTONS.items():
        cure = cure.replace(cure_of(command, robot), button)
    return cure


def _text_of(report: RobotStatus, word: str, reasons: list[Reason]) -> str:
    """A robot's word in a sentence."""
    state, safety = report.state, report.safety
    if state is None:
        return alarm(report)
    if word == "bus_down":
        return "its CAN bus is down"
    if safety is None:
        return f"mode {state.mode.value}; it takes no commands"
    return state_line(safety) if word == "stopping" or not reasons else _meanings(reasons, report.robot)


def _meanings(reasons: list[Reason], robot: str) -> str:
    return "; ".join(_text(one, robot)[0] for one in reasons)


def _limit_mps(safety: SafetyState) -> float:
    """The speed limit in force, with that of the commands' age."""
    travel_mps = safety.travel_speed_limit_mps
    return safety.speed_limit_mps if travel_mps is None else min(safety.speed_limit_mps, travel_mps)


def _count(value: int) -> int:
    """A sum of what others count, no larger than a browser's numbers are exact."""
    return min(value, COUNT_MAX)


def _rounded(value: float | None) -> float | None:
    """As exact as it is shown, so that a row changes only where a person sees it."""
    return None if value is None else round(value, 2)
