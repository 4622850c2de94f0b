"""The evidence for each reason: frames of the chassis, requests, and what the gateway says of itself."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

from gateway.chassis.layout import Within
from gateway.choice import CHASSIS
from recorder.review.window import (
    BODY,
    BY_IDENTIFIER,
    IDENTIFIERS,
    WHEELS,
    DecodedFrame,
    EvidenceWindow,
    Heard,
    Link,
    count,
    deg,
    evidence,
    missing,
    mps,
    signals,
    silence_ns,
    span,
)
from schemas.can_word import COUNTER_SPAN
from schemas.decisions import Decision, EventKind, SafetyEvent, SafetyState, Verdict
from schemas.messages import (
    Body,
    ControllerState,
    Drive,
    GatewayHealth,
    Mode,
    RobotState,
    Steering,
    Variant,
    WheelSpeed,
)
from schemas.reasons import TEXTS, Reason
from schemas.settings import (
    ALIVE_FAULTS,
    BEHIND_NS,
    CHECKSUM_FAULTS,
    CHECKSUM_WINDOW_NS,
    COMMANDER_NS,
    ENGAGE_TIMEOUT_NS,
    FOUND_MOVING_NS,
    FROZEN_BODY_M,
    IMPLAUSIBLE_FAULTS,
    IMPLAUSIBLE_MPS,
    IMPLAUSIBLE_NS,
    IMPLAUSIBLE_RATIO,
    LOOP_LATE_STOP_NS,
    OVERSPEED_MPS,
    OVERSPEED_NS,
    ROLLING_MPS,
    ROLLING_NS,
    SAFETY_STATE_PERIOD_NS,
    SEND_FAILURES,
    STANDSTILL_MPS,
    STEERING_DEVIATION_DEG,
    STEERING_DEVIATION_NS,
    TICK_NS,
)

_MODES: Final = {0: "auto", 1: "remote", 2: "stop"}

_ABSURD: Final = {signal: rule.maximum for _, signal, rule in CHASSIS.rules if isinstance(rule, Within)}

WAITED_NS: Final = 1_000_000
"""Reading a frame takes less; one that waited for longer is reported to have waited."""

LATELY_NS: Final = 3_000_000_000
"""A refusal that was longer ago is none of the moment's."""

_TOLD_NS: Final = SAFETY_STATE_PERIOD_NS + TICK_NS
"""Age at which a state of the arbiter may be out of date: it is repeated after its period."""

_RAW: Final = "the raw frames of this time"

_REQUESTS: Final = "the requests of this time, or some of them"


# Frames of the chassis.


def _turned(window: EvidenceWindow, signal: str, value: int, word: str, field: str, wanted: object) -> list[Link]:
    """The first of the last frames of the body that have this value; decoded ones, if no raw one is there."""
    first: DecodedFrame | None = None
    other: DecodedFrame | None = None
    for frame in reversed(window.frames_before(BODY)):
        if not frame.is_whole:
            continue
        if signals(frame)[signal] == value:
            first = frame
        elif first is not None or frame.time_ns < window.at_ns - _TOLD_NS:
            other = frame
            break
    if first is None:
        return _decoded(window, field, wanted)
    text = f"frame {first} said {signal} = {word}, {window.ago(first.time_ns)}{_waited(first)}"
    if other is not None:
        was = _MODES.get(int(signals(other)[signal]), "?") if signal == "Mode" else f"{signals(other)[signal]:g}"
        text += f"; the one {span(first.time_ns - other.time_ns)} earlier said {was}"
    before_ms = (window.at_ns - first.time_ns) / 1e6
    data = {"bytes": first.data.hex(), "signal": signal, "value": value, "before_ms": before_ms}
    return [evidence(text, first.time_ns, identifier=f"0x{first.identifier:08X}", **data)]


def _decoded(window: EvidenceWindow, field: str, wanted: object) -> list[Link]:
    first: Heard[Body] | None = None
    for one in window.until(Body):
        if getattr(one.said, field) != wanted:
            break
        first = one
    if first is None:
        return [missing("the frame of the body that shows it")]
    word = wanted.value if isinstance(wanted, Mode) else wanted
    text = f"chassis/body said {field} = {word}, {window.ago(first.time_ns)}"
    return [evidence(text, first.time_ns, signal=field, before_ms=(window.at_ns - first.time_ns) / 1e6)]


def _bumper(signal: str, field: str) -> Finder:
    return lambda window: _turned(window, signal, 1, "1", field, wanted=True)


def mode(window: EvidenceWindow, value: int) -> list[Link]:
    """The frame that first read a mode."""
    return _turned(window, "Mode", value, _MODES[value], "mode", Mode(_MODES[value]))


