"""A recorded run repeated twice: as it was, and as it would have been with other settings. Pure.

Both runs get the same inputs at the same times. Where the other one commands the chassis differently, a virtual
chassis answers in place of the recorded one, until both robots stand again with nobody in command: see
``gateway.sim.stand_in``. What people would have done otherwise nobody knows: the requests stay as recorded, but
for what the arbiter gave out itself, the lease and the challenge to echo.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator
from typing import Final

import msgspec

from gateway.chassis.frame import Frame
from gateway.command.flow import TickEffects
from gateway.command.lease import HeldLease
from gateway.core import Core
from gateway.journal import Input
from gateway.rerun.rerun import give, run_of
from gateway.sim.stand_in import StandIn
from schemas.codec import PAYLOAD_ERRORS, Sample
from schemas.decisions import Journal
from schemas.journal import Kind
from schemas.messages import Variant
from schemas.settings import Settings

_REST_NS: Final = 100_000_000
"""Both stand by and stand still for so long before the recorded chassis is believed again."""

SAFETY_STATE: Final = "safety/state"

_CHALLENGES_KEPT: Final = 500
"""Ten seconds of them. A command that echoes an older one is refused for its age in any case."""

_COUNTED_BYTES: Final = 6
"""Bytes of a command frame before alive counter and checksum (manual V2.0, section 5)."""


Effects = TickEffects | list[Sample]
"""All that comes of one input: of a tick its effects, else samples."""


class GivenOutput(msgspec.Struct, frozen=True, gc=False):
    """A sample of one of the two runs.

    Attributes:
        sample: the subject's name and the MessagePack payload.
        is_other: it is the run with other settings.
    """

    sample: Sample
    is_other: bool


def what_if(settings: Settings, other: Settings, journals: Iterable[Journal]) -> Iterator[GivenOutput]:
    """All that the core says, and would have said.

    Args:
        settings: those of the run.
        other: those to try.
        journals: of one run, as in ``gateway.rerun.rerun.rerun``.
    """
    run = run_of(journals, at_rest=True)
    if run is not None:
        pair = RunPair(run.core(settings), run.core(other))
        for one in run.inputs:
            for returned, is_other in zip(pair.give(one), (False, True), strict=True):
                for sample in samples_of(returned):
                    yield GivenOutput(sample, is_other)


class RunPair:
    """The run as it was, and beside it the other one.

    Args:
        core: of the run.
        other: with the other settings, in a state of the same moment.

    Attributes:
        core, other: the same.
    """

    def __init__(self, core: Core, other: Core) -> None:
        self.core = core
        self.other = other
        self._echo = _Echo(core, other)
        self._stand_in: StandIn | None = None
        self._offered: list[Frame] = []
        self._offered_other: list[Frame] = []
        self._resting_since_ns: int | None = None

    def give(self, one: Input) -> tuple[Effects, Effects]:
        """Give one input to both. Returns what each does."""
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
            for sample in samples_of(effects):
                if sample.subject == SAFETY_STATE:
                    self._echo.published(sample, is_other=is_other)
        return returned, answer

    def _shown(self, one: Input) -> Input:
        stand_in = self._stand_in
        if stand_in is None:
            if self.core.variant is Variant.UNKNOWN:
                return one
            stand_in = self._stand_in = StandIn(self.core.variant)
            for before in self.core.newest_frames:
                stand_in.show(before, one[1])
        frame = Frame(*one[2])
        shown = stand_in.show(frame, one[1])
        return one if shown is frame else (one[0], one[1], msgspec.structs.astuple(shown))

    def _sent(self, one: Input) -> Input:
        """The bus takes of the other frames what it took of the recorded ones: all, or as many."""
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
    """Requests as their senders would have sent them in answer to the other arbiter.

    A drive echoes the newest challenge that was published, and everything names the lease that was given. The two
    arbiters publish in other ticks, and may have given another lease.
    """

    def __init__(self, core: Core, other: Core) -> None:
        self._core = core
        self._other = other
        self._recorded: OrderedDict[bytes, int] = OrderedDict()
        self._published: deque[_State] = deque(maxlen=_CHALLENGES_KEPT)

    def published(self, sample: Sample, *, is_other: bool) -> None:
        """A safety/state went out."""
        state = _STATE.decode(sample.payload)
        if is_other:
            self._published.append(state)
            return
        self._recorded[state.challenge] = state.tick
        if len(self._recorded) > _CHALLENGES_KEPT:
            self._recorded.popitem(last=False)

    def asked(self, one: Input) -> Input:
        """The request, with the numbers that the other arbiter gave out."""
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


def samples_of(returned: Effects) -> list[Sample]:
    """The samples among what a core does."""
    return returned.samples if isinstance(returned, TickEffects) else returned
