"""Run the core again from its journal: the same inputs must give the same decisions and the same frames. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final

from gateway.chassis.frame import Frame
from gateway.command.request import RawRequest
from gateway.core import Core, Due
from gateway.journal import Input, Kind
from gateway.telemetry.health import Links
from gateway.telemetry.sample import Sample


def run_again(core: Core, inputs: Iterable[Input]) -> Iterator[tuple[list[Frame], list[Sample]]]:
    """For each input what the core returns: the frames to send, and the samples to publish.

    Args:
        core: a new one, with the configuration and the run number of the journal.
        inputs: the journal's, from the first on; see ``gateway.journal.read``.
    """
    for kind, *arguments in inputs:
        returned = _GIVE[kind](core, *arguments)
        if isinstance(returned, Due):
            yield returned.frames, returned.samples
        elif returned:
            yield [], returned


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


_GIVE: Final[dict[int, Callable[..., Any]]] = {
    Kind.FRAME: _frame,
    Kind.REQUEST: _request,
    Kind.LINKS: _links,
    Kind.TICK: _tick,
    Kind.SENT: _sent,
    Kind.SHUT_DOWN: _shut_down,
}