def _silence(window: EvidenceWindow) -> list[Link]:
    """The last frame of each that is missing, and its age against the limit."""
    state = window.last(RobotState)
    names = window.named_frames or (state.said.silent if state is not None else [])
    if not names or not window.frames:
        return [missing(_RAW if names else "the names of the frames that were missing")]
    return [_last_frame(window, name) for name in names if name in IDENTIFIERS]


def _last_frame(window: EvidenceWindow, name: str) -> Link:
    identifier = IDENTIFIERS[name]
    frames, waiting = window.frames_before(identifier), window.waiting.get(identifier, ())
    whole = [frame for frame in frames if frame.is_whole]
    late = ""
    if waiting:
        late = f"; the bus had {len(waiting)} more by then, the last {window.ago(waiting[-1].time_ns)}, "
        late += "which the arbiter had not been given"
    if not whole:
        more = f"; {count(len(frames), 'frame')} of it had a wrong checksum" if frames else ""
        text = f"no {name} (0x{identifier:08X}) came in the seconds before{more}{late}"
        return evidence(text, name=name)
    at = len(whole) - 1
    while at and whole[at].alive_counter == whole[at - 1].alive_counter:
        at -= 1  # It only repeated the counter of the one before.
    last, again, limit_ns = whole[at], len(whole) - 1 - at, silence_ns(name)
    age_ns = window.at_ns - last.time_ns
    data = {
        "name": name,
        "identifier": f"0x{identifier:08X}",
        "age_ms": age_ns / 1e6,
        "bus_age_ms": (age_ns + last.waited_ns) / 1e6,
        "limit_ms": limit_ns / 1e6,
        "waiting": len(waiting),
    }
    if age_ns <= limit_ns and not signals(last).get("Valid", True):
        valid = next((frame for frame in reversed(whole) if signals(frame)["Valid"]), None)
        since = f"the last valid one came {window.ago(valid.time_ns)}" if valid else "so did those before"
        text = f"{name} came, but said that it was not valid: {last}; {since}; the limit is {span(limit_ns)}"
        return evidence(text, last.time_ns, **data)
    wrong = sum(1 for frame in frames if frame.time_ns > last.time_ns and not frame.is_whole)
    more = f"; {count(again, 'frame')} after it only repeated its alive counter" if again else ""
    more += f"; {count(wrong, 'frame')} after it had a wrong checksum" if wrong else ""
    if age_ns <= limit_ns and not window.is_journaled:
        more += "; the times are the bus's: when the arbiter was given the frames is not in the log"
    text = (
        f"the last {name} came {window.ago(last.time_ns)}{_waited(last)}, the limit is {span(limit_ns)} "
        f"(its period is {BY_IDENTIFIER[identifier].period_ns / 1e6:.0f} ms): {last}{more}{late}"
    )
    return evidence(text, last.time_ns, bytes=last.data.hex(), **data)


def _waited(frame: DecodedFrame) -> str:
    """The time between the bus and the arbiter in words, to be put behind the frame's time."""
    return f" (the bus had it {span(frame.waited_ns)} earlier)" if frame.waited_ns >= WAITED_NS else ""


def _faulty(window: EvidenceWindow) -> list[Link]:
    """Wrong checksums, counters that do not rise, values that cannot be."""
    found = [link for name in window.named_frames or IDENTIFIERS for link in _faults(window, name)]
    return found or [missing(_RAW)]


def _faults(window: EvidenceWindow, name: str) -> Iterator[Link]:
    if not BY_IDENTIFIER[IDENTIFIERS[name]].is_feedback:
        return
    frames = window.frames_before(IDENTIFIERS[name])
    since_ns = window.at_ns - CHECKSUM_WINDOW_NS
    wrong = [frame for frame in frames if frame.time_ns >= since_ns and not frame.is_whole]
    if len(wrong) >= CHECKSUM_FAULTS:
        last = wrong[-1]
        text = (
            f"{count(len(wrong), 'frame')} of {name} had a wrong checksum in the second before, and "
            f"{CHECKSUM_FAULTS} are too many; the last {window.ago(last.time_ns)}: {last}; "
            f"its last byte should be {last.checksum:02X}"
        )
        data = {"faults": len(wrong), "limit": CHECKSUM_FAULTS, "bytes": last.data.hex()}
        yield evidence(text, last.time_ns, name=name, **data)
    counters = _alive_faults(frames)
    if counters >= ALIVE_FAULTS:
        seen = ", ".join(str(frame.alive_counter) for frame in [f for f in frames if f.is_whole][-8:])
        text = (
            f"the alive counter of {name} had {counters} faults (+1 for each wrong step, -1 for each right one), "
            f"and {ALIVE_FAULTS} are too many; the last counters read {seen}"
        )
        yield evidence(text, frames[-1].time_ns, name=name, alive_faults=counters, limit=ALIVE_FAULTS)
    yield from _absurd(window, name)


