"""One moment: what the robot did, what the arbiter did, and what that means, in sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

from recorder.review.entries import Entry, EntryKind
from recorder.review.reasoning.blockers import is_told, kept_by
from recorder.review.reasoning.chain import Link, Step, before, missing, mps, span, zero
from recorder.review.reasoning.request_evidence import last_command
from recorder.review.reasoning.window import EvidenceWindow, Heard, Said
from schemas.decisions import COMMANDING, ArbiterState, Bound, Decision, SafetyState, StopPhase
from schemas.messages import Body, Drive, Gear, GearPosition, Parking, ParkingStatus, RobotState, Steering
from schemas.reasons import OF_A_ROBOT, TEXTS, Reason
from schemas.settings import STANDSTILL_MPS

FRESH_NS: Final = 500_000_000
"""Feedback that is older is no longer what the robot does; the slowest frame comes every 50 ms."""

_STILL_MPS: Final = 0.005
"""Speeds below this are shown as 0.00 m/s."""

_WAYS: Final = {GearPosition.REVERSE: "backward", GearPosition.DRIVE: "forward"}


def motion(now: EvidenceWindow) -> Iterator[Link]:
    """The motion of the robot, by its feedback."""
    drive, steering = _fresh(now, Drive), _fresh(now, Steering)
    gear, body, parking = _fresh(now, Gear), _fresh(now, Body), _fresh(now, Parking)
    if drive is None:
        yield from _thin_motion(now)
        return
    speed_mps = drive.said.speed_mps
    position = gear.said.gear_position if gear is not None else GearPosition.UNDEFINED
    way = _WAYS.get(position, "")
    if speed_mps < STANDSTILL_MPS:
        parts = [f"it {_stood(speed_mps)}"]
    else:
        parts = [f"it moved {way}{' ' if way else ''}at {speed_mps:.2f} m/s"]
    if steering is not None:
        parts.append(f"steering {zero(steering.said.angle_deg):+.1f} deg")
    if gear is not None:
        parts.append(f"gear {position.value}")
    if body is not None:
        parts.append(f"mode {body.said.mode.value}")
        bumpers = [side for side in ("front", "rear") if getattr(body.said, f"{side}_bumper")]
        parts += [f"{side} bumper pressed" for side in bumpers]
    if parking is not None and parking.said.parking_status is not ParkingStatus.UNDEFINED:
        parts.append(f"parking brake {parking.said.parking_status.value}")
    data = {
        "speed_mps": speed_mps,
        "angle_deg": None if steering is None else steering.said.angle_deg,
        "gear_position": position.value,
        "mode": None if body is None else body.said.mode.value,
    }
    yield Link(Step.MOTION, ", ".join(parts), drive.time_ns, data)


def _stood(speed_mps: float) -> str:
    """Words for a robot that counts as standing; it may still roll, or begin to."""
    return "stood" if speed_mps < _STILL_MPS else f"hardly moved, at {speed_mps:.2f} m/s"


def _thin_motion(now: EvidenceWindow) -> Iterator[Link]:
    """By the robot's state, where its frames are not in the log."""
    state = _fresh(now, RobotState)
    if state is None:
        last = now.last(Drive)
        since = f"; the last drive feedback came {before(last.time_ns, now.at_ns)}" if last is not None else ""
        yield missing(f"the log holds no feedback of the chassis at this moment{since}")
        return
    said = state.said
    speed = "its speed was not known" if said.speed_mps is None else f"its speed was {said.speed_mps:.2f} m/s"
    angle = "" if said.angle_deg is None else f", steering {zero(said.angle_deg):+.1f} deg"
    text = f"{speed}{angle}, gear {said.gear_position.value}, mode {said.mode.value}"
    if said.silent:
        text += f"; silent: {', '.join(said.silent)}"
    yield Link(Step.MOTION, text, state.time_ns, {"speed_mps": said.speed_mps, "angle_deg": said.angle_deg})


