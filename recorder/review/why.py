"""Explain why a robot stopped, or did not move: cause, evidence, actions, latches and cure, with their numbers.

Two passes over the logs: the first reads the robot's events and states (its story), the second the seconds around
the moment and around the stop before it. What the log does not hold is one sentence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

import msgspec

from recorder.reading.logs import Faults, LogFile, logs_of
from recorder.reading.rows import Progress
from recorder.reading.survey import Survey, attached
from recorder.reading.times import in_words
from recorder.review import moment
from recorder.review.entries import Entry, EntryKind
from recorder.review.events import hung_ns
from recorder.review.evidence import describe_command, evidence_of, refused_lately
from recorder.review.moment import GatewaySilence, Story, actions, blocked_words, blocks, cause_of, cures, stops
from recorder.review.window import (
    BEFORE_NS,
    DecodedFrame,
    EvidenceWindow,
    Link,
    Step,
    before,
    counted,
    evidence,
    limits_at,
    missing,
    read_window,
    span,
)
from schemas.decisions import COMMANDING, ArbiterState, SafetyState, is_same_run
from schemas.messages import Drive, TimeNs
from schemas.reasons import ASKED_BY, TEXTS, Reason
from schemas.settings import SAFETY_STATE_PERIOD_NS, STANDSTILL_MPS

SOON_NS: Final = 1_000_000_000  # the question is about a stop that begins within this time after the moment
STALE_NS: Final = 500_000_000  # an older state does not describe the moment; states come every 50 ms
LOOKED_AT_NS: Final = 5_000_000_000  # gaps in the states are reported within this time before the moment

SHARED: Final = "Two gateways use this name: the log does not show which of them did what."


class Explanation(msgspec.Struct, frozen=True):
    """An answer.

    Attributes:
        at_ns: the moment, in nanoseconds since 1970.
        state: the arbiter's; None if the log does not have it.
        stop_ns: when the stop began; None if there is none.
        silent_ns: when the gateway went silent near the moment, and restarted or was seen to die; else None.
    """

    robot: str
    at_ns: TimeNs
    state: ArbiterState | None
    reason: Reason
    stop_ns: TimeNs | None
    silent_ns: TimeNs | None
    headline: str
    chain: list[Link]

    @property
    def is_answered(self) -> bool:
        """True if the log shows what the arbiter did at the moment."""
        return self.state is not None or self.stop_ns is not None or self.silent_ns is not None


class Explainer:
    """Explains moments of one robot's logs, whose events are read once."""

    def __init__(
        self,
        robot: str,
        logs: Sequence[LogFile],
        found: Survey,
        faults: Faults,
        progress: Progress = lambda _: None,
    ) -> None:
        self.robot = robot
        self.story = Story.read(robot, logs, faults, progress)
        self._logs = logs
        self._faults = faults
        self._configurations = attached(robot, found)
        held = logs_of(robot, logs)
        self._start_ns = min((log.start_ns for log in held), default=0)
        self._end_ns = max((log.end_ns for log in held), default=0)

    def at(self, at_ns: int) -> Explanation:
        if self.story.is_shared:
            return self._nothing(at_ns, SHARED)
        answer = _Answer(self, at_ns)
        if self._start_ns - STALE_NS <= at_ns <= self._end_ns + STALE_NS or not self._end_ns or answer.is_told:
            return answer.explanation()
        ends = (
            f"ends {span(at_ns - self._end_ns)} before it"
            if at_ns > self._end_ns
            else f"begins {span(self._start_ns - at_ns)} after it"
        )
        period = missing(f"that moment: the log covers {in_words(self._start_ns)} to {in_words(self._end_ns)}")
        return self._nothing(at_ns, f"The log does not cover that moment: it {ends}.", period)

    def _nothing(self, at_ns: int, why: str, *links: Link) -> Explanation:
        return Explanation(self.robot, at_ns, None, Reason.NONE, None, None, why, list(links))

    def last(self) -> Explanation:
        """Explain the last stop, or the death of a gateway in command if that was later."""
        died = [one for one in self.story.silences if not one.is_hang and one.was_active]
        ends = [one.time_ns for one in (self.story.last_stop(), *died[-1:]) if one is not None]
        return self.at(max(ends, key=self.story.order_ns, default=self._end_ns))

    def window(self, at_ns: int) -> EvidenceWindow:
        limits = limits_at(at_ns, self.robot, self._configurations, self._faults)
        shift_ns, is_steady = self.story.offset_ns(at_ns), self.story.is_steady(at_ns)
        window = EvidenceWindow(self.robot, at_ns, shift_ns, limits, is_steady=is_steady)
        return read_window(window, self._logs, self._faults)


