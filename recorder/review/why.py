"""Why did the robot stop, or not move? From frames and requests to the decision, in sentences, with the numbers.

The moment is looked at first: what the robot did, what the arbiter did, what was commanded. Then the stop that
was under way or had been before it: its cause, what shows it, what was done, what is latched, what would cure it.
What the log does not show is said, and nothing is claimed of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

import msgspec

from recorder.review.faults import Faults
from recorder.review.logs import LogFile
from recorder.review.reasoning import silence as silences
from recorder.review.reasoning import story as stories
from recorder.review.reasoning.chain import Link, Step, before, missing, span
from recorder.review.reasoning.evidence import EVIDENCE, Clue
from recorder.review.reasoning.moment import arbiter, headline, motion
from recorder.review.reasoning.request_evidence import describe_command, refused_lately
from recorder.review.reasoning.scene import Scene, Stage
from recorder.review.reasoning.silence import Silence, is_other_run, last_silence
from recorder.review.reasoning.stopping import actions
from recorder.review.reasoning.story import Story
from recorder.review.rows import Progress
from recorder.review.survey import Survey
from recorder.review.timeline.clock import RUN_TICKS
from recorder.review.timeline.entries import Entry, EntryKind
from schemas.decisions import COMMANDING, ArbiterState, SafetyState
from schemas.messages import TimeNs
from schemas.reasons import OF_A_ROBOT, Reason
from schemas.settings import SAFETY_STATE_PERIOD_NS

SOON_NS: Final = 1_000_000_000
"""A stop that begins so soon after the moment is what is asked about."""

STALE_NS: Final = 500_000_000
"""A state that is older says nothing of the moment; it comes every 50 ms."""

LOOKED_AT_NS: Final = 5_000_000_000
"""For so long before the moment a break in the states is told."""

LATCHES_SHOWN: Final = 3
"""Latches besides that of the stop whose evidence is looked for."""

_PLAIN: Final = frozenset({Reason.STOPPING, Reason.NOT_ENGAGED, Reason.ENGAGING, Reason.NO_LEASE})
"""What blocks a robot that nobody has engaged: there is nothing to show but that nobody has."""


_PASSING: Final = frozenset({Reason.STOPPING, Reason.ENGAGING})
"""What ends by itself."""


class Explanation(msgspec.Struct, frozen=True):
    """An answer.

    Attributes:
        at_ns: the moment, in nanoseconds since 1970.
        state: the arbiter's at that moment; None if the log does not tell.
        reason: that of the stop that is told of; ``none`` if none is.
        stop_ns: when that stop began; None if none is told of.
        silent_ns: when the gateway fell silent, if another one began after it; None if it did not, or long before.
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
        """The log tells what the arbiter did."""
        return self.state is not None or self.stop_ns is not None or self.silent_ns is not None


