"""Evidence from raw frames of the chassis: bumpers, modes, silence, checksums, counters, values, other senders."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from recorder.review.reasoning.chain import Link, count, evidence, missing, span
from recorder.review.reasoning.signals import (
    BODY,
    BY_IDENTIFIER,
    IDENTIFIERS,
    WHEELS,
    DecodedFrame,
    signals,
    silence_ns,
)
from recorder.review.reasoning.window import EvidenceWindow, Heard
from schemas.alive_counter import COUNTER_SPAN
from schemas.cruiser import SPEED_PLAUSIBLE_MPS, STEERING_PLAUSIBLE_DEG
from schemas.decisions import SafetyState
from schemas.messages import Body, Drive, Mode, RobotState, Steering, Variant, WheelSpeed
from schemas.settings import (
    ALIVE_FAULTS,
    CHECKSUM_FAULTS,
    CHECKSUM_WINDOW_NS,
    COMMANDER_NS,
    FROZEN_BODY_M,
    IMPLAUSIBLE_FAULTS,
    IMPLAUSIBLE_MPS,
    IMPLAUSIBLE_NS,
    IMPLAUSIBLE_RATIO,
    OVERSPEED_MPS,
    OVERSPEED_NS,
    ROLLING_MPS,
    ROLLING_NS,
    SAFETY_STATE_PERIOD_NS,
    STEERING_DEVIATION_DEG,
    STEERING_DEVIATION_NS,
    TICK_NS,
)

_MODES: Final = {0: "auto", 1: "remote", 2: "stop"}
_ABSURD: Final = {
    "Angle": STEERING_PLAUSIBLE_DEG,
    "Speed": SPEED_PLAUSIBLE_MPS,
    "RearLeftSpeed": SPEED_PLAUSIBLE_MPS,
    "RearRightSpeed": SPEED_PLAUSIBLE_MPS,
}
WAITED_NS: Final = 1_000_000
"""Reading a frame takes less; one that waited for longer is reported to have waited."""

_TOLD_NS: Final = SAFETY_STATE_PERIOD_NS + TICK_NS
"""Age at which a state of the arbiter may be out of date: it is repeated after its period."""


def bumper(window: EvidenceWindow, signal: str, field: str) -> list[Link]:
    """The frame that first said that a bumper was hit."""
    return _turned(window, signal, 1, "1") or _body(window, field, wanted=True)


def mode(window: EvidenceWindow, value: int) -> list[Link]:
    """The frame that first read a mode."""
    found = _turned(window, "Mode", value, _MODES[value])
    return found or _body(window, "mode", wanted=Mode(_MODES[value]))


def _turned(window: EvidenceWindow, signal: str, value: int, word: str) -> list[Link]:
    """The first of the last frames of the body that have this value."""
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
        return []
    text = f"frame {first} said {signal} = {word}, {window.ago(first.time_ns)}{_waited(first)}"
    if other is None:
        text += ", and so did all since"
    else:
        was = _MODES.get(int(signals(other)[signal]), "?") if signal == "Mode" else f"{signals(other)[signal]:g}"
        text += f"; the one {span(first.time_ns - other.time_ns)} earlier said {was}"
    link = evidence(
        text,
        first.time_ns,
        identifier=f"0x{first.identifier:08X}",
        bytes=first.data.hex(),
        signal=signal,
        value=value,
        before_ms=(window.at_ns - first.time_ns) / 1e6,
    )
    return [link]


def _body(window: EvidenceWindow, field: str, *, wanted: object) -> list[Link]:
    """The same from the decoded frames, where the raw ones are not in the log."""
    first: Heard[Body] | None = None
    for one in window.until(Body):
        if getattr(one.said, field) != wanted:
            break
        first = one
    name = "Auto_MileageAndBodyFeedback"
    if first is None:
        return [missing(f"no {name} before this is in the log that shows it, neither raw nor decoded")]
    word = wanted.value if isinstance(wanted, Mode) else wanted
    text = f"chassis/body said {field} = {word}, {window.ago(first.time_ns)}; no raw frames are in the log"
    return [evidence(text, first.time_ns, signal=field, before_ms=(window.at_ns - first.time_ns) / 1e6)]


def silence(window: EvidenceWindow) -> list[Link]:
    """The last frame of each, and its age against the limit."""
    names = window.named_frames
    if not names:
        state = window.last(RobotState)
        names = state.said.silent if state is not None else []
    if not names:
        return [missing("the log does not tell which feedback frames were missing")]
    if not window.has_frames:
        return [missing(f"no raw frames are in the log, so the last {', '.join(names)} cannot be shown")]
    return [_last_frame(window, name) for name in names if name in IDENTIFIERS]


def _last_frame(window: EvidenceWindow, name: str) -> Link:
    frames = window.frames_before(IDENTIFIERS[name])
    whole = [frame for frame in frames if frame.is_whole]
    limit_ns = silence_ns(name)
    identifier = f"0x{IDENTIFIERS[name]:08X}"
    late = _waiting(window, name)
    if not whole:
        more = f"; {count(len(frames), 'frame')} of it had a wrong checksum" if frames else ""
        return evidence(f"{name} ({identifier}) was not heard in the seconds before{more}{late}", name=name)
    last = _last_new(whole)
    age_ns = window.at_ns - last.time_ns
    data = {
        "name": name,
        "identifier": identifier,
        "age_ms": age_ns / 1e6,
        "bus_age_ms": (age_ns + last.waited_ns) / 1e6,
        "limit_ms": limit_ns / 1e6,
        "waiting": len(window.waiting.get(IDENTIFIERS[name], ())),
    }
    if age_ns <= limit_ns and "Valid" in signals(last) and not signals(last)["Valid"]:
        valid = next((frame for frame in reversed(whole) if signals(frame)["Valid"]), None)
        since = f"the last valid one came {window.ago(valid.time_ns)}" if valid else "none kept here was"
        text = f"{name} came, but said that it was not valid: {last}; {since}; the limit is {span(limit_ns)}"
        return evidence(text, last.time_ns, **data)
    again = len(whole) - 1 - whole.index(last)
    repeated = f"; {count(again, 'frame')} after it only repeated its alive counter" if again else ""
    wrong = sum(1 for frame in frames if frame.time_ns > last.time_ns and not frame.is_whole)
    repeated += f"; {count(wrong, 'frame')} after it had a wrong checksum" if wrong else ""
    if age_ns <= limit_ns and not window.is_journaled:
        repeated += "; so the bus says, and no journal is in the log that tells when the arbiter was given it"
    period_ms = BY_IDENTIFIER[last.identifier].period_ns / 1e6
    text = (
        f"the last {name} came {window.ago(last.time_ns)}{_waited(last)}, the limit is {span(limit_ns)} "
        f"(its period is {period_ms:.0f} ms): {last}{repeated}{late}"
    )
    return evidence(text, last.time_ns, bytes=last.data.hex(), **data)


def _waited(frame: DecodedFrame) -> str:
    """The time between the bus and the arbiter in words, to be put behind the frame's time."""
    return f" (the bus had it {span(frame.waited_ns)} earlier)" if frame.waited_ns >= WAITED_NS else ""


