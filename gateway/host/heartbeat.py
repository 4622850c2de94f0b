"""The heartbeat in shared memory: the loop's beats one way, the guard's status the other.

Each way has two slots, written in turn, each with a number and a checksum. A writer that is killed half-way leaves
the other slot whole, and what is half written, or seen out of order by another core, is never believed.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import struct
from typing import Any, Final, Self
from zlib import crc32

from gateway.command.actuation import Actuation
from gateway.guard.beat import Beat, Cause, GuardStatus, StopOutcome
from schemas.messages import GearPosition, Variant

SIZE_BYTES: Final = 4096
_BEATS_AT: Final = 0
_STATUS_AT: Final = 2048

_BEAT: Final = struct.Struct("<2q4?B?Bdd?8s")
_STATUS: Final = struct.Struct("<q2?Q2B")
_NUMBER: Final = struct.Struct("<Q")
_CHECKSUM: Final = struct.Struct("<I")

_VARIANTS: Final = tuple(Variant)
_GEARS: Final = tuple(GearPosition)
_CAUSES: Final = tuple(Cause)
_OUTCOMES: Final = tuple(StopOutcome)
_VARIANT_CODES: Final = {variant: code for code, variant in enumerate(_VARIANTS)}
_GEAR_CODES: Final = {gear: code for code, gear in enumerate(_GEARS)}
_CAUSE_CODES: Final = {cause: code for code, cause in enumerate(_CAUSES)}
_OUTCOME_CODES: Final = {outcome: code for code, outcome in enumerate(_OUTCOMES)}


class _Record:
    """A value with one writer, in two slots."""

    def __init__(self, memory: mmap.mmap, at: int, body: struct.Struct) -> None:
        self._memory = memory
        self._body = body
        self._bytes = _NUMBER.size + body.size
        self._slots = (at, at + SIZE_BYTES // 4)
        self._number = 0

    def write(self, *values: Any) -> None:  # noqa: ANN401 - what struct packs
        """Make this the newest value."""
        self._number += 1
        content = _NUMBER.pack(self._number) + self._body.pack(*values)
        at = self._slots[self._number & 1]
        self._memory[at : at + self._bytes + _CHECKSUM.size] = content + _CHECKSUM.pack(crc32(content))

    def read(self) -> tuple[Any, ...] | None:
        """The newest whole value; None before the first."""
        newest, content = 0, b""
        for at in self._slots:
            slot = self._memory[at : at + self._bytes + _CHECKSUM.size]
            (number,) = _NUMBER.unpack_from(slot)
            if number > newest and _CHECKSUM.unpack_from(slot, self._bytes)[0] == crc32(slot[: self._bytes]):
                newest, content = number, slot
        return self._body.unpack_from(content, _NUMBER.size) if content else None


class Heartbeat:
    """The shared memory, as either side sees it.

    Attributes:
        descriptor: of the memory, to be handed to the other process.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, SIZE_BYTES)
        self._beats = _Record(self._memory, _BEATS_AT, _BEAT)
        self._status = _Record(self._memory, _STATUS_AT, _STATUS)

    @classmethod
    def create(cls) -> Self:
        """New memory, which no file names and nobody can resize.

        Any process of the same user can open it through /proc. If it could be truncated, the next access would
        kill gateway and guard alike (SIGBUS), and nobody would be left to stop the robot.
        """
        descriptor = os.memfd_create("cruiser-heartbeat", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(descriptor, SIZE_BYTES)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        return cls(descriptor)

    def close(self) -> None:
        """Let go of the memory; the other side keeps it."""
        self._memory.close()
        os.close(self.descriptor)

    def write_beat(self, beat: Beat) -> None:
        """The loop lives."""
        last = beat.last
        self._beats.write(
            beat.now_ns,
            beat.told_ns,
            beat.is_active,
            beat.is_left,
            beat.is_mute,
            beat.is_closing,
            _VARIANT_CODES[beat.variant],
            last.enabled,
            _GEAR_CODES[last.gear],
            last.speed_mps,
            last.angle_deg,
            last.parking,
            beat.counters,
        )

    def read_beat(self) -> Beat | None:
        """The loop's newest beat; None before the first."""
        values = self._beats.read()
        if values is None:
            return None
        now_ns, told_ns, active, left, mute, closing, variant = values[:7]
        enabled, gear, speed, angle, parking, counters = values[7:]
        last = Actuation(enabled, _GEARS[gear], speed, angle, parking)
        return Beat(now_ns, told_ns, active, left, mute, closing, _VARIANTS[variant], last, counters)

    def write_status(self, status: GuardStatus) -> None:
        """The guard lives."""
        cause = _CAUSE_CODES[status.cause]
        outcome = _OUTCOME_CODES[status.outcome]
        self._status.write(status.now_ns, status.is_ready, status.is_sending, status.stops, cause, outcome)

    def read_status(self) -> GuardStatus | None:
        """The guard's newest status; None before the first."""
        values = self._status.read()
        if values is None:
            return None
        now_ns, is_ready, is_sending, stops, cause, outcome = values
        return GuardStatus(now_ns, is_ready, is_sending, stops, _CAUSES[cause], _OUTCOMES[outcome])
