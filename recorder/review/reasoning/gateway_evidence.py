"""Evidence from the gateway's own reports: its loop, its guard, the bus and its way to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from recorder.review.reasoning.chain import Link, count, evidence, missing, span
from recorder.review.reasoning.window import EvidenceWindow, Heard
from schemas.decisions import Decision, EventKind, SafetyEvent, SafetyState
from schemas.messages import ControllerState, Drive, GatewayHealth, Mode, RobotState
from schemas.reasons import Reason
from schemas.settings import (
    BEHIND_NS,
    FOUND_MOVING_NS,
    LOOP_LATE_STOP_NS,
    SAFETY_STATE_PERIOD_NS,
    SEND_FAILURES,
    STANDSTILL_MPS,
    TICK_NS,
)

_LEFT: Final = frozenset({EventKind.TAKEOVER, EventKind.GUARD})


def bus(window: EvidenceWindow) -> list[Link]:
    """The last frame that was received, and what the gateway says of the bus."""
    found = []
    heard = [frames[-1] for frames, _ in window.frames.values() if frames]
    if heard:
        last = max(heard, key=lambda frame: frame.time_ns)
        text = f"the last frame was received {window.ago(last.time_ns)}: {last}"
        found.append(evidence(text, last.time_ns, age_ms=(window.at_ns - last.time_ns) / 1e6))
    told = _health(window, lambda health: not health.bus_up)
    if told is not None:
        detail = f": {told.said.bus_detail}" if told.said.bus_detail else ""
        text = f"gateway/health, {window.ago(told.time_ns)}, says that {told.said.bus} is not there{detail}"
        found.append(evidence(text, told.time_ns, bus_losses=told.said.bus_losses))
    return found or [missing("neither frames nor a health of the gateway that tells of the bus are in the log")]


def controller(window: EvidenceWindow) -> list[Link]:
    """The state of the CAN controller, by the events and the health."""
    found = [
        evidence(f"{one.said.text}, {window.ago(one.time_ns)}", one.time_ns)
        for one in window.during(SafetyEvent)
        if one.time_ns <= window.at_ns
        and one.said.reason in {Reason.BUS_OFF, Reason.BUS_ERRORS}
        and one.said.kind is EventKind.FAULT
    ]
    told = _health(window, lambda health: health.controller is not ControllerState.UNKNOWN)
    if told is not None:
        errors = told.said.faults.get("error_frame", 0)
        text = f"gateway/health, {window.ago(told.time_ns)}: the controller is {told.said.controller.value}, "
        text += f"{count(errors, 'error frame')} since the start"
        found.append(evidence(text, told.time_ns, controller=told.said.controller.value, error_frames=errors))
    return found or [missing("what the CAN controller said before this is not in the log")]


def _health(window: EvidenceWindow, tells: Callable[[GatewayHealth], bool]) -> Heard[GatewayHealth] | None:
    """Return the first health from the moment on that reports it, else the last one before."""
    behind = next((one for one in window.after(GatewayHealth) if tells(one.said)), None)
    return behind or next((one for one in window.until(GatewayHealth) if tells(one.said)), None)


def load(window: EvidenceWindow) -> list[Link]:
    """The rate of frames, and the load of the gateway."""
    found = []
    if window.has_frames:
        text = f"{count(window.received, 'frame')} are in the log of the second before; "
        text += f"frames that are not all read for {span(BEHIND_NS)} are too many"
        waiting = sum(map(len, window.waiting.values()))
        text += f"; the arbiter had not been given {waiting} that the bus had" if waiting else ""
        found.append(evidence(text, window.at_ns, frames_per_s=window.received, waiting=waiting))
    health = window.last(GatewayHealth) or next(iter(window.after(GatewayHealth)), None)
    if health is not None:
        said = health.said
        text = (
            f"gateway/health, {window.ago(health.time_ns)}: {said.frames_per_s:.0f} frames a second, "
            f"{said.bus_drops} dropped unread since the start, {said.cpu_percent:.0f} % of a core"
        )
        found.append(
            evidence(
                text,
                health.time_ns,
                frames_per_s=said.frames_per_s,
                bus_drops=said.bus_drops,
                cpu_percent=said.cpu_percent,
            )
        )
    return found or [missing("neither raw frames nor a health of the gateway before this are in the log")]


def lateness(window: EvidenceWindow) -> list[Link]:
    """The lateness of the loop, and its load."""
    found = []
    health = next(iter(window.after(GatewayHealth)), None) or window.last(GatewayHealth)
    if health is not None:
        said = health.said
        text = (
            f"gateway/health, {window.ago(health.time_ns)}: the latest tick of its second was "
            f"{said.tick_lateness_max_ms:.0f} ms late, the median {said.tick_lateness_p50_ms:.1f} ms, with "
            f"{said.cpu_percent:.0f} % of a core; the limit is {span(LOOP_LATE_STOP_NS)}"
        )
        found.append(
            evidence(
                text,
                health.time_ns,
                tick_lateness_max_ms=said.tick_lateness_max_ms,
                limit_ms=LOOP_LATE_STOP_NS / 1e6,
            )
        )
    return found + pause(window)


def pause(window: EvidenceWindow) -> list[Link]:
    """A pause in the arbiter's states right before."""
    states = window.during(SafetyState)
    for was, now in zip(reversed(states[:-1]), reversed(states[1:]), strict=True):
        if was.time_ns > window.at_ns or now.time_ns < window.at_ns - 2 * 10**9:
            continue
        silent_ns, ticks = now.time_ns - was.time_ns, now.said.tick - was.said.tick
        if silent_ns > 2 * SAFETY_STATE_PERIOD_NS or silent_ns > (ticks + 5) * TICK_NS:
            text = (
                f"two states of the arbiter are {span(silent_ns)} apart there, and {count(ticks, 'tick')} of 10 ms"
            )
            return [evidence(text, was.time_ns, silent_ms=silent_ns / 1e6, ticks=ticks)]
    return []


