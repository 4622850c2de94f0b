"""The guard's process: its shared memory with the gateway, its loop and its start.

The shared memory carries the loop's beats one way and the guard's status the other. Each way has two slots,
written in turn, each with a number and a checksum. A writer that is killed half-way leaves the other slot whole; a
torn or reordered write fails its checksum.

``python -m gateway.host.guard_main DESCRIPTOR`` is started by the gateway; its settings come on stdin.
"""

from __future__ import annotations

import fcntl
import gc
import mmap
import os
import select
import signal
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Final, Generic, Protocol, Self, TypeVar
from zlib import crc32

import msgspec

from gateway.can.can_bus import Bus, BusLost
from gateway.can.open_bus import ReconnectingBus, open_bus
from gateway.chassis.frame import Frame
from gateway.chassis.port import BusView
from gateway.choice.chassis import CHASSIS
from gateway.guard.guardian import Guardian
from gateway.guard.stopper import Beat, GuardStatus, Stopper
from gateway.host.notes import NoteWriter, StopNote
from gateway.host.process import request_realtime
from schemas.command_line import CommandError
from schemas.settings import GUARD_GIVES_UP_NS, GUARD_POLL_NS, GUARD_SILENT_NS, Settings

Kind = TypeVar("Kind")

SIZE_BYTES: Final = 4096
_BEATS_AT: Final = 0
_STATUS_AT: Final = 2048

_HEAD: Final = struct.Struct("<QH")  # the number of the write, and the length of its content

_CHECKSUM: Final = struct.Struct("<I")

_ENCODER: Final = msgspec.msgpack.Encoder()


class _Record(Generic[Kind]):
    """A value with one writer, in two slots, as MessagePack."""

    def __init__(self, memory: mmap.mmap, at: int, kind: type[Kind]) -> None:
        self._memory = memory
        self._decoder = msgspec.msgpack.Decoder(kind)
        self._slots = (at, at + SIZE_BYTES // 4)
        self._number = 0

    def write(self, value: Kind) -> None:
        self._number += 1
        content = _ENCODER.encode(value)
        content = _HEAD.pack(self._number, len(content)) + content
        at = self._slots[self._number & 1]
        self._memory[at : at + len(content) + _CHECKSUM.size] = content + _CHECKSUM.pack(crc32(content))

    def read(self) -> Kind | None:
        """The newest whole value; None before the first."""
        newest, content = 0, b""
        for at in self._slots:
            number, length = _HEAD.unpack_from(self._memory, at)
            end = at + _HEAD.size + length
            if number <= newest or end + _CHECKSUM.size > SIZE_BYTES:
                continue
            found = self._memory[at:end]
            if _CHECKSUM.unpack_from(self._memory, end)[0] == crc32(found):
                newest, content = number, found
        return self._decoder.decode(content[_HEAD.size :]) if content else None


class Heartbeat:
    """The shared memory, as either side sees it."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, SIZE_BYTES)
        self._beats = _Record(self._memory, _BEATS_AT, Beat)
        self._status = _Record(self._memory, _STATUS_AT, GuardStatus)

    @classmethod
    def create(cls) -> Self:
        """Create anonymous memory of a sealed size.

        Any process of the same user can open it through /proc. If it could be truncated, the next access would
        kill both gateway and guard (SIGBUS), and neither could stop the robot.
        """
        descriptor = os.memfd_create("cruiser-heartbeat", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(descriptor, SIZE_BYTES)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        return cls(descriptor)

    def close(self) -> None:
        """Close this side's handle; the memory stays with the other side."""
        self._memory.close()
        os.close(self.descriptor)

    def write_beat(self, beat: Beat) -> None:
        self._beats.write(beat)

    def read_beat(self) -> Beat | None:
        return self._beats.read()

    def write_status(self, status: GuardStatus) -> None:
        self._status.write(status)

    def read_status(self) -> GuardStatus | None:
        return self._status.read()


_SKIP_MAX_FRAMES: Final = 100_000
"""More than any socket holds: bounds the loop on a bus that fills faster than it is read."""


class GuardBus(Protocol):
    """The guard's bus handle. It never raises: it is up or down."""

    is_up: bool

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None if there was none in time."""

    def send(self, frames: list[Frame]) -> int:
        """Hand frames to the bus, without waiting. Returns the number it accepted."""


class Memory(Protocol):
    """The shared memory, as the guard uses it."""

    def read_beat(self) -> Beat | None:
        """The loop's newest beat."""

    def write_status(self, status: GuardStatus) -> None:
        """Write the guard's status."""


def run(
    bus: GuardBus,
    memory: Memory,
    guardian: Guardian,
    parent_lives: Callable[[], bool],
    asked_to_end: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Watch until there is nothing left to guard. ``say`` must not block."""
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
        # The status comes before the frames, so that a loop that recovers sees that it must not send.
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


def stop_alone(bus: GuardBus, stopper: Stopper, view: BusView, is_relieved: Callable[[], bool]) -> str:
    """Carry through a stop from the process that drove the robot, and return its outcome."""
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


_STDERR: Final = 2
_PRIORITY_MAX: Final = 99


class GuardOrder(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The gateway's instructions to its guard, on stdin."""

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
    """Write a line to stderr, or drop it: a full pipe must not delay a stop."""
    poll = select.poll()
    poll.register(_STDERR, select.POLLOUT)
    try:
        if any(events & select.POLLOUT for _, events in poll.poll(0)):
            os.write(_STDERR, f"guard: {line}\n".encode())
    except OSError:
        return


def main() -> None:
    asked = _Asked()
    memory = Heartbeat(int(sys.argv[1]))
    order = msgspec.json.decode(sys.stdin.buffer.read(), type=GuardOrder)
    settings = order.settings
    guardian = Guardian(CHASSIS, settings.command)
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
    return open_bus(settings.can, CHASSIS.common.identifiers)


def _first_bus(settings: Settings) -> Bus | None:
    try:
        return _open_bus(settings)
    except (BusLost, CommandError):
        return None


def _spare_from_memory_killer() -> None:
    """Make this process the last that the kernel kills when memory runs out, if permitted."""
    try:
        Path("/proc/self/oom_score_adj").write_text("-1000", encoding="ascii")
    except OSError:
        return


if __name__ == "__main__":
    main()
