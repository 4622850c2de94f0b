"""Run the core again from its journal: the same inputs must give the same decisions and the same frames. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any, Final

import msgspec

from gateway.chassis.frame import Frame
from gateway.command.request import RawRequest
from gateway.core import Core, Due
from gateway.journal import Input, Kind, inputs_of
from gateway.telemetry.health import Links
from gateway.telemetry.sample import Sample
from schemas.decisions import Journal
from schemas.settings import Settings


class Run(msgspec.Struct, frozen=True):
    """A recorded run.

    Attributes:
        run: its number.
        begins_ns: when its first input came, monotonic.
        inputs: all of them, in their order.
    """

    run: int
    begins_ns: int
    inputs: Iterator[Input]

    def core(self, settings: Settings) -> Core:
        """A core as it was when the run began."""
        return Core(settings, "", self.begins_ns, self.run)


def rerun(settings: Settings, journals: Iterable[Journal]) -> Iterator[Sample]:
    """All that the core says when a run is given to it again.

    Args:
        settings: those of the run, or others.
        journals: of one run, from its first input on, in their order and without a gap; they may come bit by bit.
    """
    run = run_of(journals)
    if run is not None:
        for _, samples in run_again(run.core(settings), run.inputs):
            yield from samples


def run_of(journals: Iterable[Journal]) -> Run | None:
    """The run that journals hold; None if they hold nothing. See ``rerun``."""
    rest = iter(journals)
    first = next(rest, None)
    if first is None:
        return None
    inputs = chain.from_iterable(map(inputs_of, chain([first], rest)))
    begin = next(inputs, None)
    return None if begin is None else Run(first.run, begin[1], chain([begin], inputs))


def run_again(core: Core, inputs: Iterable[Input]) -> Iterator[tuple[list[Frame], list[Sample]]]:
    """For each input what the core returns: the frames to send, and the samples to publish.

    Args:
        core: a new one, with the configuration and the run number of the journal.
        inputs: the journal's, from the first on; see ``gateway.journal.read``.
    """
    for one in inputs:
        returned = give(core, one)
        if isinstance(returned, Due):
            yield returned.frames, returned.samples
        elif returned:
            yield [], returned


def give(core: Core, one: Input) -> Due | list[Sample]:
    """Gives the core one input of a journal. Returns what the core does."""
    kind, *arguments = one
    return _GIVE[kind](core, *arguments)


def _frame(core: Core, now_ns: int, frame: list[Any]) -> list[Sample]:
    sample = core.receive_frame(Frame(*frame), now_ns)
    return [] if sample is None else [sample]


def _request(
    core: Core, now_ns: int, handle: int, verb: str, operator: str, payload: bytes, size: int
) -> list[Sample]:
    core.receive_request(RawRequest(handle, verb, operator, payload, size), now_ns)
    return []


def _links(core: Core, now_ns: int, *told: Any) -> list[Sample]:  # noqa: ANN401 - as the journal holds them
    bus_up, bus_losses, guarded, guard_sends, guard_stops, is_behind = told
    links = Links(
        bus_up=bus_up,
        bus_losses=bus_losses,
        guarded=guarded,
        guard_sends=guard_sends,
        guard_stops=guard_stops,
        is_behind=is_behind,
    )
    core.observe_links(links, now_ns)
    return []


def _tick(core: Core, now_ns: int, wall_ns: int, late_ns: int) -> Due:
    return core.tick(now_ns, wall_ns, late_ns)


def _sent(core: Core, now_ns: int, count: int, wall_ns: int) -> list[Sample]:
    return core.sent(count, now_ns, wall_ns)


def _shut_down(core: Core, now_ns: int) -> list[Sample]:
    core.shut_down(now_ns)
    return []


_GIVE: Final[dict[int, Callable[..., Due | list[Sample]]]] = {
    Kind.FRAME: _frame,
    Kind.REQUEST: _request,
    Kind.LINKS: _links,
    Kind.TICK: _tick,
    Kind.SENT: _sent,
    Kind.SHUT_DOWN: _shut_down,
}
