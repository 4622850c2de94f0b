"""Evidence from requests: the last acceptable command, who asked to stop, what was refused, and the numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Final

from recorder.review.reasoning.chain import Link, count, evidence, missing, mps, span, zero
from recorder.review.reasoning.window import EvidenceWindow, Heard
from schemas.decisions import Decision, EventKind, SafetyEvent, SafetyState, Verdict
from schemas.reasons import TEXTS, Reason
from schemas.settings import ENGAGE_TIMEOUT_NS, TICK_NS

_NS_PER_S: Final = 1e9

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

LATELY_NS: Final = 3_000_000_000
"""A refusal that was longer ago is none of the moment's."""

_COUNTED: Final = re.compile(r"none for (\d+) ms")

_LEFT: Final = frozenset({EventKind.STOPPED, EventKind.TAKEOVER, EventKind.GUARD})

Test = Callable[[Decision], bool]


def deadman(window: EvidenceWindow) -> list[Link]:
    """Return the last acceptable drive command, its age, and its successors.

    A decision is told some time after its tick has begun, from which the arbiter counts: its own figure, in the
    detail, is the right one.
    """
    if not window.during(Decision):
        return [missing("no decision of these seconds is in the log, so which commands came is not known")]
    last = _last(window, _is_obeyed)
    engaged = next((one for one in window.until(SafetyEvent) if one.said.kind is EventKind.ENGAGED), None)
    limit_ns, origin = round(window.limits.command.deadman_s * _NS_PER_S), window.limits.origin
    state = window.last(SafetyState)
    if state is not None and state.said.deadman_s * _NS_PER_S > limit_ns:
        limit_ns, origin = round(state.said.deadman_s * _NS_PER_S), "as engage asked for"
    limit = f"the limit is {span(limit_ns)} ({origin})"
    if last is not None and (engaged is None or last.time_ns >= engaged.time_ns):
        said = last.said
        age_ns = window.at_ns - last.time_ns
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
        return [evidence(text, last.time_ns, **numbers, limit_ms=limit_ns / 1e6), *_since(window, last.time_ns)]
    if engaged is not None:
        text = f"no drive command was accepted since it was engaged, {window.ago(engaged.time_ns)}; {limit}"
        link = evidence(text, engaged.time_ns, limit_ms=limit_ns / 1e6)
        return [link, *_since(window, engaged.time_ns)]
    return [missing(f"no acceptable drive command before this is in the log; {limit}"), *_since(window, 0)]


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
        text += f" (seq {said.request_sequence}" + (
            f", {said.age_ms:.0f} ms old)" if said.age_ms is not None else ")"
        )
    return evidence(text, last.time_ns, **_numbers(said), count=len(heard), reason=said.reason.value)


def refused(window: EvidenceWindow, reason: Reason) -> list[Link]:
    """The requests that were refused for this reason lately; nothing if none was."""
    by_who: dict[tuple[str, str], list[Heard[Decision]]] = {}
    for one in window.during(Decision):
        if one.time_ns <= window.at_ns and one.said.reason is reason:
            by_who.setdefault((one.said.operator, one.said.request), []).append(one)
    return [_refusals(window, heard) for heard in by_who.values()]


def refused_lately(window: EvidenceWindow) -> list[Link]:
    """All that was refused right before the moment."""
    alike: dict[tuple[str, str, Reason], list[Heard[Decision]]] = {}
    for one in window.all(Decision):
        if window.at_ns - LATELY_NS < one.time_ns <= window.at_ns and not _is_accepted(one.said):
            alike.setdefault((one.said.operator, one.said.request, one.said.reason), []).append(one)
    return [_refusals(window, heard) for heard in alike.values()]


def lease_expired(window: EvidenceWindow) -> list[Link]:
    """The last sign of the lease's holder, and its age."""
    limit_ns = round(window.limits.command.lease_s * _NS_PER_S)
    limit = f"a lease lasts {span(limit_ns)} ({window.limits.origin})"
    last = _last(window, _is_renewing)
    if last is None:
        return [missing(f"no request that keeps the lease is in the log before this; {limit}"), *_holes(window)]
    said = last.said
    text = f"the last request that kept the lease was {said.request!a} of {_who(said)}, ".replace("'", "")
    text += f"{window.ago(last.time_ns)}; {limit}"
    silent_ms = (window.at_ns - last.time_ns) / 1e6
    return [
        evidence(text, last.time_ns, **_numbers(said), silent_ms=silent_ms, limit_ms=limit_ns / 1e6),
        *_holes(window),
    ]