def _waiting(window: EvidenceWindow, name: str) -> str:
    """The frames that were on their way from the bus to the arbiter at the moment."""
    waiting = window.waiting.get(IDENTIFIERS[name], ())
    if not waiting:
        return ""
    came = f"the bus had {len(waiting)} more by then, the last {window.ago(waiting[-1].time_ns)}"
    return f"; {came}, which the arbiter had not been given"


def _last_new(whole: Sequence[DecodedFrame]) -> DecodedFrame:
    """The last one that did not only repeat the counter of the one before."""
    at = len(whole) - 1
    while at and whole[at].alive_counter == whole[at - 1].alive_counter:
        at -= 1
    return whole[at]


def faulty(window: EvidenceWindow) -> list[Link]:
    """Wrong checksums, counters that do not rise, values that cannot be."""
    if not window.has_frames:
        return [missing("no raw frames are in the log, so what was wrong with them cannot be shown")]
    found = [link for name in window.named_frames or IDENTIFIERS for link in _faults(window, name)]
    return found or [missing("the raw frames in the log show no such fault")]


def _faults(window: EvidenceWindow, name: str) -> Iterable[Link]:
    known = IDENTIFIERS.get(name)
    if known is None or not BY_IDENTIFIER[known].is_feedback:
        return
    frames = window.frames_before(known)
    since_ns = window.at_ns - CHECKSUM_WINDOW_NS
    wrong = [frame for frame in frames if frame.time_ns >= since_ns and not frame.is_whole]
    if len(wrong) >= CHECKSUM_FAULTS:
        last = wrong[-1]
        text = (
            f"{count(len(wrong), 'frame')} of {name} had a wrong checksum in the second before, and "
            f"{CHECKSUM_FAULTS} are too many; the last {window.ago(last.time_ns)}: {last}; "
            f"its last byte should be {last.checksum:02X}"
        )
        yield evidence(
            text, last.time_ns, name=name, faults=len(wrong), limit=CHECKSUM_FAULTS, bytes=last.data.hex()
        )
    counters = _alive_faults(frames)
    if counters >= ALIVE_FAULTS:
        seen = ", ".join(str(frame.alive_counter) for frame in [f for f in frames if f.is_whole][-8:])
        text = (
            f"the alive counter of {name} had {counters} faults (+1 for each wrong step, -1 for each right one), "
            f"and {ALIVE_FAULTS} are too many; the last counters read {seen}"
        )
        yield evidence(text, frames[-1].time_ns, name=name, alive_faults=counters, limit=ALIVE_FAULTS)
    yield from absurd(window, name)


