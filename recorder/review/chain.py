"""A chain of reasoning: links, each a sentence with its numbers as data."""

from __future__ import annotations

from enum import Enum
from typing import Any

import msgspec

from schemas.messages import TimeNs


class Step(Enum):
    """The kind of a link: a fact, its cause, the reaction to it, or a gap of the log."""

    MOTION = "motion"
    ARBITER = "arbiter"
    COMMAND = "command"
    CAUSE = "cause"
    EVIDENCE = "evidence"
    ACTION = "action"
    LATCH = "latch"
    CURE = "cure"
    MISSING = "missing"


class Link(msgspec.Struct, frozen=True):
    """A link.

    Attributes:
        text: a sentence.
        time_ns: when it was, in nanoseconds since 1970; None where it is of no one time.
        data: its numbers, with the units in their names.
    """

    step: Step
    text: str
    time_ns: TimeNs | None = None
    data: dict[str, Any] = {}


def evidence(text: str, time_ns: int | None = None, **data: object) -> Link:
    """Make a link of what the log shows."""
    return Link(Step.EVIDENCE, text, time_ns, data)


def missing(what: str) -> Link:
    """Make a link of what the log does not hold."""
    return Link(Step.MISSING, f"not in the log: {what}")


def span(ns: float) -> str:
    """A length of time for people: ``12.3 ms``, ``310 ms``, ``2.35 s``, ``12 min 5 s``, ``3 h 20 min``."""
    ms = abs(ns) / 1e6
    if ms < 999.5:
        return f"{ms:.1f} ms" if ms < 99.95 else f"{ms:.0f} ms"
    if ms < 119_995:
        return f"{ms / 1e3:.2f} s"
    minutes, seconds = divmod(round(ms / 1e3), 60)
    return f"{minutes} min {seconds} s" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


def before(time_ns: int, at_ns: int, what: str = "that moment") -> str:
    """``12.3 ms before that moment``, or after it."""
    if time_ns == at_ns:
        return f"at {what}"
    return f"{span(at_ns - time_ns)} {'before' if time_ns < at_ns else 'after'} {what}"


def deg(angle_deg: float) -> str:
    """A signed angle; what would be shown as minus nothing is nothing."""
    return f"{round(angle_deg, 1) + 0.0:.1f} deg"


def mps(speed_mps: float) -> str:
    """A signed speed; what would be shown as minus nothing is nothing."""
    return f"{round(speed_mps, 2) + 0.0:.2f} m/s"


def count(number: int, one: str, many: str = "") -> str:
    """``1 frame``, ``2 frames``."""
    return f"{number} {one if number == 1 else many or one + 's'}"
