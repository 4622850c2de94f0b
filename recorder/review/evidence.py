"""The evidence for each reason: chassis frames, requests, and the gateway's own figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from typing import Final

from gateway.chassis.layout import Within
from gateway.choice.frame_layouts import RULES
from recorder.review.window import (
    BODY,
    BY_IDENTIFIER,
    IDENTIFIERS,
    DecodedFrame,
    EvidenceWindow,
    Heard,
    Link,
    counted,
    deg,
    evidence,
    missing,
    mps,
    signals,
    silence_ns,
    span,
)
from schemas.decisions import Decision, EventKind, SafetyEvent, SafetyState, Verdict
from schemas.messages import (
    Body,
    Drive,
    GatewayHealth,
    RobotState,
    Steering,
    WheelSpeed,
)
from schemas.reasons import TEXTS, Reason
from schemas.settings import (
    BEHIND_NS,
    CHECKSUM_WINDOW_NS,
    COMMANDER_NS,
    FOUND_MOVING_NS,
    FROZEN_BODY_M,
    IMPLAUSIBLE_FAULTS,
    SAFETY_STATE_PERIOD_NS,
    SEND_FAILURES,
    STEERING_DEVIATION_DEG,
    STEERING_DEVIATION_NS,
    TICK_NS,
)

Finder = Callable[[EvidenceWindow], list[Link]]
"""Finds the evidence in the window around the moment at which a reason arose."""

_ABSURD: Final = {signal: rule.maximum for _, signal, rule in RULES if isinstance(rule, Within)}

WAITED_NS: Final = 1_000_000  # a frame that waited for longer than this is reported with its wait
LATELY_NS: Final = 3_000_000_000  # refusals within this time before the moment are shown

_FRAMES: Final = "the frames of this time"
_REQUESTS: Final = "the requests of this time"


# Frames of the chassis.


def _turned(signal: str, value: int, word: str = "") -> Finder:
    """The first body frame with this value."""

    def found(window: EvidenceWindow) -> list[Link]:
        first: DecodedFrame | None = None
        was = ""
        for frame in (one for one in reversed(window.frames(BODY)) if one.is_whole):
            read = signals(frame)[signal]
            if read == value:
                first = frame
            elif first is not None or frame.time_ns < window.at_ns - SAFETY_STATE_PERIOD_NS - TICK_NS:
                was = f"; the last one before it, {window.ago(frame.time_ns)}, read {read:g}"
                break
        if first is None:
            return [missing("the body frame that shows it")]
        text = f"frame {first} read {signal} = {word or value}, {window.ago(first.time_ns)}{_waited(first)}{was}"
        before_ms = (window.at_ns - first.time_ns) / 1e6
        data = {"bytes": first.data.hex(), "signal": signal, "value": value, "before_ms": before_ms}
        return [evidence(text, first.time_ns, identifier=f"0x{first.identifier:08X}", **data)]

    return found


_AUTO: Final = _turned("Mode", 0, "auto")
_REMOTE: Final = _turned("Mode", 1, "remote")
_STOP: Final = _turned("Mode", 2, "stop")


def _frames(window: EvidenceWindow) -> list[Link]:
    """The frames that the arbiter names or misses, in the second before the moment."""
    state = window.last(RobotState)
    names = window.named_frames or (state.said.silent if state is not None else [])
    if not names or not window.has_frames:
        return [missing(_FRAMES if names else "the names of the frames")]
    known = [name for name in names if name in IDENTIFIERS]
    return [link for name in known for link in (_frame(window, name), *_absurd(window, name))]


def _frame(window: EvidenceWindow, name: str) -> Link:
    """The last valid frame and the bad ones: wrong checksum, not valid, or with an old counter."""
    identifier = IDENTIFIERS[name]
    frames, waiting, limit_ns = window.frames(identifier), window.waiting(identifier), silence_ns(name)
    good: DecodedFrame | None = None
    counter, since_ns = -1, window.at_ns - CHECKSUM_WINDOW_NS
    for frame in frames:
        if frame.is_whole and frame.alive_counter != counter and signals(frame).get("Valid", True):
            good = frame
        counter = frame.alive_counter if frame.is_whole else counter
    lately = [frame for frame in frames if frame.time_ns >= since_ns]
    broken = [frame for frame in lately if not frame.is_whole]
    data = {"name": name, "identifier": f"0x{identifier:08X}", "limit_ms": limit_ns / 1e6, "waiting": len(waiting)}
    text = f"no valid {name} (0x{identifier:08X}) was received in the seconds before"
    if good is not None:
        age_ns = window.at_ns - good.time_ns
        data |= {"age_ms": age_ns / 1e6, "bus_age_ms": (age_ns + good.waited_ns) / 1e6, "bytes": good.data.hex()}
        text = f"the last valid {name} was received {window.ago(good.time_ns)}{_waited(good)}: {good}"
    period_ns = BY_IDENTIFIER[identifier].period_ns
    text += f"; the limit is {span(limit_ns)} (its period is {period_ns / 1e6:.0f} ms)"
    text += f"; {len(waiting)} more were on the bus, not read yet" if waiting else ""
    if broken:
        last = broken[-1]
        text += f"; in the second before {len(broken)} of {counted(len(lately), 'frame')} had a wrong checksum, "
        text += f"the last: {last}, which should end with {last.checksum:02X}"
    if not frames or good is not frames[-1]:
        seen = [str(frame.alive_counter) for frame in lately[-8:] if frame.is_whole]
        text += f"; the last alive counters: {', '.join(seen)}" if seen else ""
    return evidence(text, None if good is None else good.time_ns, **data, wrong_checksums=len(broken))


def _waited(frame: DecodedFrame) -> str:
    """The time from the bus to the arbiter in words, after a frame's time."""
    return f" (on the bus {span(frame.waited_ns)} earlier)" if frame.waited_ns >= WAITED_NS else ""


