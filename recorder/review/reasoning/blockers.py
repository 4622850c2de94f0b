"""Reasons that keep a robot from moving, or from being engaged, at a moment; and what would cure them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Final

from recorder.review.reasoning.chain import Link, Step
from recorder.review.reasoning.request_evidence import last_command
from recorder.review.reasoning.window import EvidenceWindow
from schemas.decisions import ArbiterState, Bound, SafetyState
from schemas.reasons import OF_A_ROBOT, RESET, Reason, cure_of, of_a_robot

PLAIN: Final = frozenset({Reason.STOPPING, Reason.NOT_ENGAGED, Reason.ENGAGING, Reason.NO_LEASE})
"""Reasons that block a robot that nobody has engaged: there is nothing to show but that nobody has."""

_PASSING: Final = frozenset({Reason.STOPPING, Reason.ENGAGING, Reason.GEAR_SHIFTING})
"""Reasons that end by themselves."""

_FORBIDS: Final = {Reason.FRONT_BUMPER: (1, "forward"), Reason.REAR_BUMPER: (-1, "backward")}
"""The sign of the speeds that a pressed bumper forbids to an engaged robot, and their direction in words."""


def is_told(state: SafetyState) -> bool:
    """The command to the chassis has a speed that would not be shown as none."""
    return bool(round(state.output_speed_mps, 2))


def kept_by(now: EvidenceWindow, state: SafetyState) -> list[Reason]:
    """Return the reasons that kept an engaged robot from moving; none if its command was to move.

    A pressed bumper forbids one direction alone: it counts if that one was asked for.
    """
    if is_told(state):
        return []
    last = last_command(now)
    is_bound = last is not None and Bound.BUMPER in last.said.bound_by
    return [reason for reason in state.blocked_by if reason not in _FORBIDS or is_bound]


def blocks(reason: Reason, now: EvidenceWindow, state: SafetyState) -> bool:
    """Report whether a reason is in the way; a pressed bumper is not if the robot goes away from it."""
    if state.state is not ArbiterState.ENGAGED:
        return True
    if reason in _FORBIDS:
        return (state.output_speed_mps or state.target_speed_mps) * _FORBIDS[reason][0] >= 0
    return reason in kept_by(now, state)


def blocked_words(reason: Reason, state: SafetyState) -> str:
    """The meaning of a reason that blocks for a robot in this state."""
    means = OF_A_ROBOT[reason].means
    match state.state:
        case ArbiterState.ENGAGED if reason in _FORBIDS:
            return f"it could not be driven {_FORBIDS[reason][1]}: {means}, and was pressed still"
        case ArbiterState.ENGAGED:
            return f"it was told no speed: {means}"
        case ArbiterState.STOPPING:
            return f"it could not be engaged again: {means}"
        case _:
            return f"it could not be engaged: {means}"


def cures(reason: Reason, robot: str, beside: Collection[Reason] = (), *, is_reset: bool) -> Iterator[Link]:
    """Return the cure of a reason; if it is no longer latched, the rest that remains after the reset.

    Args:
        reason: that of a stop, or one that blocks.
        robot: its name.
        beside: the other reasons that block.
        is_reset: it is not latched any more.
    """
    cure = of_a_robot(reason, beside).cure
    if is_reset:
        cure = cure.rpartition(RESET)[2]
    if cure and reason not in _PASSING:
        yield Link(Step.CURE, f"to cure {reason.value}: {cure_of(cure, robot)}", None, {"reason": reason.value})