def asked(window: EvidenceWindow, *verbs: str) -> list[Link]:
    """The request that did it: one that was accepted, or a stop that was latched although it was refused."""

    def did_it(said: Decision) -> bool:
        return said.request in verbs and (_is_accepted(said) or _is_latched_though_refused(said))

    last = _last(window, did_it, later_ns=3 * TICK_NS)
    if last is None:
        words = " or ".join(verbs)
        return [missing(f"the request itself ({words}) is not in the log"), *_holes(window)]
    said = last.said
    text = f"the request was {said.request}, of {_who(said)}, judged in tick {said.tick}"
    text += f", {window.ago(last.time_ns)}" if abs(last.time_ns - window.at_ns) > TICK_NS else ""
    if not _is_accepted(said):
        text += f"; it was refused: {said.detail or TEXTS[said.reason].means}"
    others = [
        one for one in window.during(Decision) if did_it(one.said) and last.time_ns < one.time_ns < window.over_ns
    ]
    text += f"; {count(len(others), 'more came', 'more came')} after it" if others else ""
    return [evidence(text, last.time_ns, **_numbers(said))]


def not_confirmed(window: EvidenceWindow) -> list[Link]:
    """The request to engage, and the time that the chassis was given."""
    last = _last(window, lambda said: said.request in {"engage", "clear_odometer"} and _is_accepted(said))
    limit = f"it has {span(ENGAGE_TIMEOUT_NS)}"
    if last is None:
        return [missing(f"the request that the chassis was to confirm is not in the log; {limit}")]
    text = f"the request was {last.said.request}, of {_who(last.said)}, {window.ago(last.time_ns)}; {limit}"
    age_ms = (window.at_ns - last.time_ns) / 1e6
    return [evidence(text, last.time_ns, **_numbers(last.said), age_ms=age_ms, limit_ms=ENGAGE_TIMEOUT_NS / 1e6)]


def last_command(window: EvidenceWindow) -> Heard[Decision] | None:
    """Return the last acceptable drive command to an engaged robot: earlier ones do not count."""
    left = _left_or_engaged(window)
    last = _last(window, _is_obeyed)
    return None if last is None or (left is not None and last.said.tick <= left.said.tick) else last


def describe_command(window: EvidenceWindow) -> list[Link]:
    """The command at the moment, its operator, and what bound it."""
    last = last_command(window)
    if last is None:
        left = _left_or_engaged(window)
        if left is None:
            text = "no acceptable drive command is in the log in the seconds before"
        elif left.said.kind is EventKind.ENGAGED:
            text = f"no drive command was accepted since it was engaged, {window.ago(left.time_ns)}"
        else:
            return []
        return [evidence(text), *_holes(window)]
    said = last.said
    text = f"the last acceptable drive command, seq {said.request_sequence} of {_who(said)}, came "
    text += f"{window.ago(last.time_ns)} and asked for {_asked(said)}; "
    if said.frames_sent:
        text += f"the chassis was told {mps(said.output_speed_mps)}, {zero(said.output_angle_deg):.1f} deg"
    else:
        text += "no frame went out in its tick"
    if said.bound_by:
        text += f"; bound by: {', '.join(bound.value.replace('_', ' ') for bound in said.bound_by)}"
    return [evidence(text, last.time_ns, **_numbers(said), bound_by=[bound.value for bound in said.bound_by])]


def _left_or_engaged(window: EvidenceWindow) -> Heard[SafetyEvent] | None:
    """With what the last drive commands began, or ended, to count."""
    for one in window.until(SafetyEvent):
        # That a guard is there, or is gone, has no reason.
        if one.said.kind is EventKind.ENGAGED or (one.said.kind in _LEFT and one.said.reason is not Reason.NONE):
            return one
    return None


def _last(window: EvidenceWindow, test: Test, later_ns: int = 0) -> Heard[Decision] | None:
    """Return the last decision of this sort; one of the moment's own tick comes a bit later than the event."""
    return next((one for one in window.until(Decision, window.at_ns + later_ns) if test(one.said)), None)


def _is_accepted(said: Decision) -> bool:
    return said.verdict is Verdict.ACCEPTED


def _is_latched_though_refused(said: Decision) -> bool:
    return said.request == "stop" and said.reason in _LATCHED_THOUGH_REFUSED


def _is_obeyed(said: Decision) -> bool:
    return said.request == "drive" and _is_accepted(said)


def _is_renewing(said: Decision) -> bool:
    if said.request == "drive":
        return said.reason in _FRESH
    return said.request in _RENEWING and _is_accepted(said)


def _asked(said: Decision) -> str:
    speed, angle = said.requested_speed_mps, said.requested_angle_deg
    if speed is None or angle is None:
        return "nothing that the log tells"
    return f"{mps(speed)}, {zero(angle):.1f} deg"


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
    return (
        [missing(f"{count(lacks, 'decision')} of these seconds are not in the log; a request may be among them")]
        if lacks
        else []
    )