def _absurd(window: EvidenceWindow, name: str) -> Iterator[Link]:
    """Frames with a valid checksum and an impossible value."""
    found = []
    for frame in window.frames(IDENTIFIERS[name]):
        if frame.time_ns >= window.at_ns - CHECKSUM_WINDOW_NS and frame.is_whole:
            read = signals(frame, window.variant)
            found += [(frame, one, read[one]) for one in _ABSURD if abs(read.get(one, 0)) > _ABSURD[one]]
    if len(found) >= IMPLAUSIBLE_FAULTS:
        frame, signal, value = found[-1]
        text = (
            f"{name} read {signal} = {value:.2f}, beyond the limit {_ABSURD[signal]:g}, last "
            f"{window.ago(frame.time_ns)}: {frame}; {IMPLAUSIBLE_FAULTS} of these in a second are a fault"
        )
        yield evidence(text, frame.time_ns, name=name, signal=signal, value=float(value), limit=_ABSURD[signal])


def _speeds(window: EvidenceWindow) -> list[Link]:
    wheels, drive, state = window.last(WheelSpeed), window.last(Drive), window.last(SafetyState, window.at_ns - 1)
    if wheels is None or drive is None:
        return [missing("the chassis's speeds before this")]
    mean_mps = (wheels.said.rear_left_speed_mps + wheels.said.rear_right_speed_mps) / 2
    told_mps = None if state is None else state.said.output_speed_mps
    text = f"the rear wheels read {mean_mps:.2f} m/s, the drive feedback {drive.said.speed_mps:.2f} m/s"
    text += "" if told_mps is None else f", commanded {mps(told_mps)}"
    data = {"wheel_speed_mps": mean_mps, "drive_speed_mps": drive.said.speed_mps, "output_speed_mps": told_mps}
    return [evidence(text, wheels.time_ns, **data)]


def _implausible(window: EvidenceWindow) -> list[Link]:
    """Impossible values; else the speeds, which differ too much."""
    absurd = [link for name in ("Auto_DriveFeedBack", "Auto_WheelSpdFeedback") for link in _absurd(window, name)]
    return absurd or _speeds(window)