def _alive_faults(frames: Iterable[DecodedFrame]) -> int:
    """The fault count after these frames."""
    faults, expected = 0, None
    for frame in frames:
        if frame.is_whole:
            right = expected is None or frame.alive_counter == expected
            faults = max(0, faults - 1) if right else min(faults + 1, ALIVE_FAULTS)
            expected = (frame.alive_counter + 1) % COUNTER_SPAN
    return faults


def absurd(window: EvidenceWindow, name: str) -> Iterable[Link]:
    """Frames with a right checksum and a value that this chassis cannot have."""
    since_ns = window.at_ns - CHECKSUM_WINDOW_NS
    found = []
    for frame in window.frames_before(IDENTIFIERS[name]):
        if frame.time_ns >= since_ns and frame.is_whole:
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


_IMPLAUSIBLE: Final = (
    f"over {IMPLAUSIBLE_MPS:g} m/s and a factor of {IMPLAUSIBLE_RATIO:g} "
    f"apart for {span(IMPLAUSIBLE_NS)} is too much"
)

ROLLING: Final = f"over {ROLLING_MPS:g} m/s for {span(ROLLING_NS)} where none is told is rolling"

OVERSPEED: Final = f"{OVERSPEED_MPS:g} m/s over the limit in force for {span(OVERSPEED_NS)} is too fast"


def speeds(window: EvidenceWindow, rule: str = _IMPLAUSIBLE) -> list[Link]:
    """Wheels, drive feedback and command side by side, and the rule that they broke."""
    names = ("Auto_DriveFeedBack", "Auto_WheelSpdFeedback")
    found = [link for name in names for link in absurd(window, name)]
    wheels, drive, state = window.last(WheelSpeed), window.last(Drive), _told_before(window)
    if wheels is None or drive is None:
        return found or [missing("the speeds of the chassis before this are not in the log")]
    mean_mps = (wheels.said.rear_left_speed_mps + wheels.said.rear_right_speed_mps) / 2
    told = f", the gateway told it {state.said.output_speed_mps:.2f} m/s" if state is not None else ""
    text = (
        f"the rear wheels turned at {mean_mps:.2f} m/s, the drive feedback said {drive.said.speed_mps:.2f} m/s"
        f"{told}; {rule}"
    )
    link = evidence(
        text,
        wheels.time_ns,
        wheel_speed_mps=mean_mps,
        drive_speed_mps=drive.said.speed_mps,
        output_speed_mps=None if state is None else state.said.output_speed_mps,
    )
    return [*found, link]