def _alive_faults(frames: Iterable[DecodedFrame]) -> int:
    """The fault count after these frames."""
    faults, expected = 0, None
    for frame in frames:
        if frame.is_whole:
            right = expected is None or frame.alive_counter == expected
            faults = max(0, faults - 1) if right else min(faults + 1, ALIVE_FAULTS)
            expected = (frame.alive_counter + 1) % COUNTER_SPAN
    return faults


def _absurd(window: EvidenceWindow, name: str) -> Iterator[Link]:
    """Frames with a right checksum and a value that this chassis cannot have."""
    found = []
    for frame in window.frames_before(IDENTIFIERS[name]):
        if frame.time_ns >= window.at_ns - CHECKSUM_WINDOW_NS and frame.is_whole:
            read = signals(frame, window.variant)
            found += [
                (frame, signal, read[signal]) for signal in _ABSURD if abs(read.get(signal, 0)) > _ABSURD[signal]
            ]
    if len(found) >= IMPLAUSIBLE_FAULTS:
        frame, signal, value = found[-1]
        text = (
            f"{name} said {signal} = {value:.2f}, beyond {_ABSURD[signal]:g}, the last time "
            f"{window.ago(frame.time_ns)}: {frame}; {IMPLAUSIBLE_FAULTS} of these in a second are too many"
        )
        yield evidence(text, frame.time_ns, name=name, signal=signal, value=float(value), limit=_ABSURD[signal])


_APART: Final = (
    f"over {IMPLAUSIBLE_MPS:g} m/s and a factor of {IMPLAUSIBLE_RATIO:g} "
    f"apart for {span(IMPLAUSIBLE_NS)} is too much"
)
_ROLLING: Final = (
    f"over {ROLLING_MPS:g} m/s for {span(ROLLING_NS)} where none is commanded, or against the command, is rolling"
)
_OVERSPEED: Final = f"{OVERSPEED_MPS:g} m/s over the limit in force for {span(OVERSPEED_NS)} is too fast"


def _speeds(rule: str) -> Finder:
    """Wheels, drive feedback and command side by side, and the rule that they broke."""

    def found(window: EvidenceWindow) -> list[Link]:
        wheels, drive, state = window.last(WheelSpeed), window.last(Drive), _state_before(window)
        if wheels is None or drive is None:
            return [missing("the speeds of the chassis before this")]
        mean_mps = (wheels.said.rear_left_speed_mps + wheels.said.rear_right_speed_mps) / 2
        told_mps = None if state is None else state.said.output_speed_mps
        commanded = "" if told_mps is None else f", commanded was {mps(told_mps)}"
        text = (
            f"the rear wheels turned at {mean_mps:.2f} m/s, the drive feedback said {drive.said.speed_mps:.2f} m/s"
        )
        data = {"wheel_speed_mps": mean_mps, "drive_speed_mps": drive.said.speed_mps, "output_speed_mps": told_mps}
        return [evidence(f"{text}{commanded}{rule and '; '}{rule}", wheels.time_ns, **data)]

    return found


def _implausible(window: EvidenceWindow) -> list[Link]:
    """Values that cannot be; else speeds that are too far apart."""
    absurd = [link for name in ("Auto_DriveFeedBack", "Auto_WheelSpdFeedback") for link in _absurd(window, name)]
    return absurd or _speeds(_APART)(window)


def _steering(window: EvidenceWindow) -> list[Link]:
    """The steering angle beside those that were commanded while it did not follow."""
    seen = window.last(Steering)
    since_ns = window.at_ns - STEERING_DEVIATION_NS
    told = [
        one.said.output_angle_deg for one in window.until(SafetyState) if since_ns <= one.time_ns < window.at_ns
    ]
    if seen is None or not told:
        return [missing("the steering angle, or what was commanded before this")]
    commanded = deg(told[0]) if max(told) - min(told) < 0.1 else f"{deg(min(told))} to {deg(max(told))}"
    text = f"the steering read {deg(seen.said.angle_deg)}, commanded was {commanded}; over "
    text += f"{STEERING_DEVIATION_DEG:g} deg beside that for {span(STEERING_DEVIATION_NS)} does not follow"
    return [evidence(text, seen.time_ns, angle_deg=seen.said.angle_deg, output_angle_deg=told[0])]


