"""The heartbeat in shared memory: the loop's beats one way, the guard's status the other.

Each way has two slots, written in turn, each with a number and a checksum. A writer that is killed half-way leaves
the other slot whole, and what is half written, or seen out of order by another core, is never believed.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import struct
from typing import Final, Generic, Self, TypeVar
from zlib import crc32

import msgspec

from gateway.guard.beat import Beat, GuardStatus

Kind = TypeVar("Kind")

SIZE_BYTES: Final = 4096
_BEATS_AT: Final = 0
_STATUS_AT: Final = 2048

_HEAD: Final = struct.Struct("<QH")
"""The number of the write, and the length of its content."""

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
        """Make this the newest value."""
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
    """The shared memory, as either side sees it.

    Attributes:
        descriptor: of the memory, to be handed to the other process.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, SIZE_BYTES)
        self._beats = _Record(self._memory, _BEATS_AT, Beat)
        self._status = _Record(self._memory, _STATUS_AT, GuardStatus)

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
        self._beats.write(beat)

    def read_beat(self) -> Beat | None:
        """The loop's newest beat; None before the first."""
        return self._beats.read()

    def write_status(self, status: GuardStatus) -> None:
        """The guard lives."""
        self._status.write(status)

    def read_status(self) -> GuardStatus | None:
        """The guard's newest status; None before the first."""
        return self._status.read()