def steering(window: EvidenceWindow) -> list[Link]:
    """Return the steering angle beside the commanded one."""
    seen, state = window.last(Steering), _told_before(window)
    if seen is None or state is None:
        return [missing("the steering angle, or what was told, is not in the log before this")]
    told_deg = state.said.output_angle_deg
    text = f"the steering read {seen.said.angle_deg:.1f} deg, the gateway told it {told_deg:.1f} deg; over "
    text += f"{STEERING_DEVIATION_DEG:g} deg apart for {span(STEERING_DEVIATION_NS)} does not follow"
    return [evidence(text, seen.time_ns, angle_deg=seen.said.angle_deg, output_angle_deg=told_deg)]


def mileage(window: EvidenceWindow) -> list[Link]:
    """The mileage that stood still while the robot drove."""
    body = window.last(Body)
    if body is None:
        return [missing("no body frame is in the log before this")]
    text = f"the mileage read {body.said.total_mileage_km:.3f} km, and did not change over {FROZEN_BODY_M:g} m"
    return [evidence(text, body.time_ns, total_mileage_km=body.said.total_mileage_km)]


def _told_before(window: EvidenceWindow) -> Heard[SafetyState] | None:
    return next((one for one in window.until(SafetyState) if one.time_ns < window.at_ns), None)


def commanders(window: EvidenceWindow, window_ns: int = COMMANDER_NS) -> list[Link]:
    """Command frames on the bus that the gateway did not send."""
    if not window.has_frames:
        return [missing("no raw frames are in the log, so who else sent commands cannot be shown")]
    heard = [
        frame
        for identifier, (frames, _) in window.frames.items()
        if identifier in BY_IDENTIFIER and not BY_IDENTIFIER[identifier].is_feedback
        for frame in frames
    ]
    near = [frame for frame in heard if frame.time_ns >= window.at_ns - window_ns]
    if not near:
        return [missing("no command frames of anybody else are in the log right before this")]
    first, last = min(heard, key=lambda one: one.time_ns), max(near, key=lambda one: one.time_ns)
    were = "was" if len(near) == 1 else "were"
    text = f"{count(len(near), 'command frame')} that this gateway did not send {were} received in the "
    text += f"{span(window_ns)} up to {window.what}, the first of those kept here {window.ago(first.time_ns)}; "
    text += f"the last: {last}"
    return [evidence(text, last.time_ns, frames=len(near), first_before_ms=(window.at_ns - first.time_ns) / 1e6)]


def variant(window: EvidenceWindow) -> list[Link]:
    """Return the wheel speed frames that show the scale, and the gateway's conclusion from them."""
    found = []
    state = window.last(RobotState)
    if state is not None:
        text = f"the gateway took the firmware variant for {state.said.variant.value}"
        found.append(evidence(text, state.time_ns, variant=state.said.variant.value))
    frames = [frame for frame in window.frames_before(WHEELS) if frame.is_whole]
    if not frames:
        return [*found, missing("no wheel speed frame is in the log, which would tell the scale")]
    last = frames[-1]
    coarse, fine = (signals(last, one)["RearLeftSpeed"] for one in (Variant.COARSE, Variant.FINE))
    text = f"the last wheel speed frame reads {coarse:.2f} m/s if coarse and {fine:.2f} m/s if fine: {last}"
    found.append(evidence(text, last.time_ns, coarse_mps=float(coarse), fine_mps=float(fine)))
    return found
