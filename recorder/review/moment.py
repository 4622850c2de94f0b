"""One moment: what the robot did, what the arbiter did, and what kept the robot from moving, in sentences."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Final

from recorder.review.chain import Link, Step, before, deg, missing, mps, span
from recorder.review.entries import Entry, EntryKind
from recorder.review.evidence import last_command
from recorder.review.window import EvidenceWindow, Heard, Said
from schemas.decisions import COMMANDING, ArbiterState, Bound, Decision, SafetyState, StopPhase
from schemas.messages import Body, Drive, Gear, GearPosition, Parking, ParkingStatus, RobotState, Steering
from schemas.reasons import OF_A_ROBOT, RESET, TEXTS, Reason, cure_of, of_a_robot
from schemas.settings import STANDSTILL_MPS

FRESH_NS: Final = 500_000_000
"""Feedback that is older is no longer what the robot does; the slowest frame comes every 50 ms."""

_STILL_MPS: Final = 0.005
"""Speeds below this are shown as 0.00 m/s."""

PLAIN: Final = frozenset({Reason.STOPPING, Reason.NOT_ENGAGED, Reason.ENGAGING, Reason.NO_LEASE})
"""Reasons that block a robot that no client has engaged: they are shown by that."""

_PASSING: Final = frozenset({Reason.STOPPING, Reason.ENGAGING, Reason.GEAR_SHIFTING})
"""Reasons that end by themselves."""

_FORBIDS: Final = {Reason.FRONT_BUMPER: (1, "forward"), Reason.REAR_BUMPER: (-1, "backward")}
"""The sign of the speeds that a pressed bumper forbids to an engaged robot, and their direction in words."""

_WAYS: Final = {GearPosition.REVERSE: "backward ", GearPosition.DRIVE: "forward "}


def motion(now: EvidenceWindow) -> Iterator[Link]:
    """The motion of the robot, by its feedback; by the robot's state where its frames are not in the log."""
    drive, state, steering = _fresh(now, Drive), _fresh(now, RobotState), _fresh(now, Steering)
    gear, body, parking = _fresh(now, Gear), _fresh(now, Body), _fresh(now, Parking)
    if drive is None and state is None:
        yield missing("feedback of the chassis at this moment")
        return
    silent = [] if state is None or not state.said.silent else [f"silent: {', '.join(state.said.silent)}"]
    if drive is None and state is not None:
        said = state.said
        parts = [
            "its speed was not known" if said.speed_mps is None else f"its speed was {said.speed_mps:.2f} m/s"
        ]
        parts += [] if said.angle_deg is None else [f"steering {deg(said.angle_deg)}"]
        parts += [f"gear {said.gear_position.value}", f"mode {said.mode.value}", *silent]
        data = {"speed_mps": said.speed_mps, "angle_deg": said.angle_deg}
        yield Link(Step.MOTION, ", ".join(parts), state.time_ns, data)
    if drive is None:
        return
    speed_mps = drive.said.speed_mps
    position = gear.said.gear_position if gear is not None else GearPosition.UNDEFINED
    moved = f"moved {_WAYS.get(position, '')}at {speed_mps:.2f} m/s"
    parts = [f"it {_stood(speed_mps) if speed_mps < STANDSTILL_MPS else moved}"]
    parts += [f"steering {deg(steering.said.angle_deg)}"] if steering is not None else []
    parts += [f"gear {position.value}"] if gear is not None else []
    if body is not None:
        parts.append(f"mode {body.said.mode.value}")
        parts += [f"{side} bumper pressed" for side in ("front", "rear") if getattr(body.said, f"{side}_bumper")]
    if parking is not None and parking.said.parking_status is not ParkingStatus.UNDEFINED:
        parts.append(f"parking brake {parking.said.parking_status.value}")
    facts: dict[str, object] = {
        "speed_mps": speed_mps,
        "angle_deg": None if steering is None else steering.said.angle_deg,
        "gear_position": position.value,
        "mode": None if body is None else body.said.mode.value,
    }
    yield Link(Step.MOTION, ", ".join(parts + silent), drive.time_ns, facts)


def _stood(speed_mps: float) -> str:
    """Words for a robot that counts as standing; it may still roll, or begin to."""
    return "stood" if speed_mps < _STILL_MPS else f"hardly moved, at {speed_mps:.2f} m/s"


def arbiter(now: EvidenceWindow, state: SafetyState | None, lease: Entry | None) -> Iterator[Link]:
    """The state of the arbiter, the holder of the lease, and the limits that changed the command."""
    if state is None:
        yield missing("the arbiter's state at this moment")
        return
    text = f"the arbiter was {state.state.value}"
    if state.stop_phase is not StopPhase.IDLE:
        text += f" ({state.stop_phase.value}), because of {state.stop_reason.value}"
    if state.lease_holder:
        text += f"; {state.lease_holder} held the lease as {state.lease_role.value}"
        text += f", for {state.lease_expires_s:.1f} s more"
    else:
        since = "" if lease is None else f" ({before(lease.time_ns, now.at_ns)}: {lease.text})"
        text += f"; the lease was free{since}"
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
    last = last_command(now) if state.state is ArbiterState.ENGAGED else None
    for bound in [] if last is None else last.said.bound_by:
        words = _BOUNDS.get(bound)
        text = f"{bound.value}, a limit of a newer version"
        if last is not None and words is not None:
            text = words(state, last.said)
        yield Link(Step.ARBITER, text, None if last is None else last.time_ns, {"bound": bound.value})