def _frozen(window: EvidenceWindow) -> list[Link]:
    """The mileage that stood still while the robot drove."""
    body = window.last(Body)
    if body is None or "mileage" not in window.detail:
        return _speeds("")(window)
    text = f"the mileage read {body.said.total_mileage_km:.3f} km, and did not change over {FROZEN_BODY_M:g} m"
    return [evidence(text, body.time_ns, total_mileage_km=body.said.total_mileage_km)]


def _state_before(window: EvidenceWindow) -> Heard[SafetyState] | None:
    return next((one for one in window.until(SafetyState) if one.time_ns < window.at_ns), None)


def _commanders(window: EvidenceWindow) -> list[Link]:
    """Command frames on the bus that the gateway did not send."""
    near = window.commands_between(window.at_ns - COMMANDER_NS, window.at_ns + 1)
    if not near:
        return [missing("the frames of the other computer")]
    last = near[-1]
    text = f"{count(len(near), 'command frame')} that this gateway did not send came in the "
    text += f"{span(COMMANDER_NS)} up to {window.what}; the last: {last}"
    first_before_ms = (window.at_ns - near[0].time_ns) / 1e6
    return [evidence(text, last.time_ns, frames=len(near), first_before_ms=first_before_ms)]


def _variant(window: EvidenceWindow) -> list[Link]:
    """The wheel speed frame that shows the scale, and the gateway's conclusion."""
    found = []
    state = window.last(RobotState)
    if state is not None:
        text = f"the gateway took the firmware variant for {state.said.variant.value}"
        found.append(evidence(text, state.time_ns, variant=state.said.variant.value))
    frames = [frame for frame in window.frames_before(WHEELS) if frame.is_whole]
    if not frames:
        return [*found, missing("a wheel speed frame, which would tell the scale")]
    coarse, fine = (signals(frames[-1], one)["RearLeftSpeed"] for one in (Variant.COARSE, Variant.FINE))
    text = f"the last wheel speed frame reads {coarse:.2f} m/s if coarse and {fine:.2f} m/s if fine: {frames[-1]}"
    return [*found, evidence(text, frames[-1].time_ns, coarse_mps=float(coarse), fine_mps=float(fine))]


# What the gateway says of itself.


def _bus(window: EvidenceWindow) -> list[Link]:
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
    return found or [missing(_RAW)]


def _controller(window: EvidenceWindow) -> list[Link]:
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
    return found or [missing("the state of the CAN controller")]


def _health(
    window: EvidenceWindow, tells: Callable[[GatewayHealth], bool] = lambda _: True
) -> Heard[GatewayHealth] | None:
    """Return the first health behind the moment that reports it, else the last one before."""
    behind = next((one for one in window.after(GatewayHealth) if tells(one.said)), None)
    return behind or next((one for one in window.until(GatewayHealth) if tells(one.said)), None)


def _load(window: EvidenceWindow) -> list[Link]:
    """The rate of frames, and the load of the gateway."""
    found = []
    if window.frames:
        waiting = sum(map(len, window.waiting.values()))
        text = f"{count(window.received, 'frame')} are in the log of the second before; "
        text += f"frames that are not all read for {span(BEHIND_NS)} are too many"
        text += f"; the arbiter had not been given {waiting} that the bus had" if waiting else ""
        found.append(evidence(text, window.at_ns, frames_per_s=window.received, waiting=waiting))
    health = window.last(GatewayHealth) or _health(window)
    if health is not None:
        said = health.said
        text = f"gateway/health, {window.ago(health.time_ns)}: {said.frames_per_s:.0f} frames a second, "
        text += f"{said.bus_drops} dropped unread since the start, {said.cpu_percent:.0f} % of a core"
        data = {"frames_per_s": said.frames_per_s, "bus_drops": said.bus_drops, "cpu_percent": said.cpu_percent}
        found.append(evidence(text, health.time_ns, **data))
    return found or [missing(_RAW)]


