"""The reason of a stop, or of standing: from frames and requests to the decision, in sentences, with the numbers.

The moment is looked at first: what the robot did, what the arbiter did, what was commanded. Then the stop that
was under way or had been before it: its cause, what shows it, what was done, what is latched, what would cure it.
What the log does not show is said, and nothing is claimed of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Final

import msgspec

from recorder.reading.configurations import attached
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile, logs_of
from recorder.reading.rows import END_OF_TIME_NS, Progress
from recorder.reading.survey import Survey
from recorder.reading.times import in_words
from recorder.review.clock import NEAR_NS
from recorder.review.entries import Entry
from recorder.review.reasoning import silence as silences
from recorder.review.reasoning import story as stories
from recorder.review.reasoning.blockers import PLAIN, blocked_words, blocks, cures
from recorder.review.reasoning.chain import Link, Step, before, missing, span
from recorder.review.reasoning.evidence import evidence_of
from recorder.review.reasoning.moment import arbiter, headline, motion
from recorder.review.reasoning.request_evidence import describe_command, refused_lately
from recorder.review.reasoning.silence import GatewaySilence, last_silence, next_silence
from recorder.review.reasoning.stopping import actions
from recorder.review.reasoning.story import Story
from recorder.review.reasoning.window import BEFORE_NS, EvidenceWindow, Heard, WindowReader, is_other_run
from schemas.decisions import COMMANDING, ArbiterState, SafetyState, is_same_run
from schemas.messages import TimeNs
from schemas.reasons import Reason
from schemas.settings import SAFETY_STATE_PERIOD_NS

SOON_NS: Final = 1_000_000_000
"""A stop that begins so soon after the moment is what is asked about."""

STALE_NS: Final = 500_000_000
"""A state that is older says nothing of the moment; it comes every 50 ms."""

LOOKED_AT_NS: Final = 5_000_000_000
"""A break in the states is reported within this time before the moment."""

LATCHES_SHOWN: Final = 3
"""Latches besides that of the stop whose evidence is looked for."""


class Explanation(msgspec.Struct, frozen=True):
    """An answer.

    Attributes:
        at_ns: the moment, in nanoseconds since 1970.
        state: the arbiter's at that moment; None if the log does not have it.
        reason: that of the stop that is explained; ``none`` if there is none.
        stop_ns: when that stop began; None if there is none.
        silent_ns: when the gateway fell silent, if another one began after it or a recorder saw it die; None if it
            did not, or long before or after the moment.
        headline: the answer in one sentence.
        chain: the links that lead to it.
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
        """True if the log shows what the arbiter did."""
        return self.state is not None or self.stop_ns is not None or self.silent_ns is not None


