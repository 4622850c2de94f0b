"""The end of a gateway's run and the beginning of the next one: between them nobody said anything."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import msgspec

from recorder.review.reasoning.chain import Link, Step, before
from recorder.review.reasoning.scene import Heard, Scene
from recorder.review.timeline.clock import RUN_TICKS
from schemas.decisions import ArbiterState, SafetyState
from schemas.messages import Drive
from schemas.settings import STANDSTILL_MPS

_FRESH_NS = 500_000_000
"""Feedback that is older is no longer what the robot did."""


class Silence(msgspec.Struct, frozen=True):
    """A gateway that fell silent, and another one.

    Attributes:
        was: the last state of the one.
        then: the first of the other.
        speed_mps: the robot's, when the one was last heard; None if the log does not tell.
    """

    was: Heard[SafetyState]
    then: Heard[SafetyState]
    speed_mps: float | None

    @property
    def was_stopping(self) -> bool:
        """It fell silent in the midst of a stop."""
        return self.was.said.state is ArbiterState.STOPPING

    @property
    def left(self) -> str:
        """What the gateway and the robot did when it was last heard."""
        if self.speed_mps is None:
            return f"{self.was.said.state.value}, at a speed that is not in the log"
        motion = "standing" if self.speed_mps < STANDSTILL_MPS else f"at {self.speed_mps:.2f} m/s"
        return f"{self.was.said.state.value}, {motion}"


def is_other_run(one: SafetyState, other: SafetyState) -> bool:
    """The two are not of one run of a gateway."""
    return abs(one.tick - other.tick) >= RUN_TICKS


def last_silence(now: Scene) -> Silence | None:
    """The last one that began before the moment; None if none is in these seconds."""
    found = None
    for was, then in pairwise(now.all(SafetyState)):
        if was.time_ns <= now.at_ns and is_other_run(was.said, then.said):
            found = was, then
    if found is None:
        return None
    was, then = found
    drive = now.last(Drive, was.time_ns + _FRESH_NS)
    is_known = drive is not None and drive.time_ns > was.time_ns - _FRESH_NS and drive.time_ns < then.time_ns
    return Silence(was, then, drive.said.speed_mps if drive is not None and is_known else None)


def in_a_sentence(silence: Silence, at_ns: int) -> str:
    """For a headline."""
    fell = before(silence.was.time_ns, at_ns)
    return f"The gateway fell silent {fell}, {silence.left}; another began {before(silence.then.time_ns, at_ns)}."


def links(silence: Silence) -> Iterator[Link]:
    """The silence, and its end."""
    said = silence.was.said
    data = {
        "state": said.state.value,
        "lease_holder": said.lease_holder,
        "speed_mps": silence.speed_mps,
        "output_speed_mps": said.output_speed_mps,
        "silent_ms": (silence.then.time_ns - silence.was.time_ns) / 1e6,
    }
    told = f"; it told the chassis {said.output_speed_mps:.2f} m/s" if said.state is ArbiterState.ENGAGED else ""
    yield Link(Step.CAUSE, f"the gateway fell silent, {silence.left}{told}", silence.was.time_ns, data)
    yield Link(Step.CAUSE, "another gateway began: nothing of before holds any more", silence.then.time_ns)