def _lateness(window: EvidenceWindow) -> list[Link]:
    """The lateness of the loop, and a pause in the arbiter's states."""
    found = []
    health = _health(window)
    if health is not None:
        said = health.said
        text = (
            f"gateway/health, {window.ago(health.time_ns)}: the latest tick of its second was "
            f"{said.tick_lateness_max_ms:.0f} ms late, the median {said.tick_lateness_p50_ms:.1f} ms, with "
            f"{said.cpu_percent:.0f} % of a core; the limit is {span(LOOP_LATE_STOP_NS)}"
        )
        data = {"tick_lateness_max_ms": said.tick_lateness_max_ms, "limit_ms": LOOP_LATE_STOP_NS / 1e6}
        found.append(evidence(text, health.time_ns, **data))
    states = window.during(SafetyState)
    for was, now in zip(reversed(states[:-1]), reversed(states[1:]), strict=True):
        silent_ns, ticks = now.time_ns - was.time_ns, now.said.tick - was.said.tick
        is_near = was.time_ns <= window.at_ns and now.time_ns >= window.at_ns - 2 * 10**9
        if is_near and (silent_ns > 2 * SAFETY_STATE_PERIOD_NS or silent_ns > (ticks + 5) * TICK_NS):
            text = (
                f"two states of the arbiter are {span(silent_ns)} apart there, and {count(ticks, 'tick')} of 10 ms"
            )
            return [*found, evidence(text, was.time_ns, silent_ms=silent_ns / 1e6, ticks=ticks)]
    return found


def _unsent(window: EvidenceWindow) -> list[Link]:
    """The last frames that went out, and how many of each burst."""
    found = []
    sent = [frames[-1] for frames, _ in window.sent.values() if frames]
    if sent:
        last = max(sent, key=lambda frame: frame.time_ns)
        text = f"the last frame that the bus took was sent {window.ago(last.time_ns)}: {last}; "
        text += f"{SEND_FAILURES} ticks in a row whose frames it does not take are a failure"
        age_ms = (window.at_ns - last.time_ns) / 1e6
        found.append(evidence(text, last.time_ns, age_ms=age_ms, limit_ticks=SEND_FAILURES))
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
    return found or [missing("the frames that went out before this")]


def _unguarded(window: EvidenceWindow) -> list[Link]:
    """Since when no guard watches."""
    states = list(window.until(SafetyState))
    gone = next((at for at, one in enumerate(states) if one.said.guarded), len(states))
    if not gone:
        return [missing("a state that says that no guard watches")]
    first = states[gone - 1]
    text = f"safety/state says that no guard watches, first {window.ago(first.time_ns)}"
    text += "; the guard is gone, and another is being started" if gone < len(states) else ""
    return [evidence(text, first.time_ns, before_ms=(window.at_ns - first.time_ns) / 1e6)]


def _found_moving(window: EvidenceWindow) -> list[Link]:
    """Auto, and moving, and no client commands."""
    drive, state = window.last(Drive), window.last(RobotState)
    found = []
    # That a guard is there, or is gone, is of its kind too, and has no reason.
    events = (one for one in window.until(SafetyEvent) if one.said.reason is not Reason.NONE)
    left = next((one for one in events if one.said.kind in {EventKind.TAKEOVER, EventKind.GUARD}), None)
    if left is not None:
        text = f"it had been left to itself or to others {window.ago(left.time_ns)}: {left.said.text}"
        found.append(evidence(text, left.time_ns, reason=left.said.reason.value))
    if drive is not None:
        text = f"the drive feedback said {drive.said.speed_mps:.2f} m/s, {window.ago(drive.time_ns)}"
        if drive.said.speed_mps >= STANDSTILL_MPS:
            still = next((one.time_ns for one in window.until(Drive) if one.said.speed_mps < STANDSTILL_MPS), 0)
            since = next(one for one in window.during(Drive) if one.time_ns > still)
            text += f", and more than {STANDSTILL_MPS:g} m/s since {window.ago(since.time_ns)}"
        text += f"; in auto it may move for {span(FOUND_MOVING_NS)}, and not at all if it had been left"
        found.append(evidence(text, drive.time_ns, speed_mps=drive.said.speed_mps))
    if state is not None and state.said.mode is not Mode.UNDEFINED:
        text = f"the chassis's mode was {state.said.mode.value}, {window.ago(state.time_ns)}"
        found.append(evidence(text, state.time_ns, mode=state.said.mode.value))
    return [*(found or [missing("the chassis's speed and mode before this")]), *mode(window, 0)]


def _ending(window: EvidenceWindow) -> list[Link]:
    """The last state of the arbiter."""
    last = window.during(SafetyState)[-1:]
    text = "the last state of the arbiter in these seconds came "
    return [evidence(f"{text}{window.ago(one.time_ns)}", one.time_ns) for one in last]


# Requests.

_FRESH: Final = frozenset({Reason.NONE, Reason.NOT_ENGAGED, Reason.ENGAGING, Reason.STOPPING})
"""Outcomes of a fresh drive command of the holder: it keeps the lease, executed or not."""

_RENEWING: Final = frozenset({"acquire", "take", "renew", "engage", "reset"})
"""Requests that keep the lease, once accepted."""

