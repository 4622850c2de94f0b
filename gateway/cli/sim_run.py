"""The virtual chassis in real time: the one place of this package with clocks."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from typing import Final, Protocol

import msgspec

from gateway.can.can_bus import Bus, BusFull
from gateway.chassis.frame import ERROR, Frame
from gateway.cli.typed_lines import TypedLines
from gateway.sim.faults import FaultTextError, parse
from gateway.sim.model import VirtualChassis

_logger = logging.getLogger(__name__)

_NS_PER_S: Final = 1_000_000_000

_MAX_WAIT_NS: Final = 50_000_000
"""A signal to stop is seen after this time at the latest."""

_TYPED_PERIOD_NS: Final = 100_000_000
"""The period in which typed lines are read."""

_STALL_NS: Final = 500_000_000
"""Later than this, the process was stopped rather than late: the time is left out of the chassis's life.

Catching up would put seconds of feedback on the bus at once, which no chassis does.
"""

_MAX_FRAMES_PER_WAIT: Final = 200
"""Frames taken from a CAN bus before the chassis has its turn again."""

Inject = Callable[[str], str]
"""Causes the fault that a text names; returns what is wrong with the text, or nothing."""


class SimBus(Protocol):
    """A bus to be on. ``wait`` is the only call that may block."""

    def wait(self, timeout_s: float) -> None:
        """Waits for something to read, at most this long."""

    def read(self, now_ns: int, wall_ns: int, inject: Inject) -> list[Frame]:
        """The frames that others sent."""
        ...

    def send(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Puts frames on the bus."""


class SimClock:
    """The machine's clocks."""

    def monotonic_ns(self) -> int:
        """For deadlines."""
        return time.monotonic_ns()

    def wall_ns(self) -> int:
        """For the frames' time stamps."""
        return time.time_ns()


class SimSummary(msgspec.Struct):
    """The counts of a run."""

    sent: int = 0
    received: int = 0
    stalled_ns: int = 0


class CanBusLink:
    """A bus of python-can."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._frames: list[Frame] = []

    def wait(self, timeout_s: float) -> None:
        """Waits for a frame, and takes those that are there already.

        Raises:
            BusLost: the bus has gone.
        """
        frame = self._bus.receive(timeout_s)
        while frame is not None and len(self._frames) < _MAX_FRAMES_PER_WAIT:
            self._frames.append(frame)
            frame = self._bus.receive(0.0)
        if frame is not None:
            self._frames.append(frame)

    def read(self, now_ns: int, wall_ns: int, inject: Inject) -> list[Frame]:
        """The frames of the last wait."""
        del now_ns, wall_ns, inject  # A CAN bus stamps its frames, and carries no words.
        frames, self._frames = self._frames, []
        return frames

    def send(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Puts frames on the bus, but for error frames: a node cannot send those at will.

        Raises:
            BusLost: the bus has gone.
        """
        del now_ns
        for frame in frames:
            if not frame.can_id & ERROR:
                try:
                    self._bus.send(frame)
                except BusFull as error:
                    _logger.debug("a frame is lost: %s", error)


def live(
    chassis: VirtualChassis,
    link: SimBus,
    stopped: Callable[[], bool],
    *,
    clock: SimClock,
    lines: TypedLines,
    answer: Callable[[str], None],
    seconds: float | None = None,
) -> SimSummary:
    """Run the chassis on the bus until interrupted.

    Args:
        chassis: powered up at the clock's monotonic time.
        link: the bus.
        stopped: turns true when the run should end.
        clock: the time.
        lines: faults, one a line.
        answer: receives the result of each of them.
        seconds: ends the run by itself after this time.
    """
    summary = SimSummary()
    now_ns = clock.monotonic_ns()
    end_ns = None if seconds is None else now_ns + round(seconds * _NS_PER_S)
    next_lines_ns = now_ns

    def inject(text: str) -> str:
        line = parse(text)
        if isinstance(line, FaultTextError):
            return line.reason
        chassis.inject(line, now_ns)
        return ""

    while not stopped() and (end_ns is None or now_ns < end_ns):
        link.wait(min(max(chassis.next_due_ns - now_ns, 0), _MAX_WAIT_NS) / _NS_PER_S)
        now_ns = _time_of_life(clock, chassis, summary)
        wall_ns = clock.wall_ns()
        for frame in link.read(now_ns, wall_ns, inject):
            chassis.receive(frame, now_ns)
            summary.received += 1
        frames = chassis.advance(now_ns, wall_ns)
        if frames:
            link.send(frames, now_ns)
            summary.sent += len(frames)
        if now_ns >= next_lines_ns:
            next_lines_ns = now_ns + _TYPED_PERIOD_NS
            for text in lines.read():
                answer(inject(text) or f"ok: {text}")
    return summary


def _time_of_life(clock: SimClock, chassis: VirtualChassis, summary: SimSummary) -> int:
    """The monotonic time without the times during which this process was stopped."""
    now_ns = clock.monotonic_ns() - summary.stalled_ns
    late_ns = now_ns - chassis.next_due_ns
    if late_ns <= _STALL_NS:
        return now_ns
    summary.stalled_ns += late_ns
    _logger.warning("the process was stopped for %.1f s; the chassis goes on where it was", late_ns / _NS_PER_S)
    return now_ns - late_ns
