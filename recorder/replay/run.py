"""Plays a log: waits until the next message is due, and hands it to the outlet."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Protocol

import msgspec

from recorder.replay.replay import ReplayScheduler
from recorder.replay.samples import ReplaySample
from schemas.command_line import ExitCode

ATTEND_NS: Final = 20_000_000
"""The period in which the outlet is looked after."""

MIN_SLEEP_NS: Final = 1_000
"""Looking after things may have taken until the next look."""


class Halt(msgspec.Struct, frozen=True):
    """The reason for which a replay cannot continue."""

    detail: str
    code: ExitCode


class Outlet(Protocol):
    """The destination of a replay.

    Attributes:
        sent: number of samples that were accepted...
        failed: ...and of those that were not. They are never sent later.
    """

    sent: int
    failed: int

    def send(self, item: ReplaySample, shift_ns: int) -> None:
        """Send one. Its time stamps become so much later. Never raises."""
        ...

    def attend(self) -> Halt | None:
        """Look after what else there is. Returns why it cannot go on."""
        ...

    def close(self) -> None:
        """Give everything back; nothing is sent any more. Never raises."""
        ...


class ReplayClock:
    """The machine's clocks, and waiting."""

    def monotonic_ns(self) -> int:
        """Return the time for due times."""
        return time.monotonic_ns()

    def wall_ns(self) -> int:
        """Return the time since 1970."""
        return time.time_ns()

    def sleep(self, duration_ns: int) -> None:
        """Wait."""
        time.sleep(duration_ns / 1e9)


def play(
    player: ReplayScheduler,
    outlet: Outlet,
    clock: ReplayClock,
    stopped: Callable[[], bool],
    *,
    is_now: bool = False,
) -> Halt | None:
    """Play to the end, or until stopped.

    Args:
        player: plays the log.
        outlet: the destination.
        clock: the time.
        stopped: end it.
        is_now: every time stamp is moved by what lies between the log's time and the present.

    Returns:
        Why it could not go on; None if it reached the end or was stopped.
    """
    epoch_ns = clock.wall_ns() - clock.monotonic_ns()
    attend_ns = clock.monotonic_ns()
    player.start(attend_ns)
    # What it took to find the beginning is no lateness.
    player.hold(clock.monotonic_ns() - attend_ns)
    while not stopped() and not player.is_ended:
        now_ns = clock.monotonic_ns()
        if now_ns >= attend_ns:
            attend_ns = now_ns + ATTEND_NS
            halt = outlet.attend()
            if halt is not None:
                return halt
            now_ns = clock.monotonic_ns()
        due = player.take(now_ns)
        if due is not None:
            present_ns = epoch_ns + (due.due_ns if player.pace.is_paced else now_ns)
            outlet.send(due.item, present_ns - due.item.time_ns if is_now else 0)
            continue
        next_ns = player.next_ns
        clock.sleep(max(MIN_SLEEP_NS, min(attend_ns if next_ns is None else next_ns, attend_ns) - now_ns))
    return outlet.attend()
