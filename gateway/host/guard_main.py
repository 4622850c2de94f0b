"""``python -m gateway.host.guard_main``: the guard as a process, which the gateway starts.

Its only argument is the descriptor of the shared memory; its settings come on stdin.
"""

from __future__ import annotations

import gc
import os
import select
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Final

import msgspec

from gateway.can.can_bus import Bus, BusLost
from gateway.can.open_bus import open_bus
from gateway.can.reconnecting_bus import ReconnectingBus
from gateway.chassis.cruiser.layout import load
from gateway.guard.guardian import Guardian
from gateway.host.guard_run import run
from gateway.host.heartbeat import Heartbeat
from gateway.host.realtime import request_realtime
from gateway.host.stop_note import NoteWriter, StopNote
from schemas.command_line import CommandError
from schemas.messages import Variant
from schemas.settings import Settings

_STDERR: Final = 2
_PRIORITY_MAX: Final = 99


class GuardOrder(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The order of the gateway to its guard, on stdin.

    Attributes:
        parent: the gateway's process.
    """

    parent: int
    settings: Settings


class _Asked:
    """A signal's request that the process ends, read once."""

    def __init__(self) -> None:
        self._is_raised = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._raise)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def _raise(self, _number: int, _frame: FrameType | None) -> None:
        self._is_raised = True

    def __call__(self) -> bool:
        is_raised, self._is_raised = self._is_raised, False
        return is_raised


def say(line: str) -> None:
    """A line on stderr, or nowhere if that takes none: a full pipe must not hold up a stop."""
    poll = select.poll()
    poll.register(_STDERR, select.POLLOUT)
    try:
        if any(events & select.POLLOUT for _, events in poll.poll(0)):
            os.write(_STDERR, f"guard: {line}\n".encode())
    except OSError:
        return


def main() -> None:
    """Run the guard to its end."""
    asked = _Asked()
    memory = Heartbeat(int(sys.argv[1]))
    order = msgspec.json.decode(sys.stdin.buffer.read(), type=GuardOrder)
    settings = order.settings
    guardian = Guardian(settings.command)
    _spare_from_memory_killer()
    priority = settings.gateway.realtime_priority
    if priority:
        priority = min(priority + 1, _PRIORITY_MAX)
        request_realtime(priority)
    note = NoteWriter(StopNote.of(settings), say, priority)

    def announce(line: str) -> None:
        say(line)
        note.add(f"guard: {line}")

    bus = ReconnectingBus(lambda: _open_bus(settings), _first_bus(settings))
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        run(bus, memory, guardian, lambda: os.getppid() == order.parent, asked, announce)
    finally:
        bus.close()
        note.close()
        memory.close()


def _open_bus(settings: Settings) -> Bus:
    return open_bus(settings.can, load(Variant.COARSE).identifiers)


def _first_bus(settings: Settings) -> Bus | None:
    try:
        return _open_bus(settings)
    except (BusLost, CommandError):
        return None


def _spare_from_memory_killer() -> None:
    """Where memory runs out, this process is the last to go, if the system lets it say so."""
    try:
        Path("/proc/self/oom_score_adj").write_text("-1000", encoding="ascii")
    except OSError:
        return


if __name__ == "__main__":
    main()