def _steering(window: EvidenceWindow) -> list[Link]:
    """The steering angle and the commands that it did not follow."""
    seen = window.last(Steering)
    since_ns = window.at_ns - STEERING_DEVIATION_NS
    told = [
        one.said.output_angle_deg for one in window.until(SafetyState) if since_ns <= one.time_ns < window.at_ns
    ]
    if seen is None or not told:
        return [missing("the steering angle, or the commands before this")]
    text = f"the steering read {deg(seen.said.angle_deg)}, commanded {deg(min(told))} to {deg(max(told))}; "
    text += f"a deviation over {STEERING_DEVIATION_DEG:g} deg for {span(STEERING_DEVIATION_NS)} is a fault"
    return [evidence(text, seen.time_ns, angle_deg=seen.said.angle_deg, output_angle_deg=told[0])]


def _frozen(window: EvidenceWindow) -> list[Link]:
    body = window.last(Body)
    if body is None or "mileage" not in window.detail:
        return _speeds(window)
    text = f"the mileage read {body.said.total_mileage_km:.3f} km, and did not change over {FROZEN_BODY_M:g} m"
    return [evidence(text, body.time_ns, total_mileage_km=body.said.total_mileage_km)]


def _commanders(window: EvidenceWindow) -> list[Link]:
    near = window.commands_between(window.at_ns - COMMANDER_NS, window.at_ns + 1)
    if not near:
        return [missing("the other computer's frames")]
    last = near[-1]
    text = f"{counted(len(near), 'command frame')} that this gateway did not send arrived in the "
    text += f"{span(COMMANDER_NS)} up to {window.what}; the last: {last}"
    first_before_ms = (window.at_ns - near[0].time_ns) / 1e6
    return [evidence(text, last.time_ns, frames=len(near), first_before_ms=first_before_ms)]


# The gateway's own figures.


def _health(*fields: str) -> Finder:
    """These fields of the first health after the moment, which covers it; else of the last before."""

    def found(window: EvidenceWindow) -> list[Link]:
        health = next(window.after(GatewayHealth), None) or window.last(GatewayHealth)
        if health is None:
            return [missing("gateway/health of this time")]
        data = {field: getattr(health.said, field) for field in fields}
        shown = (f"{field.replace('_', ' ')} {_shown(value)}" for field, value in data.items() if value != "")
        said = ", ".join(shown)
        text = f"gateway/health, {window.ago(health.time_ns)}: {said}"
        return [evidence(text, health.time_ns, **data)]

    return found


def _shown(value: object) -> str:
    match value:
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.0f}"
        case Enum():
            return str(value.value)
        case dict():
            return ", ".join(f"{name} {number}" for name, number in value.items()) or "none"
        case _:
            return str(value)


def _bus(window: EvidenceWindow) -> list[Link]:
    """The last received frame, and the bus in the gateway's health."""
    heard = [frame for identifier in BY_IDENTIFIER for frame in list(window.frames(identifier))[-1:]]
    last = max(heard, key=lambda frame: frame.time_ns, default=None)
    if last is None:
        found = [missing(_FRAMES)]
    else:
        text = f"the last frame was received {window.ago(last.time_ns)}: {last}"
        found = [evidence(text, last.time_ns, age_ms=(window.at_ns - last.time_ns) / 1e6)]
    return [*found, *_health("bus", "bus_up", "bus_detail", "bus_losses")(window)]


def _load(window: EvidenceWindow) -> list[Link]:
    found = []
    if window.has_frames:
        waiting = sum(len(window.waiting(identifier)) for identifier in BY_IDENTIFIER)
        text = f"the arbiter read {counted(window.received, 'frame')} in the second before; "
        text += f"unread frames for {span(BEHIND_NS)} are a fault"
        text += f"; {waiting} were on the bus, not read yet" if waiting else ""
        found.append(evidence(text, window.at_ns, frames_per_s=window.received, waiting=waiting))
    return found + _health("frames_per_s", "bus_drops", "cpu_percent")(window)


