"""The course of a stop, by the arbiter's states and the chassis's feedback."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, takewhile
from typing import Final

from recorder.review.chain import Link, Step, missing, span
from recorder.review.window import EvidenceWindow, Heard
from schemas.decisions import ArbiterState, EventKind, SafetyEvent, SafetyState, StopPhase
from schemas.messages import Drive
from schemas.reasons import Reason
from schemas.settings import STANDSTILL_MPS, STANDSTILL_TICKS, TICK_NS

_PHASES: Final = {
    StopPhase.BRAKE: "zero speed",
    StopPhase.PARK: "parking brake",
    StopPhase.NEUTRAL: "neutral",
    StopPhase.HOLD: "hold",
    StopPhase.DISABLE: "enables off",
}

_DOUBTFUL: Final = frozenset({Reason.IMPLAUSIBLE_SPEED, Reason.VARIANT_UNKNOWN})
"""Reasons for which the reported speeds of the chassis are not to be believed."""

_UNSEEN_NS: Final = 150_000_000
"""Without drive feedback for so long, how far the robot came is not known."""

_STANDS_NS: Final = STANDSTILL_TICKS * TICK_NS


def actions(window: EvidenceWindow, reason: Reason) -> Iterator[Link]:
    """The course of a stop that began at the moment, for this reason."""
    states = list(window.after(SafetyState, window.at_ns - 1))
    stopping = list(takewhile(lambda one: one.said.state is ArbiterState.STOPPING, states))
    if stopping:
        yield from _ramp(window, stopping)
        yield from _phases(window, stopping)
    elif reason is Reason.GUARD:
        yield Link(Step.ACTION, "the gateway sends nothing: the guard has the chassis, and stops it", window.at_ns)
    elif states and states[0].said.state is ArbiterState.STANDBY:
        text = "the gateway sends nothing: the remote control, or the last command, moves the chassis"
        yield Link(Step.ACTION, text, states[0].time_ns)
    else:
        yield missing("the arbiter's states after this")
    over_ns = window.over_ns
    yield from standstill(window, over_ns, is_doubtful=reason in _DOUBTFUL)
    ended = next((one for one in window.after(SafetyEvent) if one.said.kind is EventKind.STOPPED), None)
    if ended is not None and ended.time_ns < over_ns:
        after_ns = ended.time_ns - window.at_ns
        text = f"{ended.said.text}, after {span(after_ns)}"
        yield Link(Step.ACTION, text, ended.time_ns, {"after_s": after_ns / 1e9})


def _ramp(window: EvidenceWindow, stopping: Sequence[Heard[SafetyState]]) -> Iterator[Link]:
    """The ramp of the commanded speed."""
    was = next((one for one in window.until(SafetyState) if one.time_ns < window.at_ns), None)
    zero = next((one for one in stopping if not one.said.output_speed_mps), None)
    from_mps = 0.0 if was is None else was.said.output_speed_mps
    if was is None:
        yield missing("what was commanded before this")
    elif not from_mps:
        never = was.said.state is ArbiterState.STANDBY
        text = "nothing had been commanded until then" if never else "the commanded speed was zero already"
        yield Link(Step.ACTION, text, stopping[0].time_ns)
    elif zero is None:
        yield missing("the end of the ramp of the commanded speed")
    else:
        slope_mps2, took_ns = _slope_mps2(stopping), zero.time_ns - window.at_ns
        text = f"the commanded speed went from {from_mps:.2f} m/s to zero"
        if took_ns <= 2 * TICK_NS:
            text += " at once"
        else:
            said = stopping[0].said
            rules = (said.emergency_deceleration_mps2, "emergency"), (said.deceleration_limit_mps2, "normal")
            near = [name for limit, name in rules if slope_mps2 is not None and abs(slope_mps2 - limit) < 0.15]
            text += "" if slope_mps2 is None else f" at {slope_mps2:.1f} m/s2"
            text += f", the {near[-1]} deceleration," if near else ""
            text += f" in {span(took_ns)}"
        data = {"from_mps": from_mps, "deceleration_mps2": slope_mps2, "took_s": took_ns / 1e9}
        yield Link(Step.ACTION, text, window.at_ns, data)


def _slope_mps2(stopping: Sequence[Heard[SafetyState]]) -> float | None:
    """The deceleration of the commanded speed, from states in the ramp; None if there are not two."""
    ramp = [one.said for one in stopping if one.said.output_speed_mps]
    if len(ramp) < 2 or ramp[-1].tick <= ramp[0].tick:
        return None
    fallen_mps = abs(ramp[0].output_speed_mps) - abs(ramp[-1].output_speed_mps)
    return fallen_mps / ((ramp[-1].tick - ramp[0].tick) * TICK_NS / 1e9)


def _phases(window: EvidenceWindow, stopping: Sequence[Heard[SafetyState]]) -> Iterator[Link]:
    """The beginning of each phase of the stop."""
    begun: dict[StopPhase, int] = {}
    for one in stopping:
        begun.setdefault(one.said.stop_phase, one.time_ns - window.at_ns)
    parts = [
        f"{words} {f'after {span(begun[phase])}' if begun[phase] > TICK_NS else 'at once'}"
        for phase, words in _PHASES.items()
        if phase in begun
    ]
    if parts:
        data = {f"{phase.value}_after_s": after_ns / 1e9 for phase, after_ns in begun.items()}
        yield Link(Step.ACTION, ", ".join(parts), stopping[0].time_ns, data)


def standstill(window: EvidenceWindow, over_ns: int, *, is_doubtful: bool) -> Iterator[Link]:
    """The standstill of the chassis, and its way until then, by its drive feedback until this was over."""
    before = window.last(Drive)
    way = [
        *([before] if before is not None else []),
        *takewhile(lambda one: one.time_ns < over_ns, window.after(Drive)),
    ]
    if len(way) < 2:
        yield missing("the drive feedback of this time")
        return
    if way[0].said.speed_mps < STANDSTILL_MPS:
        text = f"the robot stood already, by its drive feedback{_moved_again(way, way[0])}"
        yield Link(Step.ACTION, text, way[0].time_ns)
        return
    metres, stood, unseen_ns = 0.0, None, 0
    for was, now in pairwise(way):
        if now.said.speed_mps >= STANDSTILL_MPS:
            stood = None
        elif stood is None:
            stood = now
        if stood is not None and now.time_ns - stood.time_ns >= _STANDS_NS:
            break
        begin_ns = max(was.time_ns, window.at_ns)
        unseen_ns = max(unseen_ns, now.time_ns - was.time_ns)
        metres += (was.said.speed_mps + now.said.speed_mps) / 2 * max(0, now.time_ns - begin_ns) / 1e9
    if stood is None:
        last = way[-1]
        text = f"the last drive feedback, {window.ago(last.time_ns)}, still said {last.said.speed_mps:.2f} m/s"
        yield Link(Step.ACTION, text, last.time_ns)
        return
    took_ns = stood.time_ns - window.at_ns
    text = f"the robot, at {way[0].said.speed_mps:.2f} m/s, was slower than {STANDSTILL_MPS:g} m/s after "
    text += f"{span(took_ns)}"
    is_known = unseen_ns <= _UNSEEN_NS and not is_doubtful
    if is_known:
        text += f" and {metres:.2f} m"
    else:
        why = "the speeds are in doubt" if is_doubtful else f"no drive feedback for {span(unseen_ns)}"
        text += f"; {why}: the distance is not known"
    data = {
        "from_mps": way[0].said.speed_mps,
        "after_s": took_ns / 1e9,
        "distance_m": metres if is_known else None,
    }
    yield Link(Step.ACTION, text + _moved_again(way, stood), stood.time_ns, data)


def _moved_again(way: Sequence[Heard[Drive]], stood: Heard[Drive]) -> str:
    """Words for a robot that did not stay where it stood; empty if it did."""
    moving = [one for one in way if one.time_ns > stood.time_ns and one.said.speed_mps >= STANDSTILL_MPS]
    if not moving:
        return ""
    fastest_mps = max(one.said.speed_mps for one in moving)
    return f"; it moved again {span(moving[0].time_ns - stood.time_ns)} later, at up to {fastest_mps:.2f} m/s"
