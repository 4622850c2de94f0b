"""The guard's one thread: frames in, the heartbeat every 5 ms, stop frames out when it has to be."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Protocol

from gateway.chassis.frame import Frame
from gateway.guard.beat import Beat, GuardStatus
from gateway.guard.chassis_view import ChassisView
from gateway.guard.guardian import Guardian
from gateway.guard.stopper import Stopper
from schemas.settings import GUARD_GIVES_UP_NS, GUARD_POLL_NS, GUARD_SILENT_NS

_SKIP_MAX_FRAMES: Final = 100_000
"""More than any socket holds: an end there must be, also on a bus that fills faster than it is read."""


class GuardBus(Protocol):
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
    bus: GuardBus,
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
        if now_ns - due_ns > GUARD_SILENT_NS:
            _skip_what_waits(bus)
            now_ns = monotonic_ns()
        if asked_to_end():
            guardian.ask_to_end()
        frames = guardian.tick(memory.read_beat(), now_ns, parent_lives=parent_lives(), bus_up=bus.is_up)
        # First the word, then the deed: a loop that comes back sees that it must not send.
        memory.write_status(guardian.status(now_ns, bus_up=bus.is_up))
        if frames:
            guardian.sent(bus.send(frames), now_ns)
        for line in guardian.take_lines():
            say(line)
        due_ns = guardian.next_look_ns(now_ns)


def _skip_what_waits(bus: GuardBus) -> None:
    """Drop frames that arrived while this process stood still: they are old."""
    for _ in range(_SKIP_MAX_FRAMES):
        if bus.receive(0) is None:
            return


def stop_alone(bus: GuardBus, stopper: Stopper, view: ChassisView, is_relieved: Callable[[], bool]) -> str:
    """Bring the robot to rest with a stop that has begun, from the process that drove it. Returns how it ended.

    Args:
        bus: the gateway's own, still open.
        stopper: has begun.
        view: what the stopper looks at.
        is_relieved: somebody else stops the robot, or there has to be an end.
    """
    monotonic_ns = time.monotonic_ns
    end_ns = monotonic_ns() + GUARD_GIVES_UP_NS
    while not stopper.is_over:
        now_ns = monotonic_ns()
        if is_relieved() or now_ns > end_ns:
            stopper.give_up("given up")
            break
        frames = stopper.tick(now_ns) if bus.is_up else []
        if frames:
            stopper.sent(bus.send(frames), now_ns)
        until_ns = now_ns + GUARD_POLL_NS
        while (now_ns := monotonic_ns()) < until_ns:
            frame = bus.receive((until_ns - now_ns) / 1e9)
            if frame is not None:
                view.receive(frame, monotonic_ns())
    return stopper.outcome