_LATCHED_THOUGH_REFUSED: Final = frozenset(
    {
        Reason.BUS_DOWN,
        Reason.BUS_OFF,
        Reason.SEND_FAILED,
        Reason.HAND_TRANSMITTER,
        Reason.OTHER_COMMANDER,
        Reason.FEEDBACK_MISSING,
    }
)
"""Refusals of a stop that was latched all the same: it could not be carried out, or was not seen to be."""

_COUNTED: Final = re.compile(r"none for (\d+) ms")

_LEFT: Final = frozenset({EventKind.STOPPED, EventKind.TAKEOVER, EventKind.GUARD})


def _deadman(window: EvidenceWindow) -> list[Link]:
    """The last acceptable drive command, its age, and its successors.

    A decision is told some time after its tick has begun, from which the arbiter counts: its own figure, in the
    detail, is the right one.
    """
    limit_ns, origin = round(window.limits.command.deadman_s * 1e9), window.limits.origin
    state = window.last(SafetyState)
    if state is not None and state.said.deadman_s * 1e9 > limit_ns:
        limit_ns, origin = round(state.said.deadman_s * 1e9), "as engage asked for"
    limit = f"the limit is {span(limit_ns)} ({origin})"
    last = _last(window, _is_obeyed)
    engaged = next((one for one in window.until(SafetyEvent) if one.said.kind is EventKind.ENGAGED), None)
    if last is not None and (engaged is None or last.time_ns >= engaged.time_ns):
        said, age_ns = last.said, window.at_ns - last.time_ns
        counted = _COUNTED.search(window.detail)
        counted_ms = None if counted is None else float(counted[1])
        by_arbiter = ""
        if counted_ms is not None and span(counted_ms * 1e6) != span(age_ns):
            by_arbiter = f", {span(counted_ms * 1e6)} as the arbiter counts"
        text = (
            f"the last acceptable drive command was seq {said.request_sequence} of {_who(said)}, judged in tick "
            f"{said.tick}, {window.ago(last.time_ns)}{by_arbiter}: {_asked(said)}; {limit}"
        )
        numbers = {**_numbers(said), "silent_ms": age_ns / 1e6, "counted_ms": counted_ms}
        link = evidence(text, last.time_ns, **numbers, limit_ms=limit_ns / 1e6)
        return [link, *_since(window, last.time_ns)]
    if engaged is not None and window.during(Decision):
        text = f"no drive command was accepted since it was engaged, {window.ago(engaged.time_ns)}; {limit}"
        link = evidence(text, engaged.time_ns, limit_ms=limit_ns / 1e6)
        return [link, *_since(window, engaged.time_ns)]
    return [missing(_REQUESTS)]


def _since(window: EvidenceWindow, from_ns: int) -> list[Link]:
    """The drive commands that were refused since then, by reason; or that none came."""
    refused: dict[Reason, list[Heard[Decision]]] = {}
    for one in window.during(Decision):
        if from_ns < one.time_ns <= window.at_ns and one.said.request == "drive" and not _is_accepted(one.said):
            refused.setdefault(one.said.reason, []).append(one)
    found = [_refusals(window, heard) for heard in refused.values()]
    if not found and not window.lacks_decisions:
        found = [evidence("no drive command at all came after it, neither good nor bad")]
    return found + _holes(window)


def _refusals(window: EvidenceWindow, heard: Sequence[Heard[Decision]]) -> Link:
    last = heard[-1]
    said = last.said
    verb = said.request or "nameless"
    text = f"one {verb} request of {_who(said)} was refused {window.ago(last.time_ns)}"
    if len(heard) > 1:
        text = f"{len(heard)} {verb} requests of {_who(said)} were refused, the first "
        text += f"{span(last.time_ns - heard[0].time_ns)} before the last, which was {window.ago(last.time_ns)}"
    text += f": {said.detail or TEXTS[said.reason].means}"
    if said.request_sequence is not None:
        age = "" if said.age_ms is None else f", {said.age_ms:.0f} ms old"
        text += f" (seq {said.request_sequence}{age})"
    return evidence(text, last.time_ns, **_numbers(said), count=len(heard), reason=said.reason.value)


def _refused(reason: Reason) -> Finder:
    """The requests that were refused for this reason lately; nothing if none was."""

    def found(window: EvidenceWindow) -> list[Link]:
        by_who: dict[tuple[str, str], list[Heard[Decision]]] = {}
        for one in window.during(Decision):
            if one.time_ns <= window.at_ns and one.said.reason is reason:
                by_who.setdefault((one.said.operator, one.said.request), []).append(one)
        return [_refusals(window, heard) for heard in by_who.values()]

    return found