def unsent(window: EvidenceWindow) -> list[Link]:
    """The last frames that went out, and how many of each burst."""
    sent = [frames[-1] for frames, _ in window.sent.values() if frames]
    found = []
    if sent:
        last = max(sent, key=lambda frame: frame.time_ns)
        text = f"the last frame that the bus took was sent {window.ago(last.time_ns)}: {last}; "
        text += f"{SEND_FAILURES} ticks in a row whose frames it does not take are a failure"
        found.append(
            evidence(text, last.time_ns, age_ms=(window.at_ns - last.time_ns) / 1e6, limit_ticks=SEND_FAILURES)
        )
    short = [
        one for one in window.until(Decision) if one.time_ns > window.at_ns - 10**9 and one.said.frames_sent < 5
    ]
    if short:
        least, most = (pick(one.said.frames_sent for one in short) for pick in (min, max))
        went = f"{least}" if least == most else f"{least} to {most}"
        text = (
            f"in the second before, {went} of five frames went out in {count(len(short), 'tick')} with a request"
        )
        found.append(evidence(text, short[0].time_ns, decisions=len(short), frames_sent_min=least))
    return found or [missing("which frames went out before this is not in the log")]


def guard_watch(window: EvidenceWindow) -> list[Link]:
    """Since when no guard watches."""
    first: Heard[SafetyState] | None = None
    for one in window.until(SafetyState):
        if one.said.guarded:
            break
        first = one
    if first is None:
        return [missing("the log holds no state of this time that says that no guard watches")]
    text = f"safety/state says that no guard watches, first {window.ago(first.time_ns)}"
    return [evidence(text, first.time_ns, before_ms=(window.at_ns - first.time_ns) / 1e6)]


def stray(window: EvidenceWindow) -> list[Link]:
    """Auto, and moving, and nobody commands."""
    drive, state = window.last(Drive), window.last(RobotState)
    if drive is None and state is None:
        return [missing("the chassis's speed and mode before this are not in the log")]
    found = []
    # That a guard is there, or is gone, is of its kind too, and has no reason.
    events = (one for one in window.until(SafetyEvent) if one.said.reason is not Reason.NONE)
    left = next((one for one in events if one.said.kind in _LEFT), None)
    if left is not None:
        text = f"it had been left to itself or to others {window.ago(left.time_ns)}: {left.said.text}"
        found.append(evidence(text, left.time_ns, reason=left.said.reason.value))
    if drive is not None:
        since: Heard[Drive] = drive
        for one in window.until(Drive):
            if one.said.speed_mps < STANDSTILL_MPS:
                break
            since = one
        text = f"the drive feedback said {drive.said.speed_mps:.2f} m/s, {window.ago(drive.time_ns)}"
        if drive.said.speed_mps >= STANDSTILL_MPS:
            text += f", and more than {STANDSTILL_MPS:g} m/s since {window.ago(since.time_ns)}"
        text += f"; in auto it may move for {span(FOUND_MOVING_NS)}, and not at all if it had been left"
        found.append(evidence(text, drive.time_ns, speed_mps=drive.said.speed_mps))
    if state is not None and state.said.mode is not Mode.UNDEFINED:
        text = f"the chassis's mode was {state.said.mode.value}, {window.ago(state.time_ns)}"
        found.append(evidence(text, state.time_ns, mode=state.said.mode.value))
    return found


def ending(window: EvidenceWindow) -> list[Link]:
    """The last state of the arbiter."""
    last = window.during(SafetyState)[-1:]
    if not last:
        return [missing("what the gateway said around its end is not in the log")]
    text = f"the last state of the arbiter in these seconds came {window.ago(last[0].time_ns)}"
    return [evidence(text, last[0].time_ns)]
