"""The guard's one thread: frames in, the heartbeat every 5 ms, stop frames out when it has to be."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from gateway.chassis.frame import Frame
from gateway.guard.beat import Beat, GuardStatus
from gateway.guard.guardian import Guardian
from schemas.settings import GUARD_POLL_NS


class Bus(Protocol):
    """The guard's own handle of the bus: it never fails, it is up or it is not."""

    is_up: bool

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None if there was none in time."""
        ...

    def send(self, frames: list[Frame]) -> int:
        """Hand frames to the bus, without waiting. Returns how many it took."""
        ...


class Memory(Protocol):
    """The shared memory, as the guard uses it."""

    def read_beat(self) -> Beat | None:
        """The loop's newest beat."""
        ...

    def write_status(self, status: GuardStatus) -> None:
        """Tell the loop."""
        ...


def run(
    bus: Bus,
    memory: Memory,
    guardian: Guardian,
    parent_lives: Callable[[], bool],
    asked_to_end: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Watch until there is nothing left to guard.

    Args:
        bus: a handle of the guard's own.
        memory: shared with the loop.
        guardian: decides.
        parent_lives: the gateway's process has not ended.
        asked_to_end: a signal came since the last time that this was asked.
        say: a line for people; must not block.
    """
    monotonic_ns = time.monotonic_ns
    due_ns = monotonic_ns()
    while not guardian.is_ended:
        now_ns = monotonic_ns()
        if now_ns < due_ns:
            frame = bus.receive((due_ns - now_ns) / 1e9)
            if frame is not None:
                guardian.receive(frame, monotonic_ns())
            continue
        due_ns = now_ns + GUARD_POLL_NS
        if asked_to_end():
            guardian.ask_to_end()
        frames = guardian.tick(memory.read_beat(), now_ns, parent_lives=parent_lives(), bus_up=bus.is_up)
        # First the word, then the deed: a loop that comes back sees that it must not send.
        memory.write_status(guardian.status(now_ns, bus_up=bus.is_up))
        if frames:
            guardian.sent(bus.send(frames), now_ns)
        for line in guardian.take_lines():
            say(line)