def _unsent(window: EvidenceWindow) -> list[Link]:
    short = [
        one for one in window.until(Decision) if one.time_ns > window.at_ns - 10**9 and one.said.frames_sent < 5
    ]
    if not short:
        return [missing(_REQUESTS)]
    least, most = (pick(one.said.frames_sent for one in short) for pick in (min, max))
    text = f"in the second before, {least} to {most} of five frames were sent in {counted(len(short), 'tick')} "
    text += f"with a request; {SEND_FAILURES} such ticks in a row are a fault"
    return [evidence(text, short[0].time_ns, decisions=len(short), frames_sent_min=least)]


def _found_moving(window: EvidenceWindow) -> list[Link]:
    """The motion in auto without a client, and what had ended the command before."""
    drive = window.last(Drive)
    # A guard's arrival or loss has this kind too, and no reason.
    events = (one for one in window.until(SafetyEvent) if one.said.reason is not Reason.NONE)
    left = next((one for one in events if one.said.kind in {EventKind.TAKEOVER, EventKind.GUARD}), None)
    found = []
    if left is not None:
        text = f"the gateway had let go of it {window.ago(left.time_ns)}: {left.said.text}"
        found.append(evidence(text, left.time_ns, reason=left.said.reason.value))
    if drive is None:
        return [*found, missing("the chassis's speed before this"), *_AUTO(window)]
    text = f"the drive feedback read {drive.said.speed_mps:.2f} m/s {window.ago(drive.time_ns)}; without a client "
    text += f"it may move for {span(FOUND_MOVING_NS)}, and not at all after the gateway let go of it"
    return [*found, evidence(text, drive.time_ns, speed_mps=drive.said.speed_mps), *_AUTO(window)]


# Requests.

_FRESH: Final = frozenset({Reason.NONE, Reason.NOT_ENGAGED, Reason.ENGAGING, Reason.STOPPING})
"""Outcomes of the holder's fresh drive command: it renews the lease, executed or not."""

_RENEWING: Final = frozenset({"acquire", "take", "renew", "engage", "reset"})
"""Requests that renew the lease, once accepted."""

_LEFT: Final = frozenset({EventKind.STOPPED, EventKind.TAKEOVER, EventKind.GUARD})


def last_command(window: EvidenceWindow) -> Heard[Decision] | None:
    """The last valid drive command since the robot was engaged."""
    left, last = _left_or_engaged(window), _last(window, _is_obeyed)
    return None if last is None or (left is not None and last.said.tick <= left.said.tick) else last


def describe_command(window: EvidenceWindow) -> list[Link]:
    """The command at the moment, its operator, and what limited it."""
    last = last_command(window)
    if last is None:
        left = _left_or_engaged(window)
        if left is None:
            return [missing(_REQUESTS)]
        text = f"no drive command was accepted since it was engaged, {window.ago(left.time_ns)}"
        return [evidence(text), *_holes(window)] if left.said.kind is EventKind.ENGAGED else []
    said, bounds = last.said, [bound.value for bound in last.said.bound_by]
    text = f"the last valid drive command, seq {said.request_sequence} from {_who(said)}, came "
    text += f"{window.ago(last.time_ns)} and requested {_asked(said)}; "
    text += f"commanded {mps(said.output_speed_mps)}, {deg(said.output_angle_deg)}" if said.frames_sent else ""
    text += "" if said.frames_sent else "no frame was sent in its tick"
    text += f"; limited by: {', '.join(bounds).replace('_', ' ')}" if bounds else ""
    return [evidence(text, last.time_ns, **_numbers(said), bound_by=bounds)]