_BOUNDS: Final[dict[Bound, Callable[[SafetyState, Decision], str]]] = {
    Bound.SPEED: lambda state, said: (
        f"the speed limit, {state.speed_limit_mps:.2f} m/s, is below the requested "
        f"{abs(said.requested_speed_mps or 0.0):.2f} m/s"
    ),
    Bound.ACCELERATION: lambda state, _: f"it was speeding up, by at most {state.acceleration_limit_mps2:g} m/s2",
    Bound.DECELERATION: lambda state, _: f"it was slowing down, by at most {state.deceleration_limit_mps2:g} m/s2",
    Bound.STEERING: lambda state, _: f"the steering limit is {state.steering_limit_deg:g} deg",
    Bound.STEERING_RATE: lambda state, _: f"it was steering, by at most {state.steering_rate_limit_degps:g} deg/s",
    Bound.LATERAL_ACCELERATION: lambda state, _: (
        f"the lateral acceleration, at most {state.lateral_acceleration_limit_mps2:g} m/s2, bounds speed and angle"
    ),
    Bound.REVERSAL: lambda *_: "it was reversing, which goes through standstill and neutral",
    Bound.BUMPER: lambda *_: "a pressed bumper forbids motion to its side",
    Bound.GEAR: lambda *_: "the gear was not in yet",
    Bound.PARKING: lambda *_: "the parking brake was applied: no speed is commanded until unpark",
}
"""The meaning of each bound, with the limit in force; a test holds that none is missing."""


def headline(
    now: EvidenceWindow, state: SafetyState | None, focus: Entry | None, why: str, latch: Entry | None
) -> str:
    """The answer in one sentence.

    Args:
        now: the moment.
        state: the arbiter's; None if the log does not have it.
        focus: the stop that is explained.
        why: its cause in words.
        latch: the newest one of what is latched.
    """
    is_stop = focus is not None and focus.kind in {EntryKind.STOP, EntryKind.END}
    when = "" if focus is None else before(focus.time_ns, now.at_ns)
    soon = ""
    if focus is not None and focus.time_ns > now.at_ns:
        soon = f"; {span(focus.time_ns - now.at_ns)} later {'a stop began' if is_stop else 'it was let go'}: {why}"
    if state is None:
        last = "." if focus is None else f". The last stop was {when}: {why}."
        return f"Not in the log: what the arbiter did then{last}"
    match state.state:
        case ArbiterState.STOPPING:
            return f"It was being stopped: {why or TEXTS[state.stop_reason].means}."
        case ArbiterState.STANDBY:
            if focus is None:
                return f"It was not engaged: {_in_words(state.blocked_by)}."
            last = soon or f". The last stop was {when}: {why}"
            if not soon and latch is not None and latch.time_ns > focus.time_ns:
                last = f", and was latched {before(latch.time_ns, now.at_ns)}: {cause_of(latch)}{last}"
            return f"It was not engaged{last}."
        case ArbiterState.ENGAGING:
            return f"It was being engaged: the chassis did not read auto yet{soon}."
        case _:
            return f"{_engaged(now, state)}{soon}."


def cause_of(entry: Entry) -> str:
    """The cause of a stop, without the word that it is one."""
    return entry.text.partition(": ")[2] or entry.text


def _engaged(now: EvidenceWindow, state: SafetyState) -> str:
    """The motion of an engaged robot in words."""
    drive, robot = _fresh(now, Drive), _fresh(now, RobotState)
    speed_mps = drive.said.speed_mps if drive is not None else None if robot is None else robot.said.speed_mps
    if speed_mps is not None and speed_mps >= STANDSTILL_MPS:
        return f"It was engaged and moved, at {speed_mps:.2f} m/s"
    did = "was not seen to move" if speed_mps is None else _stood(speed_mps)
    if round(state.output_speed_mps, 2):
        return f"It was engaged, commanded {mps(state.output_speed_mps)}, and {did}"
    blocking = kept_by(now, state)
    if blocking:
        return f"It was engaged and {did}: {_in_words(blocking)}"
    last = last_command(now)
    if last is None:
        return f"It was engaged and {did}: no drive command to it is in the log"
    asked_mps = round(last.said.requested_speed_mps or 0.0, 2)
    if asked_mps:
        return f"It was engaged, requested {mps(asked_mps)}, commanded 0.00 m/s, and {did}"
    return f"It was engaged and {did}: {last.said.operator} requested zero speed"


def kept_by(now: EvidenceWindow, state: SafetyState) -> list[Reason]:
    """Return the reasons that kept an engaged robot from moving; none if its command was to move.

    A pressed bumper forbids one direction alone: it counts if that one was asked for.
    """
    if round(state.output_speed_mps, 2):
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
            return f"no speed was commanded: {means}"
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
    cure = cure.rpartition(RESET)[2] if is_reset else cure
    if cure and reason not in _PASSING:
        yield Link(Step.CURE, f"to cure {reason.value}: {cure_of(cure, robot)}", None, {"reason": reason.value})


def _in_words(reasons: Sequence[Reason]) -> str:
    return "; ".join(OF_A_ROBOT[reason].means for reason in reasons) or "nothing blocked it"


def _fresh(now: EvidenceWindow, kind: type[Said]) -> Heard[Said] | None:
    heard = now.last(kind)
    return heard if heard is not None and now.at_ns - heard.time_ns <= FRESH_NS else None