def explain(
    robot: str,
    logs: Sequence[LogFile],
    found: Survey,
    at_ns: int | None,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Explanation:
    """Explain why the robot stopped, or did not move.

    Args:
        robot: its name.
        logs: in the order of their beginnings.
        found: the survey of these logs.
        at_ns: the moment, in nanoseconds since 1970; if it is None, the last stop of the logs, or when a gateway
            that died at work was last received, whichever is later.
        faults: takes what cannot be read.
        progress: receives the number of bytes that were read.
    """
    explainer = Explainer(robot, logs, found, faults, progress)
    return explainer.last() if at_ns is None else explainer.at(at_ns)


class Explainer:
    """Explains moments of one robot's logs; its events are read once for all of them.

    Args:
        robot: its name.
        logs: in the order of their beginnings.
        found: the survey of these logs.
        faults: takes what cannot be read.
        progress: receives the number of bytes that were read.
    """

    def __init__(
        self,
        robot: str,
        logs: Sequence[LogFile],
        found: Survey,
        faults: Faults,
        progress: Progress = lambda _: None,
    ) -> None:
        self._robot = robot
        self._logs = logs
        self._faults = faults
        self._progress = progress
        self._reader = WindowReader(robot, logs, attached(robot, found), faults)
        self._told = stories.told(robot, logs, faults, progress)

    @cached_property
    def _derived(self) -> Story:
        return stories.derived(self._robot, self._logs, self._faults, self._progress)

    def at(self, at_ns: int) -> Explanation:
        """Explain a moment, in nanoseconds since 1970."""
        return self._explain(at_ns, self._told, None)

    def last(self) -> Explanation:
        """Explain the last stop of the logs, or the death of a gateway at work if that was later."""
        robot, logs, progress = self._robot, self._logs, self._progress
        story = self._told if self._told.last_stop() is not None else self._derived
        stop = story.last_stop()
        from_ns = 0 if stop is None else stop.time_ns - NEAR_NS
        ended = stories.endings(robot, logs, from_ns, self._faults, progress)
        at_ns = max(
            (one.time_ns for one in (stop, ended.died, story.death(END_OF_TIME_NS)) if one is not None),
            default=_period(robot, logs)[1],
        )
        return self._explain(at_ns, story, ended.last)

    def _explain(self, at_ns: int, story: Story, last: Heard[SafetyState] | None) -> Explanation:
        answer = _Answer(self._reader, story, at_ns)
        if not answer.is_told:
            answer = _Answer(self._reader, self._derived, at_ns)
        return answer.beyond(*_period(self._robot, self._logs)) or answer.explanation(last)


def _period(robot: str, logs: Sequence[LogFile]) -> tuple[int, int]:
    """The first and the last log time of the files that hold a robot, of all where none says so; 0 if none is."""
    of = logs_of(robot, logs)
    return min((log.start_ns for log in of), default=0), max((log.end_ns for log in of), default=0)


def _state(now: EvidenceWindow) -> SafetyState | None:
    """The arbiter's at the moment; None if there is none, or if its gateway had fallen silent."""
    heard, silence = now.last(SafetyState), last_silence(now)
    if heard is None or now.at_ns - heard.time_ns > STALE_NS:
        return None
    return None if silence is not None and silence.then.time_ns > now.at_ns else heard.said


def _focus(story: Story, state: SafetyState | None, now: EvidenceWindow) -> Entry | None:
    """The stop that is asked about.

    None but one that was not followed by an engagement or by another run of the gateway: those ended it.
    """
    stop = story.stop_before(now.at_ns)
    is_stopping = state is not None and state.state is ArbiterState.STOPPING
    if state is not None and is_stopping and stop is not None and stop.reason is state.stop_reason:
        return stop
    is_commanding = state is not None and state.state in COMMANDING
    soon = story.next_stop(now.at_ns)
    if soon is not None and soon.time_ns <= now.at_ns + (SOON_NS if is_commanding else SAFETY_STATE_PERIOD_NS):
        return soon
    if is_commanding or stop is None:
        return None
    if state is not None:
        return stop if stop.tick is None or is_same_run(state.tick, stop.tick) else None
    if now.at_ns - stop.time_ns > BEFORE_NS:
        return None  # What was since is not known.
    silence = last_silence(now)
    return stop if silence is None or silence.was_stopping else None


class _Answer:
    """Puts the links together.

    Args:
        reader: the robot's logs.
        story: its events.
        at_ns: the moment.
    """

    def __init__(self, reader: WindowReader, story: Story, at_ns: int) -> None:
        self._reader = reader
        self._story = story
        self._now = self._window(at_ns)
        self._state = _state(self._now)
        self._focus = _focus(story, self._state, self._now)
        self._silence = self._silence_of_gateway()
        self._death = self._death_of_gateway()

    @property
    def is_told(self) -> bool:
        """True if the events mention the stop that the state mentions, if any; and their times can be believed."""
        state, focus = self._state, self._focus
        if self._story.off_ns(self._now) is None:
            return False
        if state is None or state.state in COMMANDING or state.stop_reason is Reason.NONE:
            return True
        return focus is not None and focus.reason is state.stop_reason

    def beyond(self, start_ns: int, end_ns: int) -> Explanation | None:
        """The answer for a moment outside of the logs, which go from one log time to another; else None."""
        at_ns = self._now.at_ns
        is_held = start_ns - STALE_NS <= at_ns <= end_ns + STALE_NS or not end_ns
        if is_held or self._state is not None or self._death is not None:
            return None
        ends = (
            f"ends {span(at_ns - end_ns)} before it"
            if at_ns > end_ns
            else f"begins {span(start_ns - at_ns)} after it"
        )
        return Explanation(
            robot=self._now.robot,
            at_ns=at_ns,
            state=None,
            reason=Reason.NONE,
            stop_ns=None,
            silent_ns=None,
            headline=f"The log does not hold that moment: it {ends}.",
            chain=[missing(f"the log goes from {in_words(start_ns)} to {in_words(end_ns)}")],
        )

    def explanation(self, last: Heard[SafetyState] | None) -> Explanation:
        """The answer; with the last state of the logs, if no moment was asked about."""
        now, state, focus, silence, death = self._now, self._state, self._focus, self._silence, self._death
        links = [*motion(now), *arbiter(now, state), *self._command()]
        if silence is not None:
            after = self._story.next_run(silence.heard_ns, silence.was.said.tick)
            links += silences.links(silence, silences.guard_links(after) if silence.was_active else [])
        elif death is not None:
            links += self._what_followed(death)
        if focus is not None:
            links += self._stop(focus)
        reason = Reason.NONE if focus is None else focus.reason
        links += self._blocked(reason)
        links += _lacks(now)
        links += self._untold(last)
        return Explanation(
            robot=now.robot,
            at_ns=now.at_ns,
            state=None if state is None else state.state,
            reason=reason,
            stop_ns=None if focus is None else focus.time_ns,
            silent_ns=silence.heard_ns if silence is not None else None if death is None else death.time_ns,
            headline=self._headline(),
            chain=_once(links),
        )

    @property
    def _is_active(self) -> bool:
        """True if the arbiter is at work at the moment, as far as the log shows."""
        return self._state is not None and self._state.state is not ArbiterState.STANDBY

    def _silence_of_gateway(self) -> GatewaySilence | None:
        """Return the gateway's silence at the moment, or soon after it; else before it, if nothing came since."""
        if self._is_active:
            return next_silence(self._now, SOON_NS)
        silence, last = last_silence(self._now), self._now.last(SafetyState)
        if self._state is not None:
            return None if self._focus is not None else silence
        if silence is not None and last is not None and last.time_ns >= silence.then.time_ns:
            return None  # The gateway that began then has been heard, and its own end is not told.
        return silence

    def _death_of_gateway(self) -> Entry | None:
        """The gateway's death before the moment, as a recorder saw it; or soon after it, if it was at work."""
        if self._state is not None and not self._is_active:
            return None
        death = self._story.death(self._now.at_ns + (SOON_NS if self._is_active else 0))
        last = self._now.last(SafetyState)
        if death is None or self._now.at_ns - death.time_ns > BEFORE_NS:
            return None
        return death if last is None or last.time_ns <= death.time_ns + STALE_NS else None

    def _what_followed(self, death: Entry) -> Iterator[Link]:
        """Yield the death that a recorder saw, and its consequences, as far as another gateway shows them."""
        yield Link(Step.CAUSE, death.text, death.time_ns)
        last = self._now.last(SafetyState)
        after = self._story.next_run(death.time_ns, None if last is None else last.said.tick)
        if after:
            text = f"another gateway said something {span(after[0].time_ns - death.time_ns)} later"
            yield Link(Step.CAUSE, f"{text}: nothing of before holds any more", after[0].time_ns)
        yield from silences.guard_links(after)

    def _headline(self) -> str:
        now, state, silence, death = self._now, self._state, self._silence, self._death
        latched = [] if state is None else state.latched
        said = headline(now, state, self._focus, self._story.newest_latch(latched, now.at_ns))
        if silence is not None:
            told = silences.in_a_sentence(silence, now.at_ns)
        elif death is not None:
            told = f"A recorder noticed {before(death.time_ns, now.at_ns)}: {death.text}."
        else:
            return said
        return told if state is None else f"{said} {told}"

    def _untold(self, last: Heard[SafetyState] | None) -> Iterator[Link]:
        """Yield links for the gaps of the log before the moment and after it."""
        at_ns, focus = self._now.at_ns, self._focus
        has_ended = self._silence is not None or self._death is not None
        if self._state is None and focus is None and not has_ended:
            stop = self._story.stop_before(at_ns)
            if stop is not None:
                yield missing(
                    f"the last stop in the log was {before(stop.time_ns, at_ns)}; what was since is not told"
                )
        if self._is_active and not has_ended:
            heard_ns = max(one.time_ns for one in self._now.all(SafetyState))
            if heard_ns < at_ns + SOON_NS:
                text = f"the arbiter's states end {before(heard_ns, at_ns)}, and none follows for seconds"
                yield missing(f"{text}: whether the gateway died, or the recording ended, is not told")
        engaged = None if last is None or focus is None else self._story.next_engaged(focus.time_ns)
        if last is not None and engaged is not None and last.said.state in COMMANDING:
            text = (
                f"it was engaged again {before(engaged.time_ns, at_ns)}, and so it is in the last state of the log"
            )
            yield missing(f"{text}, {before(last.time_ns, at_ns)}: what came then is not told")

    def _command(self) -> list[Link]:
        if self._state is None:
            return []
        found = refused_lately(self._now)
        if self._is_active:
            found = describe_command(self._now) + found
        return [msgspec.structs.replace(link, step=_COMMANDS[link.step]) for link in found]

    def _stop(self, focus: Entry) -> Iterator[Link]:
        """The stop: cause, evidence, what was done, what is latched, the cure."""
        is_taken = focus.reason is Reason.HAND_TRANSMITTER
        window = self._beside(focus.time_ns, "the takeover" if is_taken else "the stop", focus.text)
        by = f", by {focus.operator}" if focus.operator and focus.operator not in focus.text else ""
        derived = "; no event says so, two states of the arbiter do" if focus.is_derived else ""
        yield Link(Step.CAUSE, f"{focus.text}{by}{derived}", focus.time_ns, {"reason": focus.reason.value})
        yield from evidence_of(focus.reason)(window)
        yield from actions(window, focus.reason)
        yield from self._latches(window, focus)
        latched = [] if self._state is None else self._state.latched
        is_past = self._state is not None and focus.tick is not None and self._state.tick >= focus.tick
        yield from cures(focus.reason, window.robot, is_reset=is_past and focus.reason not in latched)
        yield from _lacks(window)

    def _latches(self, window: EvidenceWindow, focus: Entry) -> Iterator[Link]:
        latched = list(self._state.latched) if self._state is not None else []
        behind = next((one.said for one in window.after(SafetyState, focus.time_ns - 1)), None)
        for reason in dict.fromkeys([*latched, *([] if behind is None else behind.latched)]):
            yield self._latch(reason, focus)

    def _latch(self, reason: Reason, focus: Entry | None = None) -> Link:
        at_ns = self._now.at_ns
        entry = self._story.last_latch(reason, at_ns + SOON_NS)
        if entry is None:
            return Link(Step.LATCH, f"latched: {reason.value}; when that began is not in the log")
        when = before(entry.time_ns, at_ns)
        if focus is not None and entry.tick == focus.tick:
            when = "with this stop"
        text = f"latched {when}: {reason.value}"
        reset = self._story.reset_of(entry)
        if reset is None:
            text += ", and no reset of it is in the log"
        else:
            text += f"; {reset.operator or 'somebody'} reset it {span(reset.time_ns - entry.time_ns)} later"
        return Link(Step.LATCH, text, entry.time_ns, {"reason": reason.value})

    def _blocked(self, told: Reason) -> Iterator[Link]:
        """Links for all else that kept the robot from moving, or from being engaged, at the moment itself."""
        state = self._state
        if state is None:
            return
        blocked_by = [reason for reason in state.blocked_by if reason is not told]
        if state.state is ArbiterState.ENGAGED:
            blocked_by = [reason for reason in blocked_by if blocks(reason, self._now, state)]
        for number, reason in enumerate(blocked_by):
            if reason in PLAIN:
                continue
            yield Link(Step.CAUSE, blocked_words(reason, state), None, {"reason": reason.value})
            is_latched = reason in state.latched
            if is_latched:
                yield self._latch(reason)
            latch = self._story.last_latch(reason, self._now.at_ns) if number < LATCHES_SHOWN else None
            if is_latched and latch is not None:
                yield from evidence_of(reason)(self._beside(latch.time_ns, "the latch", latch.text))
            elif not is_latched:
                yield from evidence_of(reason)(self._beside(self._now.at_ns, self._now.what))
        for reason in blocked_by:
            yield from cures(reason, self._now.robot, blocked_by, is_reset=reason not in state.latched)

    def _window(self, at_ns: int) -> EvidenceWindow:
        """The window around a moment, with the story's times."""
        shift_ns = self._reader.shift(at_ns)
        window = self._reader.window(at_ns, shift_ns)
        off_ns = self._story.off_ns(window)
        return self._reader.window(at_ns, shift_ns + off_ns) if off_ns else window

    def _beside(self, at_ns: int, what: str, detail: str = "") -> EvidenceWindow:
        """The window around another moment, which these words name, and of which the arbiter said this."""
        window = self._now if at_ns == self._now.at_ns else self._window(at_ns)
        window.what, window.detail = what, detail
        return window


_COMMANDS: Final = {Step.EVIDENCE: Step.COMMAND, Step.MISSING: Step.MISSING}


def _lacks(window: EvidenceWindow) -> Iterator[Link]:
    """Links for parts of this time that are not in the log, by the recorder and the arbiter's states."""
    states = [one for one in window.all(SafetyState) if one.time_ns > window.at_ns - LOOKED_AT_NS]
    for was, now in pairwise(states):
        if is_other_run(was.said, now.said):
            continue
        if was.time_ns < window.at_ns and now.time_ns - was.time_ns > STALE_NS:
            hole = f"{span(now.time_ns - was.time_ns)}, from {window.ago(was.time_ns)} on"
            text = f"no state of the arbiter is in the log for {hole}: what it was asked and did then may be lost"
            yield missing(text)
    for gap in window.gaps:
        text = (
            f"{gap.count} messages of {gap.key} reached the recorder and are not in the log ({gap.reason.value})"
        )
        yield missing(text)


def _once(links: Sequence[Link]) -> list[Link]:
    """Each link once, however often it was found."""
    return list({(one.step, one.text): one for one in reversed(links)}.values())[::-1]