def _deadman(window: EvidenceWindow) -> list[Link]:
    """The last valid drive command, its age, and the refused ones after it."""
    limit_ns, origin = round(window.limits.command.deadman_s * 1e9), window.limits.origin
    state = window.last(SafetyState)
    if state is not None and state.said.deadman_s * 1e9 > limit_ns:
        limit_ns, origin = round(state.said.deadman_s * 1e9), "requested by engage"
    last = last_command(window) or _left_or_engaged(window)
    if last is None or not window.during(Decision):
        return [missing(_REQUESTS)]
    if isinstance(last.said, Decision):
        text = f"the last valid drive command was seq {last.said.request_sequence} from {_who(last.said)}, "
        text += f"in tick {last.said.tick}, {window.ago(last.time_ns)}: {_asked(last.said)}"
        data = {**_numbers(last.said), "silent_ms": (window.at_ns - last.time_ns) / 1e6}
    else:
        text = f"no drive command was accepted since it was engaged, {window.ago(last.time_ns)}"
        data = {}
    text += f"; the limit is {span(limit_ns)} ({origin})"
    found = [evidence(text, last.time_ns, **data, limit_ms=limit_ns / 1e6)]
    found += _refusals_of(
        window, [one for one in _refused_until(window, last.time_ns) if one.said.request == "drive"]
    )
    if len(found) == 1 and not window.lacks_decisions:
        found.append(evidence("no drive command followed, accepted or refused"))
    return found + _holes(window)


def _refused_until(window: EvidenceWindow, from_ns: int) -> Iterator[Heard[Decision]]:
    """The refusals from a time to the moment."""
    for one in window.all(Decision):
        if from_ns < one.time_ns <= window.at_ns and not _is_accepted(one.said):
            yield one


def _refusals_of(window: EvidenceWindow, heard: Sequence[Heard[Decision]]) -> list[Link]:
    """One link for each operator, verb and reason."""
    alike: dict[tuple[str, str, Reason], list[Heard[Decision]]] = {}
    for one in heard:
        alike.setdefault((one.said.operator, one.said.request, one.said.reason), []).append(one)
    return [_refusals(window, found) for found in alike.values()]


def _refusals(window: EvidenceWindow, heard: Sequence[Heard[Decision]]) -> Link:
    last = heard[-1]
    said = last.said
    verb = said.request or "unnamed"
    text = f"one {verb} request from {_who(said)} was refused {window.ago(last.time_ns)}"
    if len(heard) > 1:
        text = f"{len(heard)} {verb} requests from {_who(said)} were refused within "
        text += f"{span(last.time_ns - heard[0].time_ns)}, the last {window.ago(last.time_ns)}"
    text += f": {said.detail or TEXTS[said.reason].means}"
    if said.request_sequence is not None:
        age = "" if said.age_ms is None else f", {said.age_ms:.0f} ms old"
        text += f" (seq {said.request_sequence}{age})"
    return evidence(text, last.time_ns, **_numbers(said), count=len(heard), reason=said.reason.value)


def refused_lately(window: EvidenceWindow) -> list[Link]:
    """The refusals shortly before the moment."""
    return _refusals_of(window, list(_refused_until(window, window.at_ns - LATELY_NS)))


def _refused(reason: Reason) -> Finder:
    def found(window: EvidenceWindow) -> list[Link]:
        return _refusals_of(window, [one for one in _refused_until(window, 0) if one.said.reason is reason])

    return found


def _lease_expired(window: EvidenceWindow) -> list[Link]:
    """The last request that renewed the lease, and its age."""
    limit_ns = round(window.limits.command.lease_s * 1e9)
    last = _last(window, _is_renewing)
    if last is None:
        return [missing(_REQUESTS)]
    text = f"the last request that renewed the lease was {last.said.request} from {_who(last.said)}, "
    text += f"{window.ago(last.time_ns)}; a lease lasts {span(limit_ns)} ({window.limits.origin})"
    data = {"silent_ms": (window.at_ns - last.time_ns) / 1e6, "limit_ms": limit_ns / 1e6}
    return [evidence(text, last.time_ns, **_numbers(last.said), **data), *_holes(window)]