def refused_lately(window: EvidenceWindow) -> list[Link]:
    """All that was refused right before the moment."""
    alike: dict[tuple[str, str, Reason], list[Heard[Decision]]] = {}
    for one in window.all(Decision):
        if window.at_ns - LATELY_NS < one.time_ns <= window.at_ns and not _is_accepted(one.said):
            alike.setdefault((one.said.operator, one.said.request, one.said.reason), []).append(one)
    return [_refusals(window, heard) for heard in alike.values()]


def _lease_expired(window: EvidenceWindow) -> list[Link]:
    """The last sign of the lease's holder, and its age."""
    limit_ns = round(window.limits.command.lease_s * 1e9)
    last = _last(window, _is_renewing)
    if last is None:
        return [missing(_REQUESTS)]
    said = last.said
    text = f"the last request that kept the lease was {said.request} of {_who(said)}, {window.ago(last.time_ns)}; "
    text += f"a lease lasts {span(limit_ns)} ({window.limits.origin})"
    silent_ms = (window.at_ns - last.time_ns) / 1e6
    link = evidence(text, last.time_ns, **_numbers(said), silent_ms=silent_ms, limit_ms=limit_ns / 1e6)
    return [link, *_holes(window)]


def _asked_for(*verbs: str) -> Finder:
    """The request that did it: one that was accepted, or a stop that was latched although it was refused."""

    def did_it(said: Decision) -> bool:
        is_latched = said.request == "stop" and said.reason in _LATCHED_THOUGH_REFUSED
        return said.request in verbs and (_is_accepted(said) or is_latched)

    def found(window: EvidenceWindow) -> list[Link]:
        last = _last(window, did_it, later_ns=3 * TICK_NS)
        if last is None:
            return [missing(f"the request itself ({' or '.join(verbs)})")]
        said = last.said
        text = f"the request was {said.request}, of {_who(said)}, judged in tick {said.tick}"
        text += f", {window.ago(last.time_ns)}" if abs(last.time_ns - window.at_ns) > TICK_NS else ""
        text += "" if _is_accepted(said) else f"; it was refused: {said.detail or TEXTS[said.reason].means}"
        later = [one for one in window.during(Decision) if last.time_ns < one.time_ns < window.over_ns]
        others = sum(did_it(one.said) for one in later)
        text += f"; {others} more came after it" if others else ""
        return [evidence(text, last.time_ns, **_numbers(said))]

    return found


def _not_confirmed(window: EvidenceWindow) -> list[Link]:
    """The request to engage, the time that the chassis was given, and its mode."""
    last = _last(window, lambda said: said.request in {"engage", "clear_odometer"} and _is_accepted(said))
    modes = [link for value in (2, 1) for link in mode(window, value) if link.time_ns]
    if last is None:
        return [missing("the request that the chassis was to confirm"), *modes]
    text = f"the request was {last.said.request}, of {_who(last.said)}, {window.ago(last.time_ns)}; "
    text += f"it has {span(ENGAGE_TIMEOUT_NS)}"
    age_ms = (window.at_ns - last.time_ns) / 1e6
    data = {"age_ms": age_ms, "limit_ms": ENGAGE_TIMEOUT_NS / 1e6}
    return [evidence(text, last.time_ns, **_numbers(last.said), **data), *modes]


def last_command(window: EvidenceWindow) -> Heard[Decision] | None:
    """Return the last acceptable drive command to an engaged robot: earlier ones do not count."""
    left, last = _left_or_engaged(window), _last(window, _is_obeyed)
    return None if last is None or (left is not None and last.said.tick <= left.said.tick) else last


def describe_command(window: EvidenceWindow) -> list[Link]:
    """The command at the moment, its operator, and what bound it."""
    last = last_command(window)
    if last is None:
        left = _left_or_engaged(window)
        if left is None:
            return [missing(_REQUESTS)]
        text = f"no drive command was accepted since it was engaged, {window.ago(left.time_ns)}"
        return [evidence(text), *_holes(window)] if left.said.kind is EventKind.ENGAGED else []
    said = last.said
    text = f"the last acceptable drive command, seq {said.request_sequence} of {_who(said)}, came "
    text += f"{window.ago(last.time_ns)} and asked for {_asked(said)}; "
    text += f"commanded was {mps(said.output_speed_mps)}, {deg(said.output_angle_deg)}" if said.frames_sent else ""
    text += "" if said.frames_sent else "no frame went out in its tick"
    if said.bound_by:
        text += f"; bound by: {', '.join(bound.value.replace('_', ' ') for bound in said.bound_by)}"
    return [evidence(text, last.time_ns, **_numbers(said), bound_by=[bound.value for bound in said.bound_by])]


