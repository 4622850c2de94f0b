"""The end of a gateway's run and the beginning of the next one: between them nobody said anything."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, takewhile
from typing import Final

import msgspec

from recorder.review.entries import Entry, EntryKind
from recorder.review.reasoning.chain import Link, Step, before, evidence, missing, span
from recorder.review.reasoning.window import EvidenceWindow, Heard, is_other_run
from schemas.decisions import ArbiterState, EventKind, SafetyEvent, SafetyState, is_same_run
from schemas.messages import Drive
from schemas.reasons import TEXTS, Reason
from schemas.settings import STANDSTILL_MPS

_FRESH_NS: Final = 500_000_000
"""Feedback that is older is no longer what the robot did."""


class GatewaySilence(msgspec.Struct, frozen=True):
    """A gateway that fell silent, and its successor.

    It is dated by the last state of its arbiter, as in ``events`` and ``report``. That state names its run; what
    else comes between the two may be the other gateway's, which decodes frames before its arbiter says anything.

    Attributes:
        was: the last state of the one.
        then: the first state of the other.
        speed_mps: the robot's, when the first was last received; None if the log does not have it.
        found: the first drive feedback from the other; None if the log holds none.
        was_told: the first shut down as requested, at rest.
    """

    was: Heard[SafetyState]
    then: Heard[SafetyState]
    speed_mps: float | None
    found: Heard[Drive] | None
    was_told: bool

    @property
    def heard_ns(self) -> int:
        """The time of the one's last state."""
        return self.was.time_ns

    @property
    def was_active(self) -> bool:
        """It commanded the robot, or stopped it."""
        return self.was.said.state is not ArbiterState.STANDBY

    @property
    def was_stopping(self) -> bool:
        """It fell silent in the midst of a stop."""
        return self.was.said.state is ArbiterState.STOPPING

    @property
    def fell(self) -> str:
        """The end of the one in words."""
        return "ended, as it was told to" if self.was_told else "fell silent"

    @property
    def left(self) -> str:
        """The state of the gateway and of the robot in its last message, in words."""
        if self.speed_mps is None:
            return f"{self.was.said.state.value}, at a speed that is not in the log"
        motion = "standing" if self.speed_mps < STANDSTILL_MPS else f"at {self.speed_mps:.2f} m/s"
        return f"{self.was.said.state.value}, {motion}"


def last_silence(now: EvidenceWindow) -> GatewaySilence | None:
    """The last one that began before the moment; None if none is in these seconds."""
    return next((one for one in reversed(_silences(now)) if one.heard_ns < now.at_ns), None)


def next_silence(now: EvidenceWindow, within_ns: int) -> GatewaySilence | None:
    """The first one that begins at the moment or so soon after it, of a gateway that was not standing by."""
    soon = (one for one in _silences(now) if now.at_ns <= one.heard_ns <= now.at_ns + within_ns)
    return next((one for one in soon if one.was_active), None)


def _silences(now: EvidenceWindow) -> list[GatewaySilence]:
    """All of these seconds."""
    states = now.all(SafetyState)
    return [_silence(now, was, then) for was, then in pairwise(states) if is_other_run(was.said, then.said)]


def _silence(now: EvidenceWindow, was: Heard[SafetyState], then: Heard[SafetyState]) -> GatewaySilence:
    drive = now.last(Drive, was.time_ns)
    is_known = drive is not None and drive.time_ns > was.time_ns - _FRESH_NS
    speed_mps = drive.said.speed_mps if drive is not None and is_known else None
    ends = (one.said for one in now.all(SafetyEvent) if one.said.kind is EventKind.GATEWAY)
    is_told = any(is_same_run(one.tick, was.said.tick) for one in ends) and was.said.state is ArbiterState.STANDBY
    return GatewaySilence(was, then, speed_mps, next(now.after(Drive, then.time_ns), None), is_told)


def in_a_sentence(silence: GatewaySilence, at_ns: int) -> str:
    """For a headline."""
    fell, began = before(silence.heard_ns, at_ns), before(silence.then.time_ns, at_ns)
    return f"The gateway {silence.fell} {fell}, {silence.left}; another began {began}."


def guard_links(after: Sequence[Entry]) -> list[Link]:
    """The actions of the guard of a gateway that died, in its own words.

    Args:
        after: the entries from the next gateway's start on.
    """
    at_first = takewhile(lambda one: one.kind is not EntryKind.ENGAGED, after)
    told = [one for one in at_first if one.tells_of_guard or one.kind is EntryKind.LATCH]
    return [
        Link(Step.ACTION, f"the next gateway says of the guard: {_words(one)}", one.time_ns)
        for one in told
        if one.reason is Reason.GUARD
    ]


def _words(entry: Entry) -> str:
    """The guard's words, with their times; where none were kept, those of the gateway."""
    return entry.text.partition(f"{TEXTS[Reason.GUARD].means}; ")[2] or entry.text


def links(silence: GatewaySilence, guard: Sequence[Link]) -> Iterator[Link]:
    """The silence, its end, and what is known of the robot in between.

    Args:
        silence: of a gateway.
        guard: the known actions of its guard.
    """
    said = silence.was.said
    silent_ns = silence.then.time_ns - silence.heard_ns
    data = {
        "state": said.state.value,
        "lease_holder": said.lease_holder,
        "speed_mps": silence.speed_mps,
        "output_speed_mps": said.output_speed_mps,
        "guarded": said.guarded,
        "silent_ms": silent_ns / 1e6,
    }
    told = f"; it told the chassis {said.output_speed_mps:.2f} m/s" if said.state is ArbiterState.ENGAGED else ""
    yield Link(Step.CAUSE, f"the gateway {silence.fell}, {silence.left}{told}", silence.heard_ns, data)
    if not guard and silence.was_active and said.guarded:
        text = (
            "a guard watched the gateway, and is there to stop the robot in its place: what it did then is not in"
        )
        yield missing(f"{text} the log, for only the gateway tells of the bus")
    elif not guard and silence.was_active:
        yield missing(
            "no guard watched the gateway; what the chassis, which obeys its last command, did is not told"
        )
    text = f"another gateway began after {span(silent_ns)}: nothing of before holds any more"
    began = Link(Step.CAUSE, text, silence.then.time_ns)
    # The first thing that the other one says may be of the guard.
    yield from sorted([*guard, began], key=lambda link: link.time_ns or 0)
    if silence.was_active and silence.found is not None:
        found = silence.found
        after = span(found.time_ns - silence.heard_ns)
        text = (
            f"its first drive feedback, {after} after the other fell silent, said {found.said.speed_mps:.2f} m/s"
        )
        yield evidence(text, found.time_ns, speed_mps=found.said.speed_mps)