def _asked_for(*verbs: str) -> Finder:
    """The request that caused it; a stop is latched even if it is refused."""

    def did_it(said: Decision) -> bool:
        return said.request in verbs and (_is_accepted(said) or said.request == "stop")

    def found(window: EvidenceWindow) -> list[Link]:
        last = _last(window, did_it, later_ns=3 * TICK_NS)
        if last is None:
            return [missing(f"the request itself ({' or '.join(verbs)})")]
        said = last.said
        text = f"the request was {said.request} from {_who(said)}, in tick {said.tick}"
        text += f", {window.ago(last.time_ns)}" if abs(last.time_ns - window.at_ns) > TICK_NS else ""
        text += "" if _is_accepted(said) else f"; it was refused: {said.detail or TEXTS[said.reason].means}"
        return [evidence(text, last.time_ns, **_numbers(said))]

    return found


def _not_confirmed(window: EvidenceWindow) -> list[Link]:
    """The request to engage, and the chassis's mode."""
    modes = [link for finder in (_STOP, _REMOTE) for link in finder(window) if link.time_ns]
    return [*_asked_for("engage", "clear_odometer")(window), *modes]


def _left_or_engaged(window: EvidenceWindow) -> Heard[SafetyEvent] | None:
    """The last event that began or ended an engagement."""
    for one in window.until(SafetyEvent):
        # A guard's arrival or loss has no reason.
        if one.said.kind is EventKind.ENGAGED or (one.said.kind in _LEFT and one.said.reason is not Reason.NONE):
            return one
    return None


def _last(window: EvidenceWindow, test: Callable[[Decision], bool], later_ns: int = 0) -> Heard[Decision] | None:
    """The last decision of this sort; that of the moment's own tick comes a little after the event."""
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
    return "a motion that is not in the log" if speed is None or angle is None else f"{mps(speed)}, {deg(angle)}"


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
    return [missing(f"{counted(lacks, 'decision')} of these seconds")] if lacks else []


EVIDENCE: Final[dict[Reason, Finder]] = {
    Reason.LEASE_TAKEN: _asked_for("take"),
    Reason.LEASE_RELEASED: _asked_for("release"),
    Reason.LEASE_EXPIRED: _lease_expired,
    Reason.DEADMAN: _deadman,
    Reason.NOT_CONFIRMED: _not_confirmed,
    Reason.DISENGAGED: _asked_for("disengage"),
    Reason.REMOTE_STOP: _asked_for("stop"),
    Reason.BUS_DOWN: _bus,
    Reason.BUS_OFF: _health("controller", "faults"),
    Reason.BUS_ERRORS: _health("controller", "faults"),
    Reason.FEEDBACK_MISSING: _frames,
    Reason.FEEDBACK_FAULTY: _frames,
    Reason.FEEDBACK_LATE: _load,
    Reason.VARIANT_UNKNOWN: _health("variant"),
    Reason.HAND_TRANSMITTER: _REMOTE,
    Reason.MODE_NOT_AUTO: _STOP,
    Reason.FRONT_BUMPER: _turned("FrontBumper", 1),
    Reason.REAR_BUMPER: _turned("RearBumper", 1),
    Reason.IMPLAUSIBLE_SPEED: _implausible,
    Reason.NOT_MOVING: _speeds,
    Reason.BRAKE_SLIPS: _speeds,
    Reason.ROLLING: _speeds,
    Reason.OVERSPEED: _speeds,
    Reason.STEERING: _steering,
    Reason.FEEDBACK_FROZEN: _frozen,
    Reason.FOUND_MOVING: _found_moving,
    Reason.OTHER_COMMANDER: _commanders,
    Reason.LOOP_LATE: _health("tick_lateness_max_ms", "tick_lateness_p50_ms", "cpu_percent"),
    Reason.SEND_FAILED: _unsent,
    Reason.GATE: _unsent,
    Reason.NO_REALTIME: _health("realtime", "cpu_percent"),
    # Their texts say all.
    **dict.fromkeys((Reason.NONE, Reason.GUARD, Reason.UNGUARDED, Reason.SHUTDOWN), lambda _: []),
    **dict.fromkeys((Reason.GRANT_EXPIRED, Reason.GRANT_REVOKED), lambda _: []),
}
"""The finder of each reason; for any other it is ``_refused``."""


def evidence_of(reason: Reason) -> Finder:
    return EVIDENCE.get(reason) or _refused(reason)