def explain(
    robot: str,
    logs: Sequence[LogFile],
    found: Survey,
    at_ns: int | None,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Explanation:
    """Why the robot stopped, or did not move.

    Args:
        robot: its name.
        logs: in the order of their beginnings.
        found: what a survey of these logs found.
        at_ns: the moment, in nanoseconds since 1970; the last stop of the logs if it is None.
        faults: takes what cannot be read.
        progress: is told of bytes that were read.
    """
    name = f"{robot}/configuration.toml"
    texts = [(one.log_time, one.data.decode("utf-8", "replace")) for one in found.attachments if one.name == name]
    stage = Stage(robot, logs, texts, faults)
    story = stories.told(robot, logs, faults, progress)
    if at_ns is None and story.last_stop() is None:
        story = stories.derived(robot, logs, faults, progress)
    if at_ns is None:
        last = story.last_stop()
        at_ns = last.time_ns if last is not None else max((log.end_ns for log in logs), default=0)
    now = _scene(stage, story, at_ns)
    state = _state(now)
    focus = _focus(story, state, now)
    if _is_untold(focus, state) or story.off_ns(now) is None:
        story = stories.derived(robot, logs, faults, progress)
        now = _scene(stage, story, at_ns)
        state = _state(now)
        focus = _focus(story, state, now)
    return _Answer(stage, story, now, state, focus).explanation()


def _scene(stage: Stage, story: Story, at_ns: int) -> Scene:
    """What was around a moment, with the story's times."""
    shift_ns = stage.shift(at_ns) or 0
    scene = stage.scene(at_ns, shift_ns)
    off_ns = story.off_ns(scene)
    return stage.scene(at_ns, shift_ns + off_ns) if off_ns else scene


def _state(now: Scene) -> SafetyState | None:
    heard = now.last(SafetyState)
    return heard.said if heard is not None and now.at_ns - heard.time_ns <= STALE_NS else None


def _focus(story: Story, state: SafetyState | None, now: Scene) -> Entry | None:
    """The stop that is asked about.

    None but one that was not followed by an engagement or by another run of the gateway: those ended it.
    """
    is_commanding = state is not None and state.state in COMMANDING
    soon = story.next_stop(now.at_ns)
    if soon is not None and soon.time_ns <= now.at_ns + (SOON_NS if is_commanding else SAFETY_STATE_PERIOD_NS):
        return soon
    if is_commanding:
        return None
    stop = story.stop_before(now.at_ns)
    if stop is None or stop.tick is None:
        return stop
    if state is not None:
        return stop if abs(state.tick - stop.tick) < RUN_TICKS else None
    silence = last_silence(now)
    return stop if silence is None or silence.was_stopping else None


def _is_untold(focus: Entry | None, state: SafetyState | None) -> bool:
    """The state tells of a stop, and the events do not."""
    if state is None or state.state in COMMANDING or state.stop_reason is Reason.NONE:
        return False
    return focus is None or focus.reason is not state.stop_reason


class _Answer:
    """Puts the links together."""

    def __init__(
        self, stage: Stage, story: Story, now: Scene, state: SafetyState | None, focus: Entry | None
    ) -> None:
        self._stage = stage
        self._story = story
        self._now = now
        self._state = state
        self._focus = focus

    def explanation(self) -> Explanation:
        now, state, focus = self._now, self._state, self._focus
        silence = self._silence()
        links = [*motion(now), *arbiter(now, state), *self._command()]
        if silence is not None:
            links += silences.links(silence)
        if focus is not None:
            links += self._stop(focus)
        links += self._blocked({Reason.NONE if focus is None else focus.reason})
        links += _lacks(now)
        return Explanation(
            robot=now.robot,
            at_ns=now.at_ns,
            state=None if state is None else state.state,
            reason=Reason.NONE if focus is None else focus.reason,
            stop_ns=None if focus is None else focus.time_ns,
            silent_ns=None if silence is None else silence.was.time_ns,
            headline=self._headline(silence),
            chain=_once(links),
        )

    def _silence(self) -> Silence | None:
        """That of the gateway, if nothing has happened since that tells more."""
        if self._state is not None and (self._focus is not None or self._state.state is not ArbiterState.STANDBY):
            return None
        return last_silence(self._now)

    def _headline(self, silence: Silence | None) -> str:
        now, state = self._now, self._state
        if silence is None:
            latched = [] if state is None else state.latched
            return headline(now, state, self._focus, self._story.newest_latch(latched, now.at_ns))
        told = silences.in_a_sentence(silence, now.at_ns)
        return told if state is None else f"{headline(now, state, None)} {told}"

    def _command(self) -> list[Link]:
        if self._state is None:
            return []
        found = refused_lately(self._now)
        if self._state.state is not ArbiterState.STANDBY:
            found = describe_command(self._now) + found
        return [msgspec.structs.replace(link, step=_COMMANDS[link.step]) for link in found]

    def _stop(self, focus: Entry) -> Iterator[Link]:
        """The stop: cause, evidence, what was done, what is latched, the cure."""
        scene = self._scene(focus.time_ns, "the stop")
        by = f", by {focus.operator}" if focus.operator and focus.operator not in focus.text else ""
        derived = "; no event says so, two states of the arbiter do" if focus.is_derived else ""
        yield Link(Step.CAUSE, f"{focus.text}{by}{derived}", focus.time_ns, {"reason": focus.reason.value})
        yield from EVIDENCE[focus.reason](Clue(scene, focus.text))
        yield from actions(scene, focus.reason)
        yield from self._latches(scene, focus)
        yield from _cures([focus.reason])
        yield from _lacks(scene)

    def _latches(self, scene: Scene, focus: Entry) -> Iterator[Link]:
        latched = list(self._state.latched) if self._state is not None else []
        behind = next((one.said for one in scene.after(SafetyState, focus.time_ns - 1)), None)
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
        reset = self._story.next(EntryKind.RESET, entry.time_ns)
        if reset is None:
            text += ", and no reset of it is in the log"
        else:
            text += f"; {reset.operator or 'somebody'} reset it {span(reset.time_ns - entry.time_ns)} later"
        return Link(Step.LATCH, text, entry.time_ns, {"reason": reason.value})

    def _blocked(self, told: set[Reason]) -> Iterator[Link]:
        """What besides kept the robot where it was, at the moment itself."""
        if self._state is None:
            return
        blocked_by = [reason for reason in self._state.blocked_by if reason not in told]
        for number, reason in enumerate(blocked_by):
            latch = None
            if reason in self._state.latched and number < LATCHES_SHOWN:
                latch = self._story.last_latch(reason, self._now.at_ns)
            if reason in _PLAIN:
                continue
            text = f"it was kept from moving, too: {OF_A_ROBOT[reason].means}"
            yield Link(Step.CAUSE, text, None, {"reason": reason.value})
            if reason in self._state.latched:
                yield self._latch(reason)
            if latch is not None:
                yield from EVIDENCE[reason](Clue(self._scene(latch.time_ns, "the latch"), latch.text))
            elif reason not in self._state.latched:
                yield from EVIDENCE[reason](Clue(self._now))
        yield from _cures(blocked_by)

    def _scene(self, at_ns: int, what: str) -> Scene:
        scene = self._now
        if at_ns != self._now.at_ns:
            scene = _scene(self._stage, self._story, at_ns)
        scene.what = what
        return scene


_COMMANDS: Final = {Step.EVIDENCE: Step.COMMAND, Step.MISSING: Step.MISSING}


def _cures(reasons: Sequence[Reason]) -> Iterator[Link]:
    for reason in reasons:
        cure = OF_A_ROBOT[reason].cure
        if cure and reason not in _PASSING:
            yield Link(Step.CURE, f"to cure {reason.value}: {cure}", None, {"reason": reason.value})


def _lacks(scene: Scene) -> Iterator[Link]:
    """What of this time is not in the log, as the recorder and the arbiter's states tell."""
    states = [one for one in scene.all(SafetyState) if one.time_ns > scene.at_ns - LOOKED_AT_NS]
    for was, now in pairwise(states):
        if is_other_run(was.said, now.said):
            continue
        if was.time_ns < scene.at_ns and now.time_ns - was.time_ns > STALE_NS:
            hole = f"{span(now.time_ns - was.time_ns)}, from {scene.ago(was.time_ns)} on"
            text = f"no state of the arbiter is in the log for {hole}: what it was asked and did then may be lost"
            yield missing(text)
    for gap in scene.gaps:
        text = (
            f"{gap.count} messages of {gap.key} reached the recorder and are not in the log ({gap.reason.value})"
        )
        yield missing(text)


def _once(links: Sequence[Link]) -> list[Link]:
    """Each link once, however often it was found."""
    return list({(one.step, one.text): one for one in reversed(links)}.values())[::-1]