def arbiter(now: EvidenceWindow, state: SafetyState | None) -> Iterator[Link]:
    """The state of the arbiter, and the holder of the lease."""
    if state is None:
        last = now.last(SafetyState)
        behind = next((one for one in now.all(SafetyState) if one.time_ns > now.at_ns), None)
        words = [f"the last came {before(last.time_ns, now.at_ns)}"] if last is not None else []
        words += [f"the next {before(behind.time_ns, now.at_ns)}"] if behind is not None else []
        near = ", ".join(words) or "nor any in the seconds around"
        yield missing(f"the log holds no state of the arbiter at this moment: {near}")
        return
    text = f"the arbiter was {state.state.value}"
    if state.stop_phase is not StopPhase.IDLE:
        text += f" ({state.stop_phase.value}), because of {state.stop_reason.value}"
    if state.lease_holder:
        text += f"; {state.lease_holder} held the lease as {state.lease_role.value}"
        text += f", for {state.lease_expires_s:.1f} s more"
    else:
        text += "; nobody held the lease"
    if state.state in COMMANDING:
        text += f"; the speed limit was {state.speed_limit_mps:.2f} m/s"
    data = {
        "tick": state.tick,
        "state": state.state.value,
        "stop_phase": state.stop_phase.value,
        "lease_holder": state.lease_holder,
        "latched": [reason.value for reason in state.latched],
        "blocked_by": [reason.value for reason in state.blocked_by],
        "speed_limit_mps": state.speed_limit_mps,
        "output_speed_mps": state.output_speed_mps,
    }
    yield Link(Step.ARBITER, text, None, data)
    if state.state is ArbiterState.ENGAGED:
        yield from _bounds(now, state)


def _bounds(now: EvidenceWindow, state: SafetyState) -> Iterator[Link]:
    """The limits that changed the command."""
    last = last_command(now)
    if last is not None:
        for bound in last.said.bound_by:
            words = _BOUNDS.get(bound)
            text = f"{bound.value}, a limit of a newer version" if words is None else words(state, last.said)
            yield Link(Step.ARBITER, text, last.time_ns, {"bound": bound.value})


_BOUNDS: Final[dict[Bound, Callable[[SafetyState, Decision], str]]] = {
    Bound.SPEED: lambda state, said: (
        f"the speed limit, {state.speed_limit_mps:.2f} m/s, is below the {_mps(said)} that were asked for"
    ),
    Bound.ACCELERATION: lambda state, _: (
        f"it was speeding up, and by no more than {state.acceleration_limit_mps2:g} m/s2"
    ),
    Bound.DECELERATION: lambda state, _: (
        f"it was slowing down, and by no more than {state.deceleration_limit_mps2:g} m/s2"
    ),
    Bound.STEERING: lambda state, _: f"the steering limit is {state.steering_limit_deg:g} deg",
    Bound.STEERING_RATE: lambda state, _: (
        f"it was steering, and by no more than {state.steering_rate_limit_degps:g} deg/s"
    ),
    Bound.LATERAL_ACCELERATION: lambda state, _: (
        f"the lateral acceleration, at most {state.lateral_acceleration_limit_mps2:g} m/s2, bounds speed and angle"
    ),
    Bound.REVERSAL: lambda *_: "it was reversing, which goes through standstill and neutral",
    Bound.BUMPER: lambda *_: "a pressed bumper forbids motion to its side",
    Bound.GEAR: lambda *_: "the gear was not in yet",
    Bound.PARKING: lambda *_: "the parking brake was applied: no speed is told until unpark",
}
"""The meaning of each bound, with the limit in force; a test holds that none is missing."""


def _mps(said: Decision) -> str:
    return f"{abs(said.requested_speed_mps or 0.0):.2f} m/s"


