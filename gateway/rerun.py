"""Recorded runs through the core again, with their own settings or with others. Pure.

The same inputs must give the same decisions and the same frames. With other settings both runs get the same inputs
at the same times. If the other run commands the chassis differently, a virtual chassis replaces the recorded one
until both robots stand again without a command: see ``gateway.sim.model``. The requests stay as recorded, except
for lease and challenge, which come from the arbiter.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Any, Final

import msgspec

from gateway.chassis.frame import Frame
from gateway.choice.chassis import CHASSIS
from gateway.command.flow import TickEffects
from gateway.command.lease import HeldLease
from gateway.command.restart import Carried, Snapshot, restore
from gateway.command.rulings import Credentials, RawRequest
from gateway.core import Core
from gateway.journal import LINKS, BrokenJournalError, CheckpointError, Input, follow
from gateway.sim.model import StandIn
from gateway.telemetry.health import Links
from schemas.codec import PAYLOAD_ERRORS, Sample
from schemas.decisions import Journal
from schemas.journal import COMMAND_RULES, Kind
from schemas.messages import ControllerState, Variant
from schemas.reasons import Reason
from schemas.requests import CHALLENGE_BYTES
from schemas.settings import Settings
from schemas.subjects import BY_TYPE

WARM_UP_NS: Final = 3_000_000_000
"""Feedback given to the core before a snapshot: its state depends on nothing older."""

JOURNAL: Final = BY_TYPE[Journal].name

CHECKPOINTS_TRIED: Final = 20
"""Most attempts to resume a checkpoint of a run. Each makes a core, in milliseconds."""

INPUTS_MAX: Final = 100_000
"""Most inputs between two journals of a core, which it holds in memory; normally some hundred."""

MADE_UP: Final = "not the inputs of a core"
"""For forged inputs: values may be of any kind, and a checkpoint may have any class of the core anywhere."""


class Run(msgspec.Struct, frozen=True):
    """A recorded run, or the part of it that can be run again.

    Attributes:
        begins_ns: time of its first input, of the warm-up if there is one, monotonic.
        warm_up: for a part that begins at a snapshot, the inputs right before it; the last one is the snapshot.
        state: of the core, for a part that begins at a checkpoint.
    """

    run: int
    begins_ns: int
    inputs: Iterator[Input]
    warm_up: tuple[Input, ...] = ()
    state: bytes = b""

    def core(self, settings: Settings) -> Core:
        """Return a core in the state at the beginning of the run or part."""
        core = Core(CHASSIS, settings, "", self.begins_ns, self.run)
        if self.state:
            core.resume(self.state)
        if self.warm_up:
            *before, (_, now_ns, kept, controller, *told) = self.warm_up
            core.look_from(_as_links(told), ControllerState(controller))
            for one in before:
                # There were no requests then.
                if one[0] in {Kind.FRAME, Kind.TICK, Kind.SENT}:
                    give(core, one)
            if core.command is not None:
                restore(core.command, msgspec.convert(kept, Snapshot), now_ns)
        return core


def rerun(settings: Settings, journals: Iterable[Journal]) -> Iterator[Sample]:
    """All samples of the core when a run is given to it again; at the end the incomplete batches.

    The journals are of one run, in order and without a gap, and may be read lazily. If the run's first input is
    missing, the rerun begins at the first checkpoint or snapshot; under other rules it needs the first input,
    because their state differs.

    Raises BrokenJournalError: the core cannot take an input, or some are missing.
    """
    run = run_of(journals)
    if run is not None:
        try:
            core = run.core(settings)
            for _, samples in run_again(core, run.inputs):
                yield from samples
        except (ArithmeticError, AttributeError) as error:
            raise BrokenJournalError(f"{MADE_UP}: {error}") from error
        # The end of a batch depends on when the core was made.
        yield from core.last_batches(0)


def run_of(journals: Iterable[Journal], *, at_rest: bool = False) -> Run | None:
    """The run in the journals, from its first input, checkpoint or snapshot on; None if there is none.

    ``at_rest``: use no checkpoint, because the settings may differ from those of the run.
    """
    rest = iter(journals)
    first = next(rest, None)
    if first is None:
        return None
    inputs = follow(chain([first], rest))
    if first.first == 0:
        begin = next(inputs, None)
        return None if begin is None else Run(first.run, begin[1], chain([begin], inputs))
    warm_up: deque[Input] = deque(maxlen=INPUTS_MAX)
    is_warm = False
    tried = 0
    for one in inputs:
        warm_up.append(one)
        while one[1] - warm_up[0][1] > WARM_UP_NS:
            warm_up.popleft()
            is_warm = True
        if (
            one[0] == Kind.CHECKPOINT
            and not at_rest
            and first.rules == COMMAND_RULES
            and tried < CHECKPOINTS_TRIED
        ):
            tried += 1
            if _fits(one[3]):
                return Run(first.run, one[1], inputs, state=one[3])
        if is_warm and one[0] == Kind.REST and first.rules == COMMAND_RULES:
            return Run(first.run, warm_up[0][1], inputs, tuple(warm_up))
    return None


def _fits(state: bytes) -> bool:
    try:
        Core(CHASSIS, Settings(), "", 0).resume(state)
    except CheckpointError:
        return False
    return True


def run_again(core: Core, inputs: Iterable[Input]) -> Iterator[tuple[list[Frame], list[Sample]]]:
    """For each input the frames to send and the samples to publish.

    Raises BrokenJournalError: the core cannot take an input, or would hold too many.
    """
    held = 0
    for one in inputs:
        returned = give(core, one)
        held += 1
        if isinstance(returned, TickEffects):
            if any(sample.subject == JOURNAL for sample in returned.samples):
                held = 0
            yield returned.frames, returned.samples
        elif returned:
            yield [], returned
        if held > INPUTS_MAX:
            raise BrokenJournalError(f"more than {INPUTS_MAX} inputs without a journal")


def give(core: Core, one: Input) -> TickEffects | list[Sample]:
    """Give the core one input of a journal. Raises BrokenJournalError: its kind is unknown."""
    kind, *arguments = one
    act = _GIVE.get(kind)
    if act is None:
        raise BrokenJournalError(f"kind {kind!r} of an input is not known")
    return act(core, *arguments) or []


def _frame(core: Core, now_ns: int, frame: list[Any]) -> list[Sample]:
    sample = core.receive_frame(Frame(*frame), now_ns)
    return [] if sample is None else [sample]


_SAID: Final = 6
"""Values of a request from its sender; the proof follows."""


def _as_request(values: Sequence[Any]) -> RawRequest:
    raw = RawRequest(*values[:_SAID])
    if len(values) <= _SAID:
        return raw
    attachment, credentials = values[_SAID:]
    proven = msgspec.convert(credentials, Credentials)
    return msgspec.structs.replace(raw, attachment=attachment, credentials=proven)


_NOT_YET_TOLD: Final = {"realtime": True}
"""Values of links that older journals lack."""


def _as_links(told: Sequence[Any]) -> Links:
    return Links(**(_NOT_YET_TOLD | dict(zip(LINKS, told, strict=False))))


def _tick(core: Core, now_ns: int, wall_ns: int, late_ns: int, challenge: bytes = b"") -> TickEffects:
    # Rules 1 had no challenge; any value that is never echoed will do.
    return core.tick(now_ns, wall_ns, late_ns, challenge or now_ns.to_bytes(CHALLENGE_BYTES))


_GIVE: Final[dict[int, Callable[..., TickEffects | list[Sample] | None]]] = {
    Kind.FRAME: _frame,
    Kind.REQUEST: lambda core, now_ns, *request: core.receive_request(_as_request(request), now_ns),
    Kind.LINKS: lambda core, now_ns, *told: core.update_links(_as_links(told), now_ns),
    Kind.TICK: _tick,
    Kind.SENT: lambda core, now_ns, count, wall_ns: core.sent(count, now_ns, wall_ns),
    Kind.SHUT_DOWN: lambda core, now_ns: core.shut_down(now_ns),
    Kind.REST: lambda *_: None,
    Kind.CHECKPOINT: lambda *_: None,
    Kind.GUARD_STOP: lambda core, now_ns, words: core.latch_guard_stop(words, now_ns),
    Kind.CRASHED: lambda core, now_ns: core.note_crash(now_ns),
    Kind.WARNING: lambda core, now_ns, words: core.warn(words, now_ns),
    Kind.END_LEASE: lambda core, now_ns, reason, detail: core.end_lease(Reason(reason), detail, now_ns),
    Kind.BARS: lambda core, now_ns, bars: core.bar({Reason(key): words for key, words in bars.items()}, now_ns),
    Kind.CARRIED: lambda core, now_ns, former: core.take_over(msgspec.convert(former, Carried), now_ns),
}


_REST_NS: Final = 100_000_000
"""Time in standby and at standstill before the recorded chassis is used again."""

SAFETY_STATE: Final = "safety/state"

_CHALLENGES_KEPT: Final = 500
"""Ten seconds of challenges. A command that echoes an older one is too old anyway."""

_COUNTED_BYTES: Final = 6
"""Bytes of a command frame before alive counter and checksum (manual V2.0, section 5)."""


class GivenOutput(msgspec.Struct, frozen=True, gc=False):
    """A sample of one of the two runs. ``is_other``: of the run with other settings."""

    sample: Sample
    is_other: bool


def what_if(settings: Settings, other: Settings, journals: Iterable[Journal]) -> Iterator[GivenOutput]:
    """The samples of the core with its own and with the other settings; see ``rerun``."""
    run = run_of(journals, at_rest=True)
    if run is not None:
        pair = _Pair(run.core(settings), run.core(other))
        for one in run.inputs:
            yield from pair.give(one)


class _Pair:
    """The run as recorded and the run with other settings, side by side."""

    def __init__(self, core: Core, other: Core) -> None:
        self.core = core
        self.other = other
        self._echo = _Echo(core, other)
        self._stand_in: StandIn | None = None
        self._offered: list[Frame] = []
        self._offered_other: list[Frame] = []
        self._resting_since_ns: int | None = None

    def give(self, one: Input) -> Iterator[GivenOutput]:
        """Give one input to both. Yields the samples of each."""
        kind, now_ns = one[0], one[1]
        returned = give(self.core, one)
        if kind == Kind.FRAME:
            one = self._shown(one)
        elif kind == Kind.REQUEST:
            one = self._echo.asked(one)
        elif kind == Kind.SENT:
            one = self._sent(one)
        answer = give(self.other, one)
        if isinstance(returned, TickEffects) and isinstance(answer, TickEffects):
            self._compare(returned.frames, answer.frames, now_ns)
        for effects, is_other in ((returned, False), (answer, True)):
            for sample in effects.samples if isinstance(effects, TickEffects) else effects:
                if sample.subject == SAFETY_STATE:
                    self._echo.published(sample, is_other=is_other)
                yield GivenOutput(sample, is_other)

    def _shown(self, one: Input) -> Input:
        stand_in = self._stand_in
        if stand_in is None:
            if self.core.variant is Variant.UNKNOWN:
                return one
            stand_in = self._stand_in = StandIn(CHASSIS, self.core.variant)
            for before in self.core.newest_frames:
                stand_in.show(before, one[1])
        frame = Frame(*one[2])
        shown = stand_in.show(frame, one[1])
        return one if shown is frame else (one[0], one[1], msgspec.structs.astuple(shown))

    def _sent(self, one: Input) -> Input:
        """The bus accepts as many of the other frames as of the recorded ones."""
        kind, now_ns, count, wall_ns = one
        offered = self._offered_other
        taken = len(offered) if count >= len(self._offered) else min(count, len(offered))
        if self._stand_in is not None:
            for frame in offered[:taken]:
                self._stand_in.hear(frame, now_ns)
        return kind, now_ns, taken, wall_ns

    def _compare(self, frames: list[Frame], others: list[Frame], now_ns: int) -> None:
        """Compare the commands of both runs, and begin or end the stand-in for the chassis accordingly."""
        self._offered, self._offered_other = frames, others
        stand_in = self._stand_in
        if stand_in is None:
            return
        if _told(frames) != _told(others):
            stand_in.begin(now_ns)
        if frames or others or not stand_in.stands:
            self._resting_since_ns = None
        elif self._resting_since_ns is None:
            self._resting_since_ns = now_ns
        elif stand_in.is_acting and now_ns - self._resting_since_ns >= _REST_NS:
            stand_in.end()


class _Echo:
    """Translates requests for the other arbiter, which has other challenges and perhaps another lease."""

    def __init__(self, core: Core, other: Core) -> None:
        self._core = core
        self._other = other
        self._recorded: OrderedDict[bytes, int] = OrderedDict()
        self._published: deque[_State] = deque(maxlen=_CHALLENGES_KEPT)

    def published(self, sample: Sample, *, is_other: bool) -> None:
        """Take a published safety/state."""
        state = _STATE.decode(sample.payload)
        if is_other:
            self._published.append(state)
            return
        self._recorded[state.challenge] = state.tick
        if len(self._recorded) > _CHALLENGES_KEPT:
            self._recorded.popitem(last=False)

    def asked(self, one: Input) -> Input:
        """Return the request with challenge and lease of the other arbiter."""
        kind, now_ns, handle, verb, operator, payload, size, *fault = one
        try:
            request = msgspec.msgpack.decode(payload)
        except PAYLOAD_ERRORS:
            return one
        if not isinstance(request, dict):
            return one
        changed = dict(request)
        challenge = request.get("challenge")
        tick = self._recorded.get(challenge) if isinstance(challenge, bytes) else None
        if tick is not None:
            seen = [state.challenge for state in self._published if state.tick <= tick]
            changed["challenge"] = seen[-1] if seen else challenge
        lease, other = _lease(self._core), _lease(self._other)
        if (
            lease is not None
            and other is not None
            and lease.operator == other.operator == operator
            and request.get("lease") == lease.id
        ):
            changed["lease"] = other.id
        if changed == request:
            return one
        encoded = msgspec.msgpack.encode(changed)
        return (kind, now_ns, handle, verb, operator, encoded, size + len(encoded) - len(payload), *fault)


def _lease(core: Core) -> HeldLease | None:
    return None if core.command is None else core.command.arbiter.leases.held


class _State(msgspec.Struct):
    tick: int
    challenge: bytes


_STATE: Final = msgspec.msgpack.Decoder(_State)


def _told(frames: list[Frame]) -> list[tuple[int, bytes]]:
    return [(frame.can_id, frame.data[:_COUNTED_BYTES]) for frame in frames]
