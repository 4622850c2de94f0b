"""A part of a recorded run repeated twice, as it was and with other settings, from a checkpoint on. Pure.

A checkpoint is a state that the run's own settings led to. Under the others it may be one that they never come to,
so whoever begins there asks whether they do: both runs of the part before it have to come to the same state.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, Protocol

import msgspec

from gateway.checkpoint import CheckpointError, checkpoint
from gateway.command.actuation import Actuation
from gateway.core import Core, TickEffects
from gateway.journal import BrokenJournalError
from gateway.rerun.other_settings import OtherSettings, without_observed
from gateway.rerun.rerun import MADE_UP, Run, run_of
from gateway.rerun.what_if import RunPair, samples_of
from gateway.telemetry.sample import Sample
from schemas.decisions import Journal
from schemas.journal import Kind
from schemas.settings import Settings

ALIKE_NS: Final = 10_000_000_000
"""The chassis was told the same for so long: what it did then is what it did in the log."""

Commanded = tuple[float, float, bool] | None
"""Speed in m/s, forward positive, angle in deg, parking brake; None while nothing is sent."""


class PairListener(Protocol):
    """Whoever compares both runs. Times are nanoseconds since 1970, by the robot's clock."""

    def begin(self, *, is_clear: bool, is_certain: bool) -> None:
        """Both begin: at the run's start or at rest, which is clear, or at a checkpoint."""

    def tick(self, time_ns: int) -> None:
        """A tick begins."""

    def say(self, recorded: list[Sample], other: list[Sample]) -> None:
        """Both say something in the same call."""

    def command(self, recorded: Commanded, other: Commanded) -> None:
        """In this tick the chassis is told different things."""

    def compare(self, *, are_same: bool) -> None:
        """Compare both states: a run can begin here, and where they are the same it may do so for both."""


def run_pair(
    settings: Settings, other: Settings, journals: Iterable[Journal], listener: PairListener
) -> Iterator[None]:
    """Run both; yields behind each input, so that the caller can end it.

    Args:
        settings: those of the run.
        other: those to try.
        journals: of one run, as in ``gateway.rerun.rerun.rerun``.
        listener: learns all that comes of it.

    Raises:
        BrokenJournalError: an input cannot be given to a core, or the settings do not suit the checkpoint.
    """
    run = run_of(journals)
    if run is None:
        return
    try:
        yield from _run_both(settings, other, run, listener)
    except AttributeError as error:
        if not run.state:
            raise
        raise BrokenJournalError(f"{MADE_UP}: {error}") from error


def _run_both(settings: Settings, other: Settings, run: Run, listener: PairListener) -> Iterator[None]:
    translation = OtherSettings(settings, other, run.run)
    try:
        counterpart, is_certain = _other_core(run, other, translation)
    except CheckpointError as error:
        raise BrokenJournalError(str(error)) from error
    pair = RunPair(run.core(settings), counterpart)
    listener.begin(is_clear=not run.state, is_certain=is_certain)
    differed_ns: int | None = None
    for one in run.inputs:
        kind, now_ns = one[0], one[1]
        if kind == Kind.TICK:
            listener.tick(one[2])
        elif kind in {Kind.CHECKPOINT, Kind.REST}:
            is_alike = differed_ns is None or now_ns - differed_ns > ALIKE_NS
            listener.compare(are_same=kind == Kind.REST or _are_same(pair, translation, is_alike=is_alike))
        returned = pair.give(one)
        if isinstance(returned[0], TickEffects) and pair.differs:
            differed_ns = now_ns
            listener.command(_commanded(pair.core), _commanded(pair.other))
        listener.say(*map(samples_of, returned))
        yield


def _other_core(run: Run, other: Settings, translation: OtherSettings) -> tuple[Core, bool]:
    if not run.state:
        return run.core(other), True
    translated = translation.translated(msgspec.msgpack.decode(run.state))
    state = msgspec.msgpack.encode(translated.state)
    return msgspec.structs.replace(run, state=state).core(other), translated.is_certain


def _are_same(pair: RunPair, translation: OtherSettings, *, is_alike: bool) -> bool:
    """Report whether the other arbiter is where the recorded one is; the chassis is, once it was told the same."""
    if not is_alike:
        return False
    try:
        translated = translation.translated(checkpoint(pair.core))
    except CheckpointError:
        return False
    return translated.is_certain and without_observed(translated.state) == without_observed(checkpoint(pair.other))


def _commanded(core: Core) -> Commanded:
    told: Actuation | None = None if core.command is None else core.command.arbiter.output.actuation
    return None if told is None else (told.signed_speed_mps, told.angle_deg, told.parking)
