"""The one thread that owns both flows on the robot: a frame in, a sample out, and a tick every 10 ms."""

from __future__ import annotations

import gc
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, Protocol

from gateway.chassis.frame import Frame
from gateway.core import Core
from gateway.telemetry.health import Links
from gateway.telemetry.sample import Sample
from schemas.settings import LATE_NS, TICK_NS

log = logging.getLogger(__name__)

MS: Final = 1_000_000

COMPLAINT_PERIOD_NS: Final = 1_000_000_000
"""A loop that is always late says so no more often than this."""

BURST_MAX_FRAMES: Final = 32
"""Frames taken at a time, so that a bus that never falls silent cannot keep the tick waiting."""

PEERS_TICKS: Final = 10
"""Who is connected is asked in every tenth tick: asking takes Zenoh tens of microseconds."""


class FrameSource(Protocol):
    """The bus, as the loop sees it: it never fails, it is up or it is not."""

    is_up: bool
    detail: str
    losses: int

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None if there was none in time."""
        ...


class SampleSink(Protocol):
    """Zenoh, as the loop sees it: it never fails and never blocks."""

    failures: int

    def publish(self, sample: Sample) -> None:
        """Hand a sample to Zenoh."""
        ...

    def peers(self) -> int:
        """Nodes connected directly."""
        ...

    def answer(self, reply: Callable[[], bytes]) -> None:
        """Answer the queries that wait, a bounded number."""
        ...


@contextmanager
def _no_collections() -> Iterator[None]:
    """No garbage collection meanwhile: what start-up made lives on, and a pause would come at any time."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


@_no_collections()
def run(
    bus: FrameSource,
    sink: SampleSink,
    core: Core,
    info: Callable[[], bytes],
    stopped: Callable[[], bool],
) -> None:
    """Run until ``stopped()``.

    Args:
        bus: where the frames come from.
        sink: where the samples go.
        core: decides what a frame and a tick mean.
        info: the payload of ``gateway/info``.
        stopped: asked every tick.
    """
    monotonic_ns = time.monotonic_ns
    due_ns = monotonic_ns() + TICK_NS
    links = Links()
    complained_ns = 0
    ticks = 0
    while not stopped():
        now_ns = monotonic_ns()
        while now_ns < due_ns:
            for sample in receive_burst(bus, core, (due_ns - now_ns) / 1e9):
                sink.publish(sample)
            now_ns = monotonic_ns()
        if now_ns - due_ns > LATE_NS and now_ns - complained_ns > COMPLAINT_PERIOD_NS:
            complained_ns = now_ns
            log.warning(
                "the loop was %d ms late; frames that waited keep their own times", (now_ns - due_ns) // MS
            )
        links = _observe(bus, sink, links, links.zenoh_peers if ticks % PEERS_TICKS else sink.peers())
        ticks += 1
        core.observe_links(links)
        for sample in core.tick(now_ns, time.time_ns(), now_ns - due_ns):
            sink.publish(sample)
        sink.answer(info)
        due_ns += TICK_NS * (1 + (now_ns - due_ns) // TICK_NS)


def receive_burst(bus: FrameSource, core: Core, timeout_s: float) -> list[Sample]:
    """Wait for a frame, take those that wait behind it too, and return their samples.

    Published one right after the other, samples share Zenoh's batches and wake its sending thread once.
    """
    receive, receive_frame, monotonic_ns = bus.receive, core.receive_frame, time.monotonic_ns
    samples: list[Sample] = []
    for _ in range(BURST_MAX_FRAMES):
        frame = receive(timeout_s)
        if frame is None:
            break
        sample = receive_frame(frame, monotonic_ns())
        if sample is not None:
            samples.append(sample)
        timeout_s = 0
    return samples


def _observe(bus: FrameSource, sink: SampleSink, before: Links, peers: int) -> Links:
    if bus.is_up and not before.bus_up:
        log.info("the bus is up%s", " again" if bus.losses else "")
    elif before.bus_up and (not bus.is_up or bus.losses != before.bus_losses):
        log.warning("the bus is lost: %s; trying again", bus.detail)
    if before.zenoh_peers and not peers:
        log.info("no Zenoh node is connected any more")
    elif peers and not before.zenoh_peers:
        log.info("a Zenoh node is connected")
    return Links(
        bus_up=bus.is_up,
        bus_detail=bus.detail,
        bus_losses=bus.losses,
        zenoh_peers=peers,
        publish_failures=sink.failures,
        cpu_ns=time.process_time_ns(),
    )