class _Answer:
    """Builds the chain of links."""

    def __init__(self, explainer: Explainer, at_ns: int) -> None:
        self._explainer = explainer
        self._story = explainer.story
        self._now = explainer.window(at_ns)
        self._hang = self._hang_with_stop()
        self._state = self._state_then()
        self._focus = self._stop_asked_about()
        self._silence = self._silence_of_gateway()

    @property
    def is_told(self) -> bool:
        """True if the log shows the arbiter, or the death of its gateway."""
        return self._state is not None or (self._silence is not None and self._silence.then is None)

    @property
    def _is_active(self) -> bool:
        return self._state is not None and self._state.state is not ArbiterState.STANDBY

    def _hang_with_stop(self) -> GatewaySilence | None:
        """The hang at the moment, or the one whose guard stop is the stop at the moment."""
        at_ns, story = self._now.at_ns, self._story
        begun = (one for one in reversed(story.silences) if at_ns - BEFORE_NS <= one.time_ns <= at_ns + SOON_NS)
        hangs = (one for one in begun if one.is_hang and one.was_active and story.is_steady(one.time_ns))
        hang = next(hangs, None)
        if hang is None or not any(one.reason is Reason.GUARD for one in self._stops_of(hang)):
            return None
        is_last = at_ns < hang.end_ns or story.stop_before(at_ns) in {None, *self._stops_of(hang)}
        return hang if is_last else None

    def _stops_of(self, hang: GatewaySilence) -> list[Entry]:
        """The entries of a hang's stop: the guard's, and what the gateway found when it continued."""
        behind = self._story.after(hang.end_ns - 1)
        return [one for one in behind if stops(one) and one.time_ns <= hang.end_ns + SOON_NS]

    def _state_then(self) -> SafetyState | None:
        """The arbiter's state; None if there is none, or its gateway had gone silent."""
        now, heard = self._now, self._now.last(SafetyState)
        if heard is None or now.at_ns - heard.time_ns > STALE_NS:
            return None
        silence = self._last_silence()
        return None if silence is not None and silence.end_ns > now.at_ns else heard.said

    def _stop_asked_about(self) -> Entry | None:
        """The stop at the moment; an engagement or a restart of the gateway ends the one before."""
        story, state, at_ns = self._story, self._state, self._now.at_ns
        if self._hang is not None:
            return next(one for one in self._stops_of(self._hang) if one.reason is Reason.GUARD)
        stop = story.stop_before(at_ns)
        is_stopping = state is not None and state.state is ArbiterState.STOPPING
        if state is not None and is_stopping and stop is not None and stop.reason is state.stop_reason:
            return stop
        is_commanding = state is not None and state.state in COMMANDING
        soon = story.next_stop(at_ns)
        if soon is not None and soon.time_ns <= at_ns + (SOON_NS if is_commanding else SAFETY_STATE_PERIOD_NS):
            return soon
        if is_commanding or stop is None:
            return None
        if state is not None:
            return stop if stop.tick is None or is_same_run(state.tick, stop.tick) else None
        if at_ns - stop.time_ns > BEFORE_NS:
            return None  # What happened since is not known.
        silence = self._last_silence()
        return stop if silence is None or silence.was.said.state is ArbiterState.STOPPING else None

    def _last_silence(self) -> GatewaySilence | None:
        """The last end of a run, if it was shortly before the moment."""
        at_ns = self._now.at_ns
        ends = (one for one in reversed(self._story.silences) if not one.is_hang and one.time_ns < at_ns)
        last = next(ends, None)
        return None if last is None or at_ns - last.time_ns > BEFORE_NS else last

    def _silence_of_gateway(self) -> GatewaySilence | None:
        """The gateway's silence at or soon after the moment; else the one before, if nothing came since."""
        at_ns, heard, silence = self._now.at_ns, self._now.last(SafetyState), self._last_silence()
        if self._is_active or self._hang is not None:
            soon = (one for one in self._story.silences if at_ns <= one.time_ns <= at_ns + SOON_NS)
            return next((one for one in soon if self._is_active and not one.is_hang and one.was_active), None)
        if self._state is not None:
            return None if self._focus is not None else silence
        has_followed = silence is not None and heard is not None and heard.time_ns >= silence.end_ns
        return None if has_followed else silence  # The run after it has ended too.

    def explanation(self) -> Explanation:
        now, state, focus, silence = self._now, self._state, self._focus, self._silence
        links = [moment.motion(now), moment.arbiter(state), *self._command()]
        if silence is not None:
            links += self._silent(silence)
        frames = self._frames_of_guard()
        stop_ns = None if focus is None else frames[0].bus_time_ns if frames else focus.time_ns
        if focus is not None and stop_ns is not None:
            links += self._stop(focus, stop_ns)
        reason = Reason.NONE if focus is None else focus.reason
        links += [*self._blocked(reason), *_lacks(now), *self._untold()]
        return Explanation(
            robot=now.robot,
            at_ns=now.at_ns,
            state=None if state is None else state.state,
            reason=reason,
            stop_ns=stop_ns,
            silent_ns=None if silence is None else silence.time_ns,
            headline=self._headline(),
            chain=list({(one.step, one.text): one for one in reversed(links)}.values())[::-1],
        )

    def _headline(self) -> str:
        now, state, silence, hang, focus = self._now, self._state, self._silence, self._hang, self._focus
        if hang is not None:
            speed_mps, frames = self._speed_mps(hang), self._frames_of_guard()
            text = f"The gateway's loop hung for {span(hang.end_ns - hang.time_ns)}, starting "
            text += f"{now.ago(hang.time_ns)}, {hang.was.said.state.value}"
            text += "" if speed_mps is None else f", at {speed_mps:.2f} m/s"
            after = f" {span(frames[0].bus_time_ns - hang.time_ns)} after the last state" if frames else ""
            return f"{text}: the guard began to stop the robot{after}."
        latches = [self._story.latch_before(one, now.at_ns) for one in ([] if state is None else state.latched)]
        latch = max((one for one in latches if one is not None), key=lambda one: one.time_ns, default=None)
        said = moment.headline(now, state, focus, "" if focus is None else self._why(focus), latch)
        if silence is None:
            return said
        fell = self._fell(silence, f" {before(silence.time_ns, now.at_ns)}")
        then = f"; it restarted {before(silence.end_ns, now.at_ns)}" if silence.then is not None else ""
        told = f"{fell[0].upper()}{fell[1:]}{then}."
        return told if state is None else f"{said} {told}"

    def _why(self, focus: Entry) -> str:
        """The cause of a stop in words, with the speed of a robot that was found moving."""
        why = cause_of(focus)
        drive = self._now.last(Drive, focus.time_ns)
        if focus.reason is Reason.FOUND_MOVING and drive is not None and drive.said.speed_mps >= STANDSTILL_MPS:
            return f"found moving at {drive.said.speed_mps:.2f} m/s, with no client in command"
        refused = _refused_before(evidence_of(focus.reason)(self._now)) if focus.reason is Reason.DEADMAN else None
        if refused is None or "refused" in why:
            return why
        return f"{why}; {counted(refused[1], 'drive command')} refused: {TEXTS[refused[0]].means}"

    def _command(self) -> list[Link]:
        found = refused_lately(self._now) if self._state is not None else []
        found = [*describe_command(self._now), *found] if self._is_active else found
        steps = {Step.EVIDENCE: Step.COMMAND}
        return [msgspec.structs.replace(link, step=steps.get(link.step, link.step)) for link in found]

    # A gateway that said nothing.

    def _speed_mps(self, silence: GatewaySilence) -> float | None:
        """The robot's, when a silence began; None if the log does not have it."""
        drive = self._now.last(Drive, silence.time_ns)
        return drive.said.speed_mps if drive is not None and drive.time_ns > silence.time_ns - STALE_NS else None

    def _fell(self, silence: GatewaySilence, when: str = "") -> str:
        """The start of a silence in words, with the state of gateway and robot."""
        fell = "shut down as requested" if silence.was_told else "went silent"
        speed_mps = self._speed_mps(silence)
        motion = f", at {speed_mps:.2f} m/s" if (speed_mps or 0.0) >= STANDSTILL_MPS else ", standing"
        motion = "" if speed_mps is None else motion
        noticed = f" ({silence.text})" if silence.text else ""
        return f"the gateway {fell}{when}, {silence.was.said.state.value}{motion}{noticed}"

    def _silent(self, silence: GatewaySilence) -> Iterator[Link]:
        said = silence.was.said
        data = {
            "state": said.state.value,
            "lease_holder": said.lease_holder,
            "speed_mps": self._speed_mps(silence),
            "output_speed_mps": said.output_speed_mps,
            "guarded": said.guarded,
            "silent_ms": None if silence.then is None else (silence.end_ns - silence.time_ns) / 1e6,
        }
        told = f"; commanded {said.output_speed_mps:.2f} m/s" if said.state is ArbiterState.ENGAGED else ""
        yield Link(Step.CAUSE, f"{self._fell(silence)}{told}", silence.time_ns, data)
        if silence.then is None:
            return
        text = f"the gateway restarted {span(silence.end_ns - silence.time_ns)} later: "
        yield Link(Step.CAUSE, f"{text}earlier leases, engagement and latches are void", silence.end_ns)
        if silence.was_active:
            yield from self._found_by(silence.then.said, is_guarded=said.guarded)
            yield from self._drove_on(silence)

    def _found_by(self, first: SafetyState, *, is_guarded: bool) -> Iterator[Link]:
        """The findings of the next gateway, before the robot was engaged again."""
        found = list(self._story.of_run(first.tick))
        of_guard = (one for one in found if one.reason is Reason.GUARD)
        guard = [one for one in of_guard if one.kind is EntryKind.LATCH or one.tells_of_guard]
        for one in found:
            # The guard's note has its own times; without one there is only the gateway's text.
            note = one.text.partition(f"{TEXTS[Reason.GUARD].means}; ")[2] if one in guard else ""
            if note:
                yield Link(Step.ACTION, f"the guard's note, found at the next start: {note}", one.time_ns)
            elif one in guard or stops(one):
                yield Link(Step.ACTION, f"the next gateway reported: {one.text}", one.time_ns)
        if not guard:
            watched = "what the guard did"
            yield missing(watched if is_guarded else "what the chassis did; no guard watched the gateway")
        elif not any(one.tells_of_guard for one in guard):
            yield missing("the guard's note that the robot stood")

    def _drove_on(self, silence: GatewaySilence) -> Iterator[Link]:
        """The robot's motion without a gateway, by the first frames that the next one received."""
        from_ns, window = silence.time_ns, self._now
        if abs(from_ns - window.at_ns) > SOON_NS:
            window = self._explainer.window(from_ns)
        speeds = window.speeds_after(from_ns)
        # The first samples may still be from the gateway that died.
        pauses = [now_ns - was_ns for (was_ns, _), (now_ns, _) in pairwise([(from_ns, 0.0), *speeds])]
        if not pauses or max(pauses) < STALE_NS:
            return
        speeds = speeds[pauses.index(max(pauses)) :]
        seen_ns, seen_mps = speeds[0]
        text = f"{span(seen_ns - from_ns)} later, in the next gateway's first drive feedback, the robot "
        if seen_mps < STANDSTILL_MPS:
            text += f"stood, at {seen_mps:.2f} m/s; when it stopped is not in the log"
            yield evidence(text, seen_ns, speed_mps=seen_mps)
            return
        stood_ns = next((at_ns for at_ns, mps in speeds if mps < STANDSTILL_MPS), None)
        metres = min(self._speed_mps(silence) or 0.0, seen_mps) * (seen_ns - from_ns) / 1e9
        for (was_ns, was_mps), (now_ns, now_mps) in pairwise(speeds):
            if stood_ns is None or now_ns <= stood_ns:
                metres += (was_mps + now_mps) / 2 * (now_ns - was_ns) / 1e9
        text += f"still moved, at {seen_mps:.2f} m/s: it drove at least {metres:.1f} m"
        text += "" if stood_ns is None else f", and stood after {span(stood_ns - from_ns)}"
        stood_after_s = None if stood_ns is None else (stood_ns - from_ns) / 1e9
        yield evidence(text, seen_ns, speed_mps=seen_mps, distance_m=metres, stood_after_s=stood_after_s)

    def _frames_of_guard(self) -> list[DecodedFrame]:
        """The guard's frames on the bus during a hang."""
        hang = self._hang
        return [] if hang is None else self._now.commands_between(hang.time_ns, hang.end_ns)

    # The stop.

    def _stop(self, focus: Entry, began_ns: int) -> Iterator[Link]:
        window = self._now if began_ns == self._now.at_ns else self._explainer.window(began_ns)
        window.what = "the takeover" if focus.reason is Reason.HAND_TRANSMITTER else "the stop"
        window.detail = focus.text
        who = focus.operator if focus.operator not in focus.text else ""
        by = "" if not who else f", by {who}" if focus.reason in ASKED_BY else f"; {who} held the lease"
        yield Link(Step.CAUSE, f"{focus.text}{by}", focus.time_ns, {"reason": focus.reason.value})
        if self._hang is not None:
            yield from self._hung(self._hang)
        shown = evidence_of(focus.reason)(window)
        yield from shown
        yield from actions(window, focus.reason)
        latched = [] if self._state is None else list(self._state.latched)
        behind = next((one.said for one in window.after(SafetyState, focus.time_ns - 1)), None)
        for reason in dict.fromkeys([*latched, *([] if behind is None else behind.latched)]):
            yield self._latch(reason, focus)
        is_past = self._state is not None and focus.tick is not None and self._state.tick >= focus.tick
        refused = _refused_before(shown) if focus.reason is Reason.DEADMAN else None
        cured = focus.reason if refused is None else refused[0]
        yield from cures(cured, window.robot, is_reset=is_past and focus.reason not in latched)
        yield from _lacks(window)

    def _hung(self, hang: GatewaySilence) -> Iterator[Link]:
        """The hang of the gateway, and the first frame of its guard."""
        stood_ns, frames = hang.end_ns - hang.time_ns, self._frames_of_guard()
        text = f"the gateway's loop hung for {span(stood_ns)}; then the same run continued"
        data = {"silent_ms": stood_ns / 1e6, "speed_mps": self._speed_mps(hang)}
        yield Link(Step.CAUSE, text, hang.time_ns, data)
        if not frames:
            yield missing("the guard's frames")
            return
        after_ns = frames[0].bus_time_ns - hang.time_ns
        text = f"the guard began {span(after_ns)} after the last state: it sent "
        text += f"{counted(len(frames), 'frame')}, the first: {frames[0]}"
        yield evidence(text, frames[0].bus_time_ns, frames=len(frames), after_ms=after_ns / 1e6)

    def _latch(self, reason: Reason, focus: Entry | None = None) -> Link:
        at_ns = self._now.at_ns
        entry = self._story.latch_before(reason, at_ns + SOON_NS)
        if entry is None:
            return Link(Step.LATCH, f"latched: {reason.value}; since when is not in the log")
        with_this = focus is not None and entry.tick == focus.tick
        when = before(entry.time_ns, at_ns) + (f" by {entry.operator}" if entry.operator else "")
        text = f"latched {'with this stop' if with_this else when}: {reason.value}"
        reset = self._story.reset_of(entry)
        if reset is None:
            text += "; no reset of it is in the log"
        else:
            by = f" by {reset.operator}" if reset.operator else ""
            text += f"; reset{by} {span(reset.time_ns - entry.time_ns)} later"
        return Link(Step.LATCH, text, entry.time_ns, {"reason": reason.value})

    def _blocked(self, told: Reason) -> Iterator[Link]:
        """Everything else that blocked motion or engagement at the moment."""
        state = self._state
        if state is None:
            return
        blocked_by = [one for one in state.blocked_by if one is not told and blocks(one, self._now, state)]
        for reason in blocked_by:
            if reason not in moment.PLAIN:
                yield Link(Step.CAUSE, blocked_words(reason, state), None, {"reason": reason.value})
                yield from [self._latch(reason)] if reason in state.latched else evidence_of(reason)(self._now)
        for reason in blocked_by:
            yield from cures(reason, self._now.robot, blocked_by, is_reset=reason not in state.latched)

    def _untold(self) -> Iterator[Link]:
        """Yield a link if the log ends or pauses before the answer is known."""
        at_ns, focus = self._now.at_ns, self._focus
        if self._silence is not None or self._hang is not None:
            return
        stop = self._story.stop_before(at_ns)
        if self._state is None and focus is None and stop is not None:
            yield missing(f"what happened after the last stop, {before(stop.time_ns, at_ns)}")
        if self._is_active and max(one.time_ns for one in self._now.all(SafetyState)) < at_ns + SOON_NS:
            yield missing("the seconds after this: the gateway died, or the recording ended")


def _refused_before(shown: Sequence[Link]) -> tuple[Reason, int] | None:
    """In the evidence of a deadman, the most frequent refusal of drive commands and its count; None if none."""
    refused = [link.data for link in shown if "count" in link.data and "reason" in link.data]
    most = max(refused, key=lambda data: int(data["count"]), default=None)
    return None if most is None else (Reason(most["reason"]), int(most["count"]))


def _lacks(window: EvidenceWindow) -> Iterator[Link]:
    """Gaps of this time, by the arbiter's states and by the recorder."""
    states = [one for one in window.all(SafetyState) if one.time_ns > window.at_ns - LOOKED_AT_NS]
    for was, now in pairwise(states):
        silent_ns = now.time_ns - was.time_ns
        is_hole = is_same_run(was.said.tick, now.said.tick) and not hung_ns(was.said, now.said, silent_ns)
        if is_hole and was.time_ns < window.at_ns and silent_ns > STALE_NS:
            yield missing(f"{span(silent_ns)} of the arbiter's states, from {window.ago(was.time_ns)} on")
    for gap in window.gaps:
        yield missing(f"{gap.count} messages of {gap.key} that the recorder received ({gap.reason.value})")