def _left_or_engaged(window: EvidenceWindow) -> Heard[SafetyEvent] | None:
    """The event with which the last drive commands began, or ended, to count."""
    for one in window.until(SafetyEvent):
        # That a guard is there, or is gone, has no reason.
        if one.said.kind is EventKind.ENGAGED or (one.said.kind in _LEFT and one.said.reason is not Reason.NONE):
            return one
    return None


def _last(window: EvidenceWindow, test: Callable[[Decision], bool], later_ns: int = 0) -> Heard[Decision] | None:
    """Return the last decision of this sort; one of the moment's own tick comes a bit later than the event."""
    return next((one for one in window.until(Decision, window.at_ns + later_ns) if test(one.said)), None)


def _is_accepted(said: Decision) -> bool:
    return said.verdict is Verdict.ACCEPTED


def _is_obeyed(said: Decision) -> bool:
    return said.request == "drive" and _is_accepted(said)


def _is_renewing(said: Decision) -> bool:
    if said.request == "drive":
        return said.reason in _FRESH
    return said.request in _RENEWING and _is_accepted(said)


def _asked(said: Decision) -> str:
    speed, angle = said.requested_speed_mps, said.requested_angle_deg
    return "nothing that the log holds" if speed is None or angle is None else f"{mps(speed)}, {deg(angle)}"


def _who(said: Decision) -> str:
    return said.operator or "an unnamed operator"


def _numbers(said: Decision) -> dict[str, object]:
    return {
        "request": said.request,
        "operator": said.operator,
        "tick": said.tick,
        "request_sequence": said.request_sequence,
        "age_of_echo_ms": said.age_ms,
        "requested_speed_mps": said.requested_speed_mps,
        "requested_angle_deg": said.requested_angle_deg,
    }


def _holes(window: EvidenceWindow) -> list[Link]:
    lacks = window.lacks_decisions
    return [missing(f"{count(lacks, 'decision')} of these seconds")] if lacks else []


Finder = Callable[[EvidenceWindow], list[Link]]
"""The window around the moment at which a reason arose to links."""


def _nothing(_window: EvidenceWindow) -> list[Link]:
    return []


EVIDENCE: Final[dict[Reason, Finder]] = {
    Reason.LEASE_TAKEN: _asked_for("take"),
    Reason.LEASE_RELEASED: _asked_for("release"),
    Reason.LEASE_EXPIRED: _lease_expired,
    Reason.DEADMAN: _deadman,
    Reason.NOT_CONFIRMED: _not_confirmed,
    Reason.DISENGAGED: _asked_for("disengage"),
    Reason.REMOTE_STOP: _asked_for("stop"),
    Reason.BUS_DOWN: _bus,
    Reason.BUS_OFF: _controller,
    Reason.BUS_ERRORS: _controller,
    Reason.FEEDBACK_MISSING: _silence,
    Reason.FEEDBACK_FAULTY: _faulty,
    Reason.FEEDBACK_LATE: _load,
    Reason.VARIANT_UNKNOWN: _variant,
    Reason.HAND_TRANSMITTER: lambda window: mode(window, 1),
    Reason.MODE_NOT_AUTO: lambda window: mode(window, 2),
    Reason.FRONT_BUMPER: _bumper("FrontBumper", "front_bumper"),
    Reason.REAR_BUMPER: _bumper("RearBumper", "rear_bumper"),
    Reason.IMPLAUSIBLE_SPEED: _implausible,
    Reason.NOT_MOVING: _speeds(""),
    Reason.BRAKE_SLIPS: _speeds(_ROLLING),
    Reason.ROLLING: _speeds(_ROLLING),
    Reason.OVERSPEED: _speeds(_OVERSPEED),
    Reason.STEERING: _steering,
    Reason.FEEDBACK_FROZEN: _frozen,
    Reason.FOUND_MOVING: _found_moving,
    Reason.OTHER_COMMANDER: _commanders,
    Reason.LOOP_LATE: _lateness,
    Reason.SEND_FAILED: _unsent,
    Reason.GATE: _unsent,
    Reason.UNGUARDED: _unguarded,
    Reason.NO_REALTIME: _load,
    Reason.SHUTDOWN: _ending,
    # Their own words say all.
    **dict.fromkeys((Reason.NONE, Reason.GUARD, Reason.GRANT_EXPIRED, Reason.GRANT_REVOKED), _nothing),
}
"""The finder of each reason; of every other one it is the requests that were refused for it."""


def evidence_of(reason: Reason) -> Finder:
    """The finder of the evidence for a reason."""
    return EVIDENCE.get(reason) or _refused(reason)