def headline(
    now: EvidenceWindow, state: SafetyState | None, focus: Entry | None, latch: Entry | None = None
) -> str:
    """The answer in one sentence.

    Args:
        now: the moment.
        state: the arbiter's; None if the log does not have it.
        focus: the stop that is explained.
        latch: the newest one of what is latched.
    """
    if state is None:
        if focus is None:
            return "The log does not tell what the arbiter did then."
        when, why = before(focus.time_ns, now.at_ns), _why(focus)
        return f"The log holds no state of the arbiter at that moment. The last stop was {when}: {why}."
    match state.state:
        case ArbiterState.STOPPING:
            return f"It was being stopped: {TEXTS[state.stop_reason].means if focus is None else _why(focus)}."
        case ArbiterState.STANDBY:
            return _standby(now, state, focus, latch)
        case ArbiterState.ENGAGING:
            return f"It was being engaged: the chassis did not read auto yet{_soon(now, focus)}."
        case _:
            return f"{_engaged(now, state)}{_soon(now, focus)}."


def _soon(now: EvidenceWindow, focus: Entry | None) -> str:
    """The stop that came right after the moment."""
    if focus is None:
        return ""
    what = "a stop began" if focus.kind in {EntryKind.STOP, EntryKind.END} else "the gateway let go of it"
    return f"; {span(focus.time_ns - now.at_ns)} later {what}: {_why(focus)}"


def _standby(now: EvidenceWindow, state: SafetyState, focus: Entry | None, latch: Entry | None) -> str:
    """Nobody commanded it."""
    if focus is None:
        return f"It was not engaged: {_in_words(state.blocked_by)}."
    if focus.time_ns > now.at_ns:
        return f"It was not engaged{_soon(now, focus)}."
    when, why = before(focus.time_ns, now.at_ns), _why(focus)
    if latch is not None and latch.time_ns > focus.time_ns:
        latched = f"{before(latch.time_ns, now.at_ns)}: {_why(latch)}"
        return f"It was not engaged, and was latched {latched}. The last stop was {when}: {why}."
    if focus.kind not in {EntryKind.STOP, EntryKind.END}:
        return f"The gateway let go of it {when}: {why}."
    return f"It was not engaged. The last stop was {when}: {why}."


def _why(focus: Entry) -> str:
    """The cause of a stop, without the word that it is one."""
    return focus.text.partition(": ")[2] or focus.text


def _engaged(now: EvidenceWindow, state: SafetyState) -> str:
    """The motion of an engaged robot in words."""
    speed_mps = _speed_mps(now)
    if speed_mps is not None and speed_mps >= STANDSTILL_MPS:
        return f"It was engaged and moved, at {speed_mps:.2f} m/s"
    did = "was not seen to move" if speed_mps is None else _stood(speed_mps)
    if is_told(state):
        return f"It was engaged and told {mps(state.output_speed_mps)}, and {did}"
    blocking = kept_by(now, state)
    if blocking:
        return f"It was engaged and {did}: {_in_words(blocking)}"
    last = last_command(now)
    if last is None:
        return f"It was engaged and {did}: no drive command to it is in the log"
    asked_mps = round(last.said.requested_speed_mps or 0.0, 2)
    if asked_mps:
        return f"It was engaged and asked for {mps(asked_mps)}, was told 0.00 m/s, and {did}"
    return f"It was engaged and {did}: {last.said.operator} asked for zero speed"


def _speed_mps(now: EvidenceWindow) -> float | None:
    """By its feedback, or by the robot's state; None if neither is there."""
    drive, state = _fresh(now, Drive), _fresh(now, RobotState)
    if drive is not None:
        return drive.said.speed_mps
    return None if state is None else state.said.speed_mps


def _in_words(reasons: Sequence[Reason]) -> str:
    return "; ".join(OF_A_ROBOT[reason].means for reason in reasons) or "nothing blocked it"


def _fresh(now: EvidenceWindow, kind: type[Said]) -> Heard[Said] | None:
    heard = now.last(kind)
    return heard if heard is not None and now.at_ns - heard.time_ns <= FRESH_NS else None
